"""The path of a recording: read, detect, track, write annotations and rows.

recording ── iter_undecoded ── detect_frames ── judge_by_tracks ── FlightTracker ──┬── annotations
                                                                                   └── rows in parquet
"""

from __future__ import annotations

import time
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from inspect_pipeline.annotations.annotator import ROS2_PROFILE, FrameAnnotator, message_format
from inspect_pipeline.config import DEFAULT_OPTIONS, load_detector, model_record, run_metadata, start_run
from inspect_pipeline.detection import DecodeCounts, StageTimes, detect_frames, judge_by_tracks
from inspect_pipeline.errors import EmptyResultError
from inspect_pipeline.georeference.signals import read_signals
from inspect_pipeline.index.flight_tables import FlightWriter
from inspect_pipeline.recording.append import annotated_copy, sidecar, unchanged
from inspect_pipeline.recording.frames import iter_undecoded
from inspect_pipeline.recording.reader import RUN_METADATA, join_phrases, open_recording
from inspect_pipeline.store.records import ANNOTATED, SIDECAR, FlightRecord, ProcessResult
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from inspect_pipeline.config import ProcessOptions
    from inspect_pipeline.detection import ProcessedFrame
    from inspect_pipeline.georeference.frames import Georeferencer
    from inspect_pipeline.georeference.signals import Signals
    from inspect_pipeline.recording.append import AnnotationWriter
    from inspect_pipeline.recording.frames import UndecodedFrame
    from inspect_pipeline.recording.reader import Recording
    from inspect_pipeline.recording.types import CameraChannel
    from inspect_pipeline.store.records import ModelRecord, RunRecord
    from inspect_pipeline.tracking.flight import FlightTracker
    from lsnet import Detector

_ANNOTATION_FILES = {"copy": ANNOTATED, "sidecar": SIDECAR, "none": None}


@dataclass(frozen=True, slots=True)
class Progress:
    """Number of frames done so far; `n_expected` is None where the recording does not state its counts."""

    n_frames: int
    n_expected: int | None


def process(
    path: str | os.PathLike[str],
    store: Store | str | os.PathLike[str],
    detector: Detector | Callable[[], Detector] | None = None,
    options: ProcessOptions = DEFAULT_OPTIONS,
    run: RunRecord | None = None,
    *,
    on_progress: Callable[[Progress], object] = lambda _: None,
    on_wait: Callable[[], object] = lambda: None,
    times: StageTimes | None = None,
) -> ProcessResult:
    """Detect the lines of a recording and write them to the store, completely or not at all.

    A recording that carries annotations of this program is skipped, and so is a flight that the store has
    by the same model and options. `publish` brings the flight into the index.

    Args:
        path: an MCAP file, or the folder of a split recording.
        store: the store, or its folder, which is created where it is missing.
        detector: by default the shipped weights. A function that loads one is called only if there is
            something to detect and `run` is given.
        options: the cameras, frames and outputs.
        run: the run that the flight belongs to; by default one of its own.
        on_progress: called after every frame.
        on_wait: called when another process works on this flight, before waiting for its end.
        times: takes the time of each stage.

    Raises:
        RecordingError: the recording cannot be read, or has no camera.
        StoreError: the store cannot be written.
        DetectorError: the shipped weights cannot be loaded.
    """
    started = time.monotonic()
    path, store = Path(path), store if isinstance(store, Store) else Store(Path(store))
    recording = open_recording(path, strict=options.strict)
    if recording.is_annotated_copy:
        skipped = ProcessResult(recording.flight_id, str(path), "skipped", path.absolute(), 0, 0, 0, 0.0)
        return replace(skipped, reason="it is an annotated copy")
    cameras = recording.select_cameras(options.topics)
    if run is None:
        detector = _load(detector)
        run = start_run(detector, options)
    known = store.load_flight(recording.flight_id)
    if known and _is_done(known, run, options):
        return _to_skipped(ProcessResult.of(known, path, store.flight_dir(known.flight_id), started))
    detector = _load(detector)
    with (
        store.lock_flight(recording.flight_id, on_wait),
        store.write_flight(recording.flight_id) as staging,
    ):
        known = store.load_flight(recording.flight_id)  # by a process that held the lock
        if known and _is_done(known, run, options):
            return _to_skipped(ProcessResult.of(known, path, store.flight_dir(known.flight_id), started))
        record = _write_flight(
            recording,
            cameras,
            detector,
            options,
            run,
            folder=staging.path,
            on_progress=on_progress,
            times=times or StageTimes(),
        )
        if known and not options.allow_empty:
            _refuse_empty(path, known, record)
        staging.commit(record)
    result = ProcessResult.of(record, path, store.flight_dir(record.flight_id), started)
    return replace(result, n_frames_replaced=known.totals.n_frames if known else None)


def _is_done(known: FlightRecord, run: RunRecord, options: ProcessOptions) -> bool:
    """Whether the stored flight is the result of the same model and options, and is to be kept."""
    return known.run.config_sha256 == run.config_sha256 and not options.force


def _to_skipped(result: ProcessResult) -> ProcessResult:
    """Return the result of a flight that is not processed again; one that has failed stays failed."""
    if result.status == "failed":
        return result
    return replace(result, status="skipped", reason=None, warnings=())


def _load(detector: Detector | Callable[[], Detector] | None) -> Detector:
    if detector is None:
        return load_detector()
    return detector() if callable(detector) else detector


def _refuse_empty(path: Path, known: FlightRecord, record: FlightRecord) -> None:
    """Raise EmptyResultError if the new record lacks decoded frames and the stored one has some."""
    n_known, n_new = (each.totals.n_frames - each.totals.n_bad_frames for each in (known, record))
    if n_known and not n_new:
        raise EmptyResultError(path, record.flight_id, n_known)


