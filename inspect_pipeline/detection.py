"""Frames through the detector: batches decoded one ahead, and counts of what could not be decoded."""

from __future__ import annotations

import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, NamedTuple

from inspect_pipeline.images.quality import ImageQuality, measure_quality

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from inspect_pipeline.recording.types import Frame
    from lsnet import Detections, Detector

_BATCH_FRAMES = 8
_BATCH_BYTES = 32 << 20  # of pixels; two batches are in memory at a time


class ProcessedFrame(NamedTuple):
    """A frame with its quality and detections, both None where it could not be decoded."""

    frame: Frame
    quality: ImageQuality | None = None
    detections: Detections | None = None
    infer_ms: float | None = None


def detect_frames(frames: Iterable[Frame], detector: Detector) -> Iterator[ProcessedFrame]:
    """Yield every frame with its detections; the next batch is decoded while one is detected."""
    for batch in _one_ahead(_batches(frames)):
        images = [each.frame.image for each in batch if each.frame.image is not None]
        started = time.perf_counter()
        found = iter(detector.detect(images) if images else [])
        infer_ms = (time.perf_counter() - started) * 1e3 / max(len(images), 1)
        for each in batch:
            if each.frame.image is None:
                yield each
            else:
                yield each._replace(detections=next(found), infer_ms=infer_ms)


def _batches(frames: Iterable[Frame]) -> Iterator[list[ProcessedFrame]]:
    """Group decoded frames with their quality, limited in number and in bytes."""
    batch: list[ProcessedFrame] = []
    n_bytes = 0
    for frame in frames:
        batch.append(ProcessedFrame(frame, None if frame.image is None else measure_quality(frame.image)))
        n_bytes += 0 if frame.image is None else frame.image.nbytes
        if len(batch) == _BATCH_FRAMES or n_bytes >= _BATCH_BYTES:
            yield batch
            batch, n_bytes = [], 0
    if batch:
        yield batch


def _one_ahead(batches: Iterator[list[ProcessedFrame]]) -> Iterator[list[ProcessedFrame]]:
    """Yield the same batches; a thread makes the next one while the current one is in use."""
    with ThreadPoolExecutor(1) as pool:
        coming = pool.submit(next, batches, None)
        while (batch := coming.result()) is not None:
            coming = pool.submit(next, batches, None)
            yield batch


class DecodeCounts:
    """Counts the frames of each camera that could and could not be decoded."""

    def __init__(self) -> None:
        self._n_good: Counter[str] = Counter()
        self._errors: dict[str, Counter[str]] = {}

    def add(self, frame: Frame) -> None:
        """Count a frame."""
        if frame.error is None:
            self._n_good[frame.topic] += 1
        else:
            self._errors.setdefault(frame.topic, Counter())[frame.error] += 1

    @property
    def failures(self) -> list[str]:
        """One phrase for each camera of which no frame could be decoded."""
        return [self._phrase(topic) for topic in self._errors if not self._n_good[topic]]

    @property
    def warnings(self) -> list[str]:
        """One phrase for each other camera with frames that could not be decoded."""
        return [self._phrase(topic) for topic in self._errors if self._n_good[topic]]

    def _phrase(self, topic: str) -> str:
        errors = self._errors[topic]
        n_bad, (reason, n_alike) = errors.total(), errors.most_common(1)[0]
        share = "" if n_alike == n_bad else f" ({n_alike} times)"
        return f"{topic}: {n_bad} of {n_bad + self._n_good[topic]} frames cannot be decoded: {reason}{share}"
