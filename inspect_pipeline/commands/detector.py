"""The detector of a command, loaded late: torch and OpenVINO take seconds to import."""

from __future__ import annotations

from typing import TYPE_CHECKING

from inspect_pipeline.commands.interrupts import nothing_to_clean_up

if TYPE_CHECKING:
    from lsnet import Detector


def load_detector(weights: str, runtime: str, scale: float | None, min_score: float | None) -> Detector:
    """Load a detector. Raises LSNetError."""
    with nothing_to_clean_up():
        from lsnet import Detector

        return Detector.load(weights, runtime=runtime, scale=scale, min_score=min_score)
