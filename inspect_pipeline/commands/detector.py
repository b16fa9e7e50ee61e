"""The detector of a command, loaded late: torch and OpenVINO take seconds to import."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

from inspect_pipeline.commands.interrupts import stop_after_block

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lsnet import Detector


class _Options(NamedTuple):
    weights: str
    runtime: str
    scale: float | None
    min_score: float | None
    device: str | None


class LateDetector:
    """The options of a detector, which is loaded once, when it is first needed."""

    def __init__(
        self,
        weights: str,
        runtime: str,
        scale: float | None,
        min_score: float | None,
        device: str | None = None,
    ) -> None:
        self._options = _Options(weights, runtime, scale, min_score, device)

    def describe(self) -> Mapping[str, str | int | float]:
        """Return what determines the results, without loading where possible. Raises LSNetError."""
        from lsnet.description import describe_detector

        options = self._options._asdict()
        return describe_detector(options.pop("weights"), **options) or self.load().describe()

    def load(self) -> Detector:
        """Return the detector. Raises LSNetError."""
        return self._detector

    @cached_property
    def _detector(self) -> Detector:
        with stop_after_block():
            from lsnet import Detector

            options = self._options._asdict()
            return Detector.load(options.pop("weights"), **options)
