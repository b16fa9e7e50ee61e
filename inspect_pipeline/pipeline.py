"""The one path: a recording in; annotations in a copy of it or beside it, and rows in the store out.

recording ─ iter_frames ─ batches, decoded one ahead ─ detect ─┬─ annotated.mcap, or annotations.mcap
                                                               └─ frames, segments, lines, tracks.parquet
"""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, NamedTuple

from inspect_pipeline.annotations.annotator import FrameAnnotator
from inspect_pipeline.config import model_record, run_metadata
from inspect_pipeline.georeference.frames import Georeferencer
from inspect_pipeline.images.quality import ImageQuality, measure_quality
from inspect_pipeline.index.flight_tables import FlightWriter
from inspect_pipeline.recording.append import annotated_copy, sidecar, unchanged
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import RUN_METADATA, join_phrases, open_recording
from inspect_pipeline.store.records import ANNOTATED, SIDECAR, FlightRecord, ProcessResult
from inspect_pipeline.tracking.flight import FlightTracker

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

    from inspect_pipeline.config import ProcessOptions
    from inspect_pipeline.recording.append import AnnotationWriter
    from inspect_pipeline.recording.frames import RecordingIterator
    from inspect_pipeline.recording.reader import Recording
    from inspect_pipeline.recording.types import CameraChannel, Frame
    from inspect_pipeline.store.records import FlightTotals, ModelRecord, RunRecord
    from inspect_pipeline.store.store import Store
    from lsnet import Detections, Detector

