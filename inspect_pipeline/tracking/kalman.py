"""A value that drifts, and what is known of it: a Kalman filter of the value and its speed.

The speed is pushed at random and forgotten within a second or two, an Ornstein-Uhlenbeck process: soon after
it was measured a value is expected to go on as it went, long after to have stopped somewhere.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

_SPEED_LASTS_S = 1.5


class Pace(NamedTuple):
    """How a value and its speed go on for some time."""

    decay: float  # of the speed
    reach_s: float  # how long it would go on at its first speed
    value_spread: float  # variances that are added, for a usual speed of 1
    both_spread: float
    speed_spread: float

    @classmethod
    def of(cls, elapsed_s: float) -> Pace:
        """For a time that passes."""
        lasts_s, decay = _SPEED_LASTS_S, math.exp(-elapsed_s / _SPEED_LASTS_S)
        return cls(
            decay=decay,
            reach_s=lasts_s * (1 - decay),
            value_spread=lasts_s**2 * (2 * elapsed_s / lasts_s - 3 + 4 * decay - decay**2),
            both_spread=lasts_s * (1 - decay) ** 2,
            speed_spread=1 - decay**2,
        )


@dataclass(slots=True)
class KalmanState:
    """A value with its variance, the usual size of its speed, and its speed, not known at first."""

    value: float
    value_var: float
    usual_speed: float
    speed: float = 0.0
    both_var: float = 0.0
    speed_var: float = field(init=False)

    def __post_init__(self) -> None:
        self.speed_var = self.usual_speed**2

    def go_on(self, pace: Pace) -> None:
        """Expect it after some time."""
        reach, decay, push = pace.reach_s, pace.decay, self.usual_speed**2
        self.value += reach * self.speed
        self.speed *= decay
        self.value_var += reach * (2 * self.both_var + reach * self.speed_var) + push * pace.value_spread
        self.both_var = decay * (self.both_var + reach * self.speed_var) + push * pace.both_spread
        self.speed_var = decay**2 * self.speed_var + push * pace.speed_spread

    def correct(self, difference: float, noise_var: float) -> None:
        """Take in that it was measured, so far from what was expected."""
        total = self.value_var + noise_var
        gain, speed_gain = self.value_var / total, self.both_var / total
        self.value += gain * difference
        self.speed += speed_gain * difference
        self.speed_var -= speed_gain * self.both_var
        self.value_var *= 1 - gain
        self.both_var *= 1 - gain
