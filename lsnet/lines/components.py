"""Which nodes of a graph are connected."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from lsnet.arrays import Indices


def components(count: int, pairs: Indices) -> Indices:
    """Return (count,) the first node of the component of each node, in a graph with edges `pairs` (P, 2).

    Graphs of an image are small: SciPy takes longer to read one.
    """
    one, other = pairs.T
    label = np.arange(count)
    while True:
        lower = np.minimum(label[one], label[other])
        next_label = label.copy()
        np.minimum.at(next_label, label[one], lower)
        np.minimum.at(next_label, label[other], lower)
        next_label = next_label[next_label]
        if np.array_equal(label, next_label):
            return label
        label = next_label
