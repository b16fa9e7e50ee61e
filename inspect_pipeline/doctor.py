"""Whether the program can work here: versions, the detector's backend, the state of the store."""

from __future__ import annotations

import platform
import shutil
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING

from inspect_pipeline.errors import InspectError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from inspect_pipeline.store.store import Store

_PACKAGES = ("torch", "openvino", "duckdb", "mcap", "opencv-python-headless", "numpy")


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What was found about one thing, and whether the program can work with it."""

    subject: str
    state: str
    is_ok: bool = True


def examine(store: Store, *, load: bool = False) -> Iterator[Diagnosis]:
    """Yield all findings, those that take longest last."""
    yield Diagnosis("lsnet-pipe", version("lsnet-pipe"))
    yield Diagnosis("python", f"{platform.python_version()} on {platform.system()} {platform.machine()}")
    for package in _PACKAGES:
        yield Diagnosis(package, _version_of(package))
    yield _examine_store(store)
    yield _examine_detector(load=load)


def _version_of(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _examine_store(store: Store) -> Diagnosis:
    if not store.root.exists():
        return Diagnosis("store", f"{store.root}: none yet; lsnet-pipe process makes it")
    if not store.root.is_dir():
        return Diagnosis("store", f"{store.root}: a file is where a folder should be", is_ok=False)
    try:
        flights, damaged = store.scan()
    except InspectError as error:
        return Diagnosis("store", str(error), is_ok=False)
    free_gib = shutil.disk_usage(store.root).free / 2**30
    n_flights = "1 flight" if len(flights) == 1 else f"{len(flights)} flights"
    state = f"{store.root}: {n_flights}, {len(damaged)} damaged, {free_gib:.1f} GiB free"
    if flights and not store.index_path.exists():
        return Diagnosis("store", f"{state}, no index; run lsnet-pipe index rebuild", is_ok=False)
    return Diagnosis("store", state, is_ok=not damaged)


def _examine_detector(*, load: bool) -> Diagnosis:
    """Describe the detector that is used by default; loading it takes seconds and shows whether it works."""
    from lsnet.description import describe_detector  # noqa: PLC0415 - imports OpenVINO

    description = None if load else describe_detector()
    if description is None:
        from lsnet import Detector, LSNetError  # noqa: PLC0415 - imports torch

        try:
            description = Detector.load().describe()
        except LSNetError as error:
            return Diagnosis("detector", str(error), is_ok=False)
    return Diagnosis("detector", ", ".join(f"{name} {value}" for name, value in description.items()))
