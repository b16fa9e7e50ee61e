"""Pixel precision and recall with a tolerance, and structural AP.

Pixel scores compare a confidence map of one-pixel lines with a `PixelTruth`: precision is the share of drawn
pixels within the tolerance of a cable's mask, recall the share of centreline pixels that have a drawn
pixel within the tolerance plus the cable's half width. Counts are pooled over a set before dividing; ODS is
the best F1 over one threshold for the whole set.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lsnet.arrays import Floats, Floats32, Ints, Mask, RealArray


THRESHOLDS = np.linspace(0.05, 0.95, 19)


@dataclass(frozen=True, slots=True, eq=False)
class PixelTruth:
    """Where the cables of one image are.

    Attributes:
        mask: (H, W) bool, the cables in their full width.
        centreline: (H, W) bool, one pixel wide.
        half_width_px: (H, W) float32, valid on the centreline at least.
    """

    mask: Mask
    centreline: Mask
    half_width_px: Floats32


@dataclass(frozen=True, slots=True)
class PixelScore:
    """Scores pooled over a set at one threshold; mean_f1 is the mean of the F1 of each image."""

    threshold: float
    precision: float
    recall: float
    f1: float
    mean_f1: float


def distance_to(mask: Mask) -> Floats32:
    """Return (H, W) distances to the nearest set pixel, px; a thousand everywhere if there is none."""
    if not mask.any():
        return np.full(mask.shape, 1e3, np.float32)
    return np.asarray(cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5), np.float32)


def pixel_counts(confidence: Floats32, truth: PixelTruth, tolerance_px: float, thresholds: RealArray) -> Ints:
    """Count the pixels of one image.

    Returns:
        (T, 4) at each threshold: drawn pixels near a cable, drawn pixels, centreline pixels found, and
        centreline pixels. Pixels without a score are not drawn, even at a threshold of 0.
    """
    is_near_cable = distance_to(truth.mask) <= tolerance_px
    counts = np.zeros((len(thresholds), 4), np.int64)
    for i, threshold in enumerate(thresholds):
        drawn = (confidence >= threshold) & (confidence > 0)
        found = truth.centreline & (distance_to(drawn) <= tolerance_px + truth.half_width_px)
        counts[i] = [(drawn & is_near_cable).sum(), drawn.sum(), found.sum(), truth.centreline.sum()]
    return counts


def pixel_scores(counts: Ints, thresholds: RealArray) -> list[PixelScore]:
    """Return the scores at each threshold from the counts (images, T, 4)."""
    pooled, own = rates(counts.sum(axis=0)), rates(counts)
    return [
        PixelScore(float(t), float(p), float(r), float(f1), float(mean_f1))
        for t, (p, r, f1), mean_f1 in zip(thresholds, pooled, own[..., 2].mean(axis=0), strict=True)
    ]


def rates(counts: Ints) -> Floats:
    """Return (..., 3) precision, recall and F1 from (..., 4) counts.

    Where nothing is true and nothing is drawn, all three are 1. Where only one of both is empty, they are 0.
    """
    precision = counts[..., 0] / np.maximum(counts[..., 1], 1)
    recall = counts[..., 2] / np.maximum(counts[..., 3], 1)
    f1 = 2 * precision * recall / np.maximum(precision + recall, 1e-9)
    is_rightly_empty = (counts[..., 1] == 0) & (counts[..., 3] == 0)
    return np.where(is_rightly_empty[..., None], 1.0, np.stack([precision, recall, f1], axis=-1))


def structural_ap(
    detected: Sequence[tuple[RealArray, RealArray]],
    truth: Sequence[RealArray],
    image_sizes: Sequence[tuple[int, int]],
    threshold: float,
) -> float:
    """Return the structural AP (Zhou et al., L-CNN) of segments.

    Endpoints are scaled to 128 x 128. A detection, in order of score, is correct if the sum of the squared
    distances of its endpoints to its nearest true segment, in the better order, is below `threshold` and
    that segment is not matched yet. The AP is the area under the monotone envelope of precision over recall.

    Args:
        detected: Per image, segments (N, 4) and their scores (N,).
        truth: Per image, true segments (M, 4).
        image_sizes: Per image, (height, width).
        threshold: Squared pixels; 5, 10 and 15 are customary.
    """
    scores, hits = [], []
    for (endpoints, own_scores), true, (height, width) in zip(detected, truth, image_sizes, strict=True):
        scale = np.array([128 / width, 128 / height] * 2)
        order = np.argsort(-own_scores, kind="stable")
        scores.append(own_scores[order])
        hits.append(_greedy_hits(endpoints[order] * scale, true * scale, threshold))
    total = sum(len(t) for t in truth)
    order = np.argsort(-np.concatenate(scores), kind="stable")
    hit = np.concatenate(hits)[order]
    if not total or not len(hit):
        return 0.0
    right = np.cumsum(hit)
    precision = np.maximum.accumulate((right / np.arange(1, len(hit) + 1))[::-1])[::-1]
    return float((precision * np.diff(np.concatenate([[0], right])) / total).sum())


def _greedy_hits(detected: RealArray, true: RealArray, threshold: float) -> Mask:
    hits, taken = np.zeros(len(detected), bool), np.zeros(len(true), bool)
    if not len(true):
        return hits
    direct = ((detected[:, None] - true[None]) ** 2).sum(-1)
    swapped = ((detected[:, None, [2, 3, 0, 1]] - true[None]) ** 2).sum(-1)
    distance = np.minimum(direct, swapped)
    nearest = distance.argmin(axis=1)
    for i, j in enumerate(nearest):
        if distance[i, j] < threshold and not taken[j]:
            hits[i] = taken[j] = True
    return hits
