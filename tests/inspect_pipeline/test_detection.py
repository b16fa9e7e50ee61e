"""Frames through the detector: in order, at most so many ahead, timed by stage."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from threading import Barrier
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from fakes import FakeDetector

from inspect_pipeline import detection
from inspect_pipeline.detection import StageTimes, detect_frames
from inspect_pipeline.recording.types import Frame

if TYPE_CHECKING:
    from collections.abc import Iterator


@dataclass
class LateFrame:
    """Decodes to one colour, the later ones sooner; every fifth cannot be decoded."""

    number: int
    size: tuple[int, int] = (32, 32)

    def decode(self) -> Frame:
        time.sleep(0.002 * (self.number % 3 == 0))
        image = None if self.number % 5 == 4 else np.full((*self.size, 3), self.number, np.uint8)
        return Frame(1, "/camera", self.number, 0, 0, 0, "", image, None if image is not None else "bad")


@dataclass
class Source:
    n_frames: int
    size: tuple[int, int] = (32, 32)
    taken: list[int] = field(default_factory=list)

    def __iter__(self) -> Iterator[LateFrame]:
        for number in range(self.n_frames):
            self.taken.append(number)
            yield LateFrame(number, self.size)


def detector(n_images: int = 1) -> FakeDetector:
    made = FakeDetector()
    made.n_images = n_images
    return made


@pytest.mark.parametrize("n_images", [1, 4])
def test_frames_come_in_order_and_few_are_ahead(n_images: int) -> None:
    source, ahead = Source(40), []
    for number, each in enumerate(detect_frames(source, detector(n_images))):
        assert each.frame.frame_idx == number
        assert (each.detections is None) == (each.quality is None) == (number % 5 == 4)
        if each.detections is not None:
            assert len(each.detections.segments) == min(number // 4, 3)
        ahead.append(len(source.taken) - number)
    assert number == 39
    assert 4 <= max(ahead) <= 2 + 6 * n_images


def test_large_frames_are_not_queued(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(detection, "_QUEUE_BYTES", 3 * 64 * 64)
    source, ahead = Source(20, (64, 64)), []
    for number, _ in enumerate(detect_frames(source, detector(4))):
        ahead.append(len(source.taken) - number)
    assert max(ahead) <= 4


def test_calls_of_the_detector_overlap() -> None:
    together = Barrier(2, timeout=20)

    class Waiting(FakeDetector):
        def detect(self, images: Any, **options: object) -> Any:
            together.wait()
            return super().detect(images, **options)

    used = Waiting()
    used.n_images = 1
    frames = [LateFrame(number) for number in (0, 1, 2, 3)]
    assert len(list(detect_frames(frames, used))) == 4  # else the barrier breaks


def test_stages_are_timed_on_one_clock() -> None:
    times = StageTimes()
    list(detect_frames(Source(6), detector(), times))
    with times.measure("infer"):
        sum(i * i for i in range(100_000))
    stages = times.stages()
    assert set(stages) == {"read", "decode", "quality", "infer"}
    assert 0.004 <= stages["decode"][0] <= times.wall_s
    assert stages["infer"][1] > 0.001


def test_frames_that_are_not_wanted_any_more_are_dropped() -> None:
    source = Source(1000)
    frames = detect_frames(source, detector())
    next(frames)
    frames.close()
    assert len(source.taken) < 20