_FILES = {"copy": ANNOTATED, "sidecar": SIDECAR, "none": None}
_BATCH_FRAMES = 8
_BATCH_BYTES = 32 << 20  # of pixels; two batches are in memory at a time


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a recording is processed; `n_expected` is None where only the end will tell."""

    n_frames: int
    n_expected: int | None


def process(
    path: Path,
    store: Store,
    detector: Detector,
    options: ProcessOptions,
    run: RunRecord,
    *,
    on_progress: Callable[[Progress], object] = lambda _: None,
) -> ProcessResult:
    """Find the segments of a recording and keep them in the store, whole or not at all.

    `path` may be the folder of a split recording. An annotated copy is skipped, and so is a flight that the
    store has by the same model and config. The index is left to `index.publish`. Raises RecordingError,
    StoreError.
    """
    started = time.monotonic()
    recording = open_recording(path, strict=options.strict)
    if recording.is_annotated_copy:
        skipped = ProcessResult(recording.flight_id, str(path), "skipped", path.absolute(), 0, 0, 0, 0.0)
        return replace(skipped, reason="it is an annotated copy")
    cameras = recording.select_cameras(options.topics)
    known = store.load_flight(recording.flight_id)
    if known and known.run.config_sha256 == run.config_sha256 and not options.force:
        result = _to_result(known, path, store, started)
        return replace(result, status="skipped", reason=None, warnings=())
    model = model_record(detector)
    with store.write_flight(recording.flight_id) as staging:
        frames = iter_frames(
            recording, cameras, every=options.every, start_ns=options.start_ns, end_ns=options.end_ns
        )
        seen = _look(frames, detector, on_progress, _expected_frames(cameras, options))
        metadata = run_metadata(recording.flight_id, run, model)
        written = _write(recording, cameras, staging.path, options, metadata=metadata, seen_frames=seen)
        record = _to_record(
            recording, cameras, options=options, run=run, model=model, written=written, frames=frames
        )
        staging.commit(record)
    return _to_result(record, path, store, started)


class _ProcessedFrame(NamedTuple):
    """A frame with what was measured and found in it, None where it could not be decoded."""

    frame: Frame
    quality: ImageQuality | None
    detections: Detections | None = None
    infer_ms: float | None = None


def _look(
    frames: Iterable[Frame],
    detector: Detector,
    on_progress: Callable[[Progress], object],
    n_expected: int | None,
) -> Iterator[_ProcessedFrame]:
    """Every frame with its detections."""
    n_frames = 0
    for batch in _one_ahead(_batched(frames)):
        yield from _detect(detector, batch)
        n_frames += len(batch)
        on_progress(Progress(n_frames, n_expected))


def _batched(frames: Iterable[Frame]) -> Iterator[list[_ProcessedFrame]]:
    """Decoded frames with their quality, a few at a time: bounded in number and in bytes."""
    batch: list[_ProcessedFrame] = []
    n_bytes = 0
    for frame in frames:
        batch.append(
            _ProcessedFrame(frame, measure_quality(frame.image) if frame.image is not None else None)
        )
        n_bytes += frame.image.nbytes if frame.image is not None else 0
        if len(batch) == _BATCH_FRAMES or n_bytes >= _BATCH_BYTES:
            yield batch
            batch, n_bytes = [], 0
    if batch:
        yield batch


def _one_ahead(batches: Iterator[list[_ProcessedFrame]]) -> Iterator[list[_ProcessedFrame]]:
    """The same batches, the next one made in a thread while the current one is used."""
    with ThreadPoolExecutor(1) as pool:
        coming = pool.submit(next, batches, None)
        while (batch := coming.result()) is not None:
            coming = pool.submit(next, batches, None)
            yield batch


def _detect(detector: Detector, batch: list[_ProcessedFrame]) -> list[_ProcessedFrame]:
    """The batch with detections, at the mean time per image."""
    images = [seen.frame.image for seen in batch if seen.frame.image is not None]
    started = time.perf_counter()
    found = iter(detector.detect(images) if images else [])
    infer_ms = (time.perf_counter() - started) * 1e3 / max(len(images), 1)
    return [
        seen if seen.quality is None else seen._replace(detections=next(found), infer_ms=infer_ms)
        for seen in batch
    ]


class _Written(NamedTuple):
    """What was written of a flight, and what could not be read on the way."""

    totals: FlightTotals
    losses: tuple[str, ...]


def _write(
    recording: Recording,
    cameras: tuple[CameraChannel, ...],
    folder: Path,
    options: ProcessOptions,
    *,
    metadata: dict[str, str],
    seen_frames: Iterable[_ProcessedFrame],
) -> _Written:
    """Write every frame to annotations and to tables in `folder`."""
    placer = Georeferencer.of(recording, cameras, options.placing)
    with (
        _annotations(recording, folder, options) as out,
        FlightWriter(folder, recording.flight_id) as tables,
    ):
        if out:
            out.add_metadata(RUN_METADATA, metadata)
        annotator = FrameAnnotator(out, options.schema) if out else None
        tracker = FlightTracker()
        for seen in seen_frames:
            if annotator:
                annotator.write(seen.frame, seen.detections)
            place = placer.place(seen.frame)
            track_ids = tracker.follow(seen.frame, seen.detections.lines, place) if seen.detections else None
            tables.add_frame(
                seen.frame,
                seen.detections,
                track_ids,
                infer_ms=seen.infer_ms,
                sharpness=seen.quality.sharpness if seen.quality else None,
                mean_luma=seen.quality.mean_luma if seen.quality else None,
                place=place,
            )
        totals = tables.finish(tracker.finish())
    return _Written(totals, (*placer.poses.losses, *(out.losses if out else ())))


@contextmanager
def _annotations(
    recording: Recording, folder: Path, options: ProcessOptions
) -> Iterator[AnnotationWriter | None]:
    """Where annotations go: a copy of the recording, a file of their own, or nowhere."""
    if options.write == "copy":
        with annotated_copy(recording, folder / ANNOTATED) as out:
            yield out
    elif options.write == "sidecar":
        profile = "ros2" if options.schema == "ros2msg" else ""
        with sidecar(recording, folder / SIDECAR, profile) as out:
            yield out
    else:
        with unchanged(recording):
            yield None


def _expected_frames(cameras: tuple[CameraChannel, ...], options: ProcessOptions) -> int | None:
    counts = [camera.message_count for camera in cameras]
    if options.start_ns is not None or options.end_ns is not None:
        return None
    return sum(-(-count // options.every) for count in counts if count) if all(counts) else None


def _to_record(
    source: Recording,
    cameras: tuple[CameraChannel, ...],
    *,
    options: ProcessOptions,
    run: RunRecord,
    model: ModelRecord,
    written: _Written,
    frames: RecordingIterator[Frame],
) -> FlightRecord:
    losses = dict.fromkeys((*source.losses, *source.identity.losses, *frames.losses, *written.losses))
    return FlightRecord(
        flight_id=source.flight_id,
        source_uri=source.path.absolute().as_uri(),
        source_bytes=source.size_bytes,
        status="recovered" if losses else "ok",
        reason=join_phrases(list(losses)) or None,
        warnings=(*source.warnings, *frames.warnings),
        annotations=_FILES[options.write],
        ingested_at=datetime.now(UTC),
        run=run,
        model=model,
        channels=cameras,
        totals=written.totals,
    )


def _to_result(record: FlightRecord, path: Path, store: Store, started: float) -> ProcessResult:
    folder = store.flight_dir(record.flight_id)
    return ProcessResult(
        flight_id=record.flight_id,
        source=str(path),
        status=record.status,
        annotated=folder / record.annotations if record.annotations else None,
        n_frames=record.totals.n_frames,
        n_bad_frames=record.totals.n_bad_frames,
        n_segments=record.totals.n_segments,
        seconds=round(time.monotonic() - started, 3),
        reason=record.reason,
        warnings=record.warnings,
    )
