"""Frames through the detector: decoded and detected in threads, in bounded queues; what could not be decoded.

frames ── decode, quality (threads) ── prepare, infer, merge (threads) ── in order to the caller
"""

from __future__ import annotations

import time
from collections import Counter, defaultdict, deque
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from threading import Lock
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from inspect_pipeline.georeference.frame_pose import FramePose
from inspect_pipeline.images.quality import ImageQuality, measure_quality

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from concurrent.futures import Future

    from inspect_pipeline.arrays import Floats32
    from inspect_pipeline.recording.frames import UndecodedFrame
    from inspect_pipeline.recording.types import Frame
    from lsnet import Detections, Detector

_A = TypeVar("_A")
_B = TypeVar("_B")
_QUEUE_BYTES = 64 << 20  # of pixels in each of the two queues


class ProcessedFrame(NamedTuple):
    """A frame with its quality and detections, both None where it could not be decoded.

    track_scores: (N,) of the lines, NaN where unknown; None where tracks were not asked.
    """

    frame: Frame
    quality: ImageQuality | None = None
    detections: Detections | None = None
    infer_ms: float | None = None
    pose: FramePose = FramePose()
    track_scores: Floats32 | None = None


class StageTimes:
    """Wall and CPU time of the stages of a recording, from any threads.

    OpenVINO and torch compute in threads of their own, so the stage `infer` is charged with the CPU time of
    the process that no other stage has used.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._wall_s: defaultdict[str, float] = defaultdict(float)
        self._cpu_s: defaultdict[str, float] = defaultdict(float)
        self._started, self._started_cpu = time.perf_counter(), time.process_time()

    @contextmanager
    def measure(self, stage: str) -> Iterator[None]:
        """Add the time that the block takes to a stage."""
        started, started_cpu = time.perf_counter(), time.thread_time()
        yield
        wall_s, cpu_s = time.perf_counter() - started, time.thread_time() - started_cpu
        with self._lock:
            self._wall_s[stage] += wall_s
            self._cpu_s[stage] += cpu_s

    @property
    def wall_s(self) -> float:
        """Time since the beginning."""
        return time.perf_counter() - self._started

    def stages(self) -> dict[str, tuple[float, float]]:
        """Return wall and CPU seconds of each stage; those of different threads overlap."""
        cpu_s = time.process_time() - self._started_cpu
        rest_s = cpu_s - sum(spent for stage, spent in self._cpu_s.items() if stage != "infer")
        return {
            stage: (wall_s, rest_s if stage == "infer" else self._cpu_s[stage])
            for stage, wall_s in self._wall_s.items()
        }


def detect_frames(
    frames: Iterable[UndecodedFrame],
    detector: Detector,
    times: StageTimes | None = None,
    min_line_score: float | None = None,
) -> Iterator[ProcessedFrame]:
    """Yield every frame with its detections, in order; the next ones are decoded and detected meanwhile.

    Lines may have a score down to `min_line_score`, by default the least score of the detector.
    """
    times = times or StageTimes()
    room = _Room()

    def decode(frame: UndecodedFrame) -> ProcessedFrame:
        with times.measure("decode"):
            decoded = frame.decode()
        if decoded.image is None:
            return ProcessedFrame(decoded)
        room.note(decoded.image.nbytes)
        with times.measure("quality"):
            return ProcessedFrame(decoded, measure_quality(decoded.image))

    def detect(batch: list[ProcessedFrame]) -> list[ProcessedFrame]:
        return _detect(batch, detector, times, min_line_score)

    n_decoders, n_images = max(1, detector.threads // 2), detector.n_images
    with ThreadPoolExecutor(n_decoders) as decoders, ThreadPoolExecutor(detector.n_calls + 1) as detectors:
        undecoded = _timed(iter(frames), times)
        decoded = _in_order(decoders, decode, undecoded, lambda: room.limit(n_decoders + 2 * n_images))
        batches = _batches(decoded, lambda: room.limit(n_images))
        limit = detector.n_calls + 1
        for batch in _in_order(detectors, detect, batches, lambda: room.limit(limit * n_images) // n_images):
            yield from batch


def judge_by_tracks(
    frames: Iterable[ProcessedFrame], min_score: float, times: StageTimes
) -> Iterator[ProcessedFrame]:
    """Yield the same frames with the lines that are to be reported, a little later and without pixels.

    Lines down to `tracking.support.candidate_score` are candidates.
    """
    from inspect_pipeline.tracking.support import MOST_FRAMES, REACH_NS, TrackSupport  # noqa: PLC0415 - SciPy

    support = TrackSupport(min_score)
    waiting: deque[ProcessedFrame] = deque()

    def judge(each: ProcessedFrame) -> ProcessedFrame:
        if each.detections is None:
            return each
        with times.measure("track"):
            is_reported, track_scores = support.judge(each.frame, each.detections.lines)
            found = each.detections.take_lines(is_reported)
            return each._replace(detections=found, track_scores=track_scores[is_reported])

    for each in frames:
        if each.detections is not None:
            with times.measure("track"):
                support.add(each.frame, each.detections.lines, each.pose)
        waiting.append(each._replace(frame=replace(each.frame, image=None)))
        seen_ns = each.frame.log_time_ns - REACH_NS
        while waiting[0].frame.log_time_ns < seen_ns or len(waiting) > MOST_FRAMES:
            yield judge(waiting.popleft())
    yield from map(judge, waiting)


def _detect(
    batch: list[ProcessedFrame], detector: Detector, times: StageTimes, min_line_score: float | None
) -> list[ProcessedFrame]:
    images = [each.frame.image for each in batch if each.frame.image is not None]
    started = time.perf_counter()
    detect = partial(detector.detect, timed=times.measure, min_line_score=min_line_score)
    found = iter(detect(images) if images else [])
    infer_ms = (time.perf_counter() - started) * 1e3 / max(len(images), 1)
    return [
        each if each.frame.image is None else each._replace(detections=next(found), infer_ms=infer_ms)
        for each in batch
    ]


class _Room:
    """How many frames may wait, given the size of the largest so far; one until the first is decoded."""

    def __init__(self) -> None:
        self._n_bytes = 0

    def note(self, n_bytes: int) -> None:
        self._n_bytes = max(self._n_bytes, n_bytes)

    def limit(self, most: int) -> int:
        return max(1, min(most, _QUEUE_BYTES // self._n_bytes)) if self._n_bytes else 1


def _in_order(
    pool: ThreadPoolExecutor, function: Callable[[_A], _B], items: Iterable[_A], limit: Callable[[], int]
) -> Iterator[_B]:
    """Yield what a function makes of each item in the threads of a pool, at most so many items ahead."""
    waiting: deque[Future[_B]] = deque()
    try:
        for item in items:
            waiting.append(pool.submit(function, item))
            while len(waiting) > limit():
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()


def _batches(frames: Iterable[ProcessedFrame], size: Callable[[], int]) -> Iterator[list[ProcessedFrame]]:
    batch: list[ProcessedFrame] = []
    for frame in frames:
        batch.append(frame)
        if len(batch) >= size():
            yield batch
            batch = []
    if batch:
        yield batch


def _timed(frames: Iterator[UndecodedFrame], times: StageTimes) -> Iterator[UndecodedFrame]:
    """Yield the same frames; reading them is a stage."""
    while True:
        with times.measure("read"):
            frame = next(frames, None)
        if frame is None:
            return
        yield frame


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
