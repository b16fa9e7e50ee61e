"""The description of a detector without loading it: importing torch and compiling take seconds."""

from __future__ import annotations

import hashlib
import json
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from safetensors import SafetensorError, safe_open

from lsnet.errors import LSNetError
from lsnet.pretrained import path_of, read_checksums
from lsnet.runtime_choice import choose_backend


def describe_detector(
    weights: str | Path = "fast",
    *,
    runtime: str = "auto",
    scale: float | None = None,
    min_score: float | None = None,
) -> dict[str, str | int | float] | None:
    """Return what `Detector.load(...).describe()` would, or None if the detector must be loaded for that.

    It must be where torch could use a GPU, and for weights or runtimes that cannot be used: loading reports
    the reason.
    """
    if runtime in ("auto", "torch") and _may_have_gpu():
        return None
    path = path_of(str(weights)) if str(weights) in read_checksums() else Path(weights)
    try:
        sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
        with safe_open(path, framework="np") as header:
            card = json.loads(header.metadata()["lsnet"])
        backend, precision = choose_backend(runtime, has_gpu=False)
        own = card.get("scale") if scale is None else scale
        return {
            "weights": str(card["name"]),
            "weights_sha256": sha256,
            "preset": str(card["preset"]),
            "backend": backend,
            "precision": precision,
            "scale": "auto" if own is None else own,
            "min_score": float(card["min_score"]) if min_score is None else min_score,
        }
    except (LSNetError, SafetensorError, OSError, ValueError, LookupError, TypeError, RecursionError):
        return None


def _may_have_gpu() -> bool:
    """Whether torch is not the build for CPUs, and the machine has a device for it."""
    try:
        is_cpu_build = version("torch").endswith("+cpu")
    except PackageNotFoundError:
        return False
    devices = ("/dev/nvidiactl", "/dev/kfd", "/dev/dxg")  # NVIDIA, AMD, and either in WSL
    return not is_cpu_build and any(Path(device).exists() for device in devices)
