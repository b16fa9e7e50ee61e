"""Names of the NumPy array types that annotations of this package use."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
RealArray = NDArray[np.floating]
Ints = NDArray[np.int64]
Ints32 = NDArray[np.int32]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]
ImageArray = NDArray[np.uint8]  # (height, width, 3) RGB, unless a docstring says otherwise
Maps = tuple[Floats32, Floats32]  # raw network output: scores (R, C) and endpoints (R, C, 4)

FloatImage = Floats32  # (height, width, 3) RGB in [0, 255]
Points = Floats  # (K, 2) x, y in pixels, or (K, 3) x, y, z in metres
Rng = np.random.Generator