def _write_flight(
    recording: Recording,
    cameras: Sequence[CameraChannel],
    detector: Detector,
    options: ProcessOptions,
    run: RunRecord,
    *,
    folder: Path,
    on_progress: Callable[[Progress], object],
    times: StageTimes,
) -> FlightRecord:
    """Detect and track the lines of every frame, and write annotations and tables into `folder`."""
    model = model_record(detector)
    # SciPy takes half a second to import, which flights that are skipped do not need.
    from inspect_pipeline.georeference.frames import Georeferencer  # noqa: PLC0415
    from inspect_pipeline.tracking.flight import FlightTracker  # noqa: PLC0415

    signals = read_signals(recording, options.signals)
    georeferencer = Georeferencer.of(recording, options.placing)
    tracker = FlightTracker()
    frames = iter_undecoded(
        recording, cameras, every=options.every, start_ns=options.start_ns, end_ns=options.end_ns
    )
    decoded = DecodeCounts()
    n_expected = _expected_frames(cameras, options)
    with (
        _annotation_writer(recording, folder, options) as out,
        FlightWriter(folder, recording.flight_id) as tables,
    ):
        annotator = _annotator(out, recording, options, run, model) if out else None
        found_frames = _find_lines(
            frames, detector, georeferencer, options, min_score=model.score_threshold, times=times
        )
        for n_frames, each in enumerate(found_frames, 1):
            _write_frame(each, tracker, annotator, tables, signals=signals, times=times)
            decoded.add(each.frame)
            on_progress(Progress(n_frames, n_expected))
        with times.measure("index"):
            totals = tables.finish(tracker.finish())
    lost = (*recording.losses, *recording.identity.losses, *frames.losses, *georeferencer.poses.losses)
    losses = tuple(dict.fromkeys((*lost, *signals.losses, *(out.losses if out else ()))))
    return FlightRecord(
        flight_id=recording.flight_id,
        source_uri=recording.path.absolute().as_uri(),
        source_bytes=recording.size_bytes,
        status="failed" if decoded.failures else "recovered" if losses else "ok",
        reason=join_phrases((*decoded.failures, *losses)) or None,
        warnings=(
            *recording.warnings,
            *frames.warnings,
            *decoded.warnings,
            *signals.warnings,
            *_format_warnings(recording, options),
        ),
        annotations=_ANNOTATION_FILES[options.write],
        ingested_at=datetime.now(UTC),
        run=run,
        model=model,
        channels=tuple(cameras),
        totals=totals,
    )


def _annotator(
    out: AnnotationWriter, recording: Recording, options: ProcessOptions, run: RunRecord, model: ModelRecord
) -> FrameAnnotator:
    out.add_metadata(RUN_METADATA, run_metadata(recording.flight_id, run, model))
    return FrameAnnotator(out, message_format(options.schema, recording.profile), model.score_threshold)


def _write_frame(
    each: ProcessedFrame,
    tracker: FlightTracker,
    annotator: FrameAnnotator | None,
    tables: FlightWriter,
    *,
    signals: Signals,
    times: StageTimes,
) -> None:
    """Follow the lines of the next frame, and write its annotations and rows."""
    found = each.detections
    with times.measure("track"):
        track_ids = tracker.follow(each.frame, found.lines, each.pose) if found else None
    if annotator:
        with times.measure("annotate"):
            annotator.write(each.frame, found)
    with times.measure("index"):
        tables.add_frame(
            each.frame,
            found,
            track_ids,
            each.track_scores,
            infer_ms=each.infer_ms,
            sharpness=each.quality.sharpness if each.quality else None,
            mean_luma=each.quality.mean_luma if each.quality else None,
            place=each.pose,
            signals=signals.at(each.frame.log_time_ns),
        )


def _find_lines(
    frames: Iterable[UndecodedFrame],
    detector: Detector,
    georeferencer: Georeferencer,
    options: ProcessOptions,
    *,
    min_score: float,
    times: StageTimes,
) -> Iterator[ProcessedFrame]:
    """Yield every frame with its pose and the lines that are reported, in order."""
    from inspect_pipeline.tracking.support import candidate_score  # noqa: PLC0415 - SciPy

    lowest = candidate_score(min_score) if options.track_support else None
    detected = detect_frames(frames, detector, times, lowest)
    placed = (each._replace(pose=georeferencer.place(each.frame)) for each in detected)
    return judge_by_tracks(placed, min_score, times) if options.track_support else placed


@contextmanager
def _annotation_writer(
    recording: Recording, folder: Path, options: ProcessOptions
) -> Iterator[AnnotationWriter | None]:
    """Open what annotations are written to: a copy of the recording, a file of their own, or nothing."""
    if options.write == "copy":
        with annotated_copy(recording, folder / ANNOTATED) as out:
            yield out
    elif options.write == "sidecar":
        is_ros2 = message_format(options.schema, recording.profile) == "ros2msg"
        profile = ROS2_PROFILE if is_ros2 else ""
        with sidecar(recording, folder / SIDECAR, profile) as out:
            yield out
    else:
        with unchanged(recording):
            yield None


def _format_warnings(recording: Recording, options: ProcessOptions) -> list[str]:
    if options.write == "copy" and options.schema == "ros2msg" and recording.profile != ROS2_PROFILE:
        profile = f"profile {recording.profile!r}" if recording.profile else "no profile"
        return [f"players of ROS 2 bags do not open its annotated copy either: it has {profile}, not 'ros2'"]
    return []


def _expected_frames(cameras: Sequence[CameraChannel], options: ProcessOptions) -> int | None:
    counts = [camera.message_count for camera in cameras]
    if options.start_ns is not None or options.end_ns is not None:
        return None
    return sum(-(-count // options.every) for count in counts if count) if all(counts) else None
