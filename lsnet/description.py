"""The description of a detector without loading it: importing torch and compiling take seconds."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lsnet.errors import LSNetError
from lsnet.runtime.choice import choose_backend, may_have_gpu
from lsnet.weights_file import read_weights

if TYPE_CHECKING:
    from pathlib import Path


def describe_detector(
    weights: str | Path = "fast",
    *,
    runtime: str = "auto",
    device: str | None = None,
    scale: float | None = None,
    min_score: float | None = None,
) -> dict[str, str | int | float] | None:
    """Return what `Detector.load(...).describe()` would, or None if the detector must be loaded for that.

    It must be where torch could use a GPU, and for weights or runtimes that cannot be used: loading reports
    the reason.
    """
    if device not in (None, "cpu") or (device is None and may_have_gpu()):
        return None
    try:
        file = read_weights(weights)
        backend, precision = choose_backend(runtime, has_gpu=False)
    except LSNetError:
        return None
    own = file.card.scale if scale is None else scale
    return {
        "weights": file.card.name,
        "weights_sha256": file.sha256,
        "preset": file.card.preset,
        "backend": backend,
        "precision": precision,
        "scale": "auto" if own is None else own,
        "min_score": file.card.min_score if min_score is None else min_score,
    }
