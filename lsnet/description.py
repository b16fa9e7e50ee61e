"""The description of a detector without loading it: importing torch and compiling take seconds."""

from __future__ import annotations

import hashlib
import json
import sys
from importlib import resources
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

MAX_HEADER_BYTES = 1 << 24


def describe_detector(
    weights: str | Path = "fast",
    *,
    runtime: str = "auto",
    scale: float | None = None,
    min_score: float | None = None,
) -> dict[str, str | int | float] | None:
    """Return what `Detector.load(...).describe()` would, or None where only loading can tell.

    That is where torch could use a GPU, and for weights or runtimes that cannot be used: loading says why.
    """
    try:
        data = _path_of(weights).read_bytes()
        card = _read_card(data)
        backend, precision = _choose_backend(runtime)
        own = card.get("scale") if scale is None else scale
        return {
            "weights": str(card["name"]),
            "weights_sha256": hashlib.sha256(data).hexdigest(),
            "preset": str(card["preset"]),
            "backend": backend,
            "precision": precision,
            "scale": "auto" if own is None else own,
            "min_score": float(card["min_score"]) if min_score is None else min_score,
        }
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return None


def _path_of(weights: str | Path) -> Path:
    package = resources.files("lsnet.pretrained")
    if str(weights) in json.loads(package.joinpath("sha256.json").read_text()):
        return Path(str(package.joinpath(f"{weights}.safetensors")))
    return Path(weights)


def _read_card(data: bytes) -> dict[str, Any]:
    """Return the card in the header of a safetensors file: its length in 8 bytes, then JSON."""
    length = int.from_bytes(data[:8], "little")
    if length > MAX_HEADER_BYTES:
        raise ValueError("no header")
    card: dict[str, Any] = json.loads(json.loads(data[8 : 8 + length])["__metadata__"]["lsnet"])
    return card


def _choose_backend(runtime: str) -> tuple[str, str]:
    """Return name and precision as `lsnet.runtime.open_backend` chooses them; raises ValueError if unsure."""
    has_openvino = find_spec("openvino") is not None
    if runtime in ("auto", "torch") and _may_have_gpu():
        raise ValueError("torch knows whether it can use the GPU")
    if runtime == "torch" or (runtime == "auto" and not has_openvino):
        return "torch", "f32"
    precisions = {"openvino": "f32", "openvino-bf16": "bf16", "auto": _best_precision(has_openvino)}
    if runtime not in precisions or not has_openvino:
        raise ValueError(runtime)
    return "openvino", precisions[runtime]


def _may_have_gpu() -> bool:
    """Whether torch is not the build for CPUs, and the machine has a device for it."""
    try:
        is_cpu_build = version("torch").endswith("+cpu")
    except PackageNotFoundError:
        return False
    devices = ("/dev/nvidiactl", "/dev/kfd", "/dev/dxg")  # NVIDIA, AMD, and either in WSL
    return not is_cpu_build and any(Path(device).exists() for device in devices)


def _best_precision(has_openvino: bool) -> str:
    if not has_openvino:
        return "f32"
    sys.modules.setdefault("openvino_telemetry", None)  # type: ignore[arg-type] # see import_openvino
    import openvino  # noqa: PLC0415

    capabilities = openvino.Core().get_property("CPU", "OPTIMIZATION_CAPABILITIES")
    return "bf16" if "BF16" in capabilities else "f32"
