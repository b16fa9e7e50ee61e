"""LS-Net, a fast single-shot line-segment detector (Nguyen, Jenssen and Roverso, arXiv 1912.09532)."""

from lsnet.detector import Detector
from lsnet.errors import LSNetError
from lsnet.segments import Detections, Lines, Segments
from lsnet.weights import WeightsCard, load_weights, save_weights, shipped

__all__ = [
    "Detections",
    "Detector",
    "LSNetError",
    "Lines",
    "Segments",
    "WeightsCard",
    "load_weights",
    "save_weights",
    "shipped",
]
