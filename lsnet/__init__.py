"""LS-Net, a fast single-shot line-segment detector (Nguyen, Jenssen and Roverso, arXiv 1912.09532).

    >>> from lsnet import Detector
    >>> (found,) = Detector.load().detect("photo.jpg")
    >>> for points, score in zip(found.lines.points, found.lines.scores):
    ...     print(score, points)  # (K, 2) x, y in pixels of the photograph

Names are imported on first use, so that `import lsnet` does not load torch.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lsnet.detector import Detector
    from lsnet.errors import LSNetError
    from lsnet.segments import Detections, Lines, Segments
    from lsnet.weights import load_weights, save_weights
    from lsnet.weights_file import WeightsCard, list_weights

__all__ = [
    "Detections",
    "Detector",
    "LSNetError",
    "Lines",
    "Segments",
    "WeightsCard",
    "list_weights",
    "load_weights",
    "save_weights",
]

_MODULES = {"Detector": "detector", "LSNetError": "errors"} | dict.fromkeys(
    ("Detections", "Lines", "Segments"), "segments"
)
_MODULES |= dict.fromkeys(("WeightsCard", "list_weights"), "weights_file")


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES.get(name, 'weights')}"), name)
