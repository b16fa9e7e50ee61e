"""Quantiles of many short arrays at once, as `np.quantile` gives them one by one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lsnet.arrays import Floats, Indices, RealArray


def row_quantiles(values: RealArray, shares: Sequence[float]) -> RealArray:
    """Return (..., Q) quantiles of rows (..., T)."""
    at = np.array(shares) * (values.shape[-1] - 1)
    below = at.astype(np.intp)
    ordered = np.sort(values, axis=-1)
    low, high = ordered[..., below], ordered[..., np.minimum(below + 1, values.shape[-1] - 1)]
    out: RealArray = low + (high - low) * (at - below).astype(values.dtype)
    return out


def group_quantiles(values: RealArray, first: Indices, shares: Sequence[float]) -> Floats:
    """Return (C, Q) quantiles of groups of the values (M,): group k from first[k] to first[k + 1]."""
    counts = np.diff(first)
    span = 1 + values.max(initial=0) - values.min(initial=0)
    # Each group is moved above the one before, so that one sort does for all.
    shift = np.repeat(np.arange(len(counts)) * span, counts)
    ordered = np.sort(values + shift) - shift
    at = np.array(shares) * (counts[:, None] - 1)
    below = at.astype(np.intp)
    start, end = first[:-1, None], first[1:, None] - 1
    low, high = ordered[start + below], ordered[np.minimum(start + below + 1, end)]
    out: Floats = low + (high - low) * (at - below)
    return out
