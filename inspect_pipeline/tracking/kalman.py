"""Kalman filter of a value and its rate of change, in closed form.

The rate is an Ornstein-Uhlenbeck process: it is disturbed at random and decays with a time constant. Shortly
after a measurement the value is predicted to continue at its rate, long after it to have stopped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

_RATE_TIME_CONSTANT_S = 1.5


class Transition(NamedTuple):
    """State transition over a time step, with the process noise for a rate of standard deviation 1."""

    decay: float  # of the rate
    reach_s: float  # integral of the decaying rate, for an initial rate of 1
    value_var: float
    covariance: float
    rate_var: float

    @classmethod
    def over(cls, elapsed_s: float) -> Transition:
        """Return the transition over `elapsed_s` seconds."""
        tau_s, decay = _RATE_TIME_CONSTANT_S, math.exp(-elapsed_s / _RATE_TIME_CONSTANT_S)
        return cls(
            decay=decay,
            reach_s=tau_s * (1 - decay),
            value_var=tau_s**2 * (2 * elapsed_s / tau_s - 3 + 4 * decay - decay**2),
            covariance=tau_s * (1 - decay) ** 2,
            rate_var=1 - decay**2,
        )


@dataclass(slots=True)
class KalmanState:
    """A value and its rate, with their covariance. The rate is 0 +- `rate_std` at first."""

    value: float
    value_var: float
    rate_std: float
    rate: float = 0.0
    covariance: float = 0.0
    rate_var: float = field(init=False)

    def __post_init__(self) -> None:
        self.rate_var = self.rate_std**2

    def predict(self, step: Transition) -> None:
        """Move the state ahead in time."""
        reach, decay, noise = step.reach_s, step.decay, self.rate_std**2
        self.value += reach * self.rate
        self.rate *= decay
        self.value_var += reach * (2 * self.covariance + reach * self.rate_var) + noise * step.value_var
        self.covariance = decay * (self.covariance + reach * self.rate_var) + noise * step.covariance
        self.rate_var = decay**2 * self.rate_var + noise * step.rate_var

    def update(self, innovation: float, noise_var: float) -> None:
        """Apply a measurement of the value, as its difference from the prediction."""
        total = self.value_var + noise_var
        gain, rate_gain = self.value_var / total, self.covariance / total
        self.value += gain * innovation
        self.rate += rate_gain * innovation
        self.rate_var -= rate_gain * self.covariance
        self.value_var *= 1 - gain
        self.covariance *= 1 - gain
