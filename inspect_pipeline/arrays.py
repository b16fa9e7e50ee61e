"""Names of the NumPy array types that annotations of this package use: those of lsnet."""

from lsnet.arrays import Floats, Floats32, ImageArray, Ints, Ints32, Mask, RealArray

__all__ = ["Floats", "Floats32", "ImageArray", "Ints", "Ints32", "Mask", "RealArray"]
