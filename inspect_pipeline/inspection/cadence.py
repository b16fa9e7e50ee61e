"""Frame rate of a camera, estimated from log times that may be coarse, tied or irregular."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats, Ints
    from inspect_pipeline.inspection.rules import Rules

_MIN_TIED_SHARE = 0.1  # of the steps that are 0, from which on clock ticks are taken as coarse
_TICKS_PER_WINDOW = 4
_MAX_PAUSE_SHARE, _MAX_PAUSE_TIME_SHARE = 0.1, 0.5  # of the steps and of the time of regular frames


@dataclass(frozen=True, slots=True)
class Cadence:
    """Period of the frames of a camera.

    period_s is the median period, NaN when unknown. resolution_s is the tick of coarse log times, such as
    whole seconds, else 0. A pause longer than `max_pause_s` has missing frames. is_video is False for single
    photographs: pauses and differences between them are no faults.
    """

    period_s: float
    resolution_s: float
    max_pause_s: float
    is_video: bool

    def expected_frames(self, times_s: Floats) -> int:
        """Return how many frames the period predicts between the first and the last time."""
        if not self.is_video:
            return len(times_s)
        duration_s = max(times_s[-1] - times_s[0] - self.resolution_s, 0.0)
        return int(max(round(duration_s / self.period_s) + 1, len(times_s)))

    def find_pauses(self, times_s: Floats) -> Ints:
        """Return the rows before each pause in which frames are missing."""
        if not self.is_video:
            return np.zeros(0, np.int64)
        return np.flatnonzero(np.diff(times_s) > self.max_pause_s)

    def missing_frames(self, pause_s: float) -> int:
        """Estimate how many frames are missing in a pause, at least 1."""
        return max(1, round((pause_s - self.resolution_s) / self.period_s) - 1)


def measure_cadence(times_s: Floats, rules: Rules, *, is_stills: bool = False) -> Cadence:
    """Estimate the cadence of ascending times (N,), those of photographs where `is_stills`."""
    steps = np.diff(times_s)
    positive = steps[steps > 0]
    if not len(positive):
        return Cadence(float("nan"), 0.0, float("inf"), is_video=False)
    is_coarse = len(positive) < (1 - _MIN_TIED_SHARE) * len(steps)
    resolution_s = float(np.median(positive)) if is_coarse else 0.0
    window = min(round(_TICKS_PER_WINDOW * len(steps) / len(positive)), len(steps)) if is_coarse else 1
    period_s = float(np.median(times_s[window:] - times_s[:-window])) / window
    limits = rules.frames
    max_pause_s = limits["dropout_factor"] * period_s + resolution_s
    pauses = steps[steps > max_pause_s]
    is_bursty = (
        len(pauses) > _MAX_PAUSE_SHARE * len(steps)
        and pauses.sum() > _MAX_PAUSE_TIME_SHARE * steps.sum()
        and len(pauses) > 1
    )
    is_video = 0 < period_s <= limits["max_video_period_s"] and not is_bursty and not is_stills
    return Cadence(period_s, resolution_s, max_pause_s, is_video)
