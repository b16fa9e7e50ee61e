"""Flights in a store whose lines are the simulator's truth, disturbed or not: no pictures, no network."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import flights
import numpy as np

from inspect_pipeline.georeference.frame_pose import FramePose
from inspect_pipeline.index.flight_tables import FlightWriter
from inspect_pipeline.inspection.spans import Span
from inspect_pipeline.recording.types import Frame
from inspect_pipeline.simulation.options import SchemaKind
from inspect_pipeline.simulation.plan import plan_flight
from inspect_pipeline.simulation.truth import to_geodetic, to_local
from lsnet.segments import Detections, Lines, Segments

if TYPE_CHECKING:
    from pathlib import Path

    from inspect_pipeline.simulation.plan import FlightPlan
    from inspect_pipeline.simulation.records import FlightTruth, FrameTruth
    from inspect_pipeline.store.records import FlightTotals
    from inspect_pipeline.store.store import Store

CONDUCTOR_HEIGHT_M = 11.7


def write_truth(store: Store, name: str, truth: FlightTruth, rng: np.random.Generator | None = None) -> str:
    """A whole flight of true lines; with `rng` 2 px of noise, a tenth missed and a false line a frame."""
    flight_id = flights.flight_id_of(name)
    with store.write_flight(flight_id) as staging:
        totals = write_rows(staging.path, flight_id, truth, rng)
        record = flights.record(name, totals)
        is_stills = truth.options.schema == SchemaKind.PHOTOGRAPHS
        channels = tuple(replace(channel, is_stills=is_stills) for channel in record.channels)
        staging.commit(replace(record, channels=channels))
    return flight_id


def write_rows(
    folder: Path, flight_id: str, truth: FlightTruth, rng: np.random.Generator | None = None
) -> FlightTotals:
    hills = plan_flight(replace(truth.options, faults=())) if truth.options.hills_m else None
    with FlightWriter(folder, flight_id) as writer:
        rows = flights.TrackedRows(writer)
        for frame in truth.frames:
            if not frame.dropped:
                rows.add_frame(
                    _to_frame(frame),
                    _to_detections(frame, rng),
                    infer_ms=20.0,
                    sharpness=frame.sharpness,
                    mean_luma=frame.mean_luma,
                    place=_to_place(frame, hills),
                    signals={"battery": 90.0 - frame.frame_idx},
                )
        return rows.finish()


def spans_of(truth: FlightTruth) -> list[Span]:
    structures = {one.structure_id: one for one in truth.structures}
    spans = []
    for span in truth.spans:
        first, second = (structures[name] for name in span.structure_ids)
        spans.append(
            Span(
                span.span_id,
                "L12",
                *span.structure_ids,
                first.lat_deg,
                first.lon_deg,
                CONDUCTOR_HEIGHT_M,
                second.lat_deg,
                second.lon_deg,
                CONDUCTOR_HEIGHT_M,
                span.length_m,
                span.expected_conductors,
            )
        )
    return spans


def disturb(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return points + rng.normal(0, 2, points.shape)


def false_line(size: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """A line of 40 to 300 px anywhere in a picture of (height, width)."""
    middle, angle = rng.uniform((0, 0), size[::-1]), rng.uniform(0, np.pi)
    half = rng.uniform(20, 150) * np.array([np.cos(angle), np.sin(angle)])
    return np.clip([middle - half, middle + half], 0, size[::-1])


def seen_lines(frame: FrameTruth, rng: np.random.Generator | None) -> list[np.ndarray]:
    """The lines of a frame as a detector would give them; none where the picture shows none."""
    lines = [line.points for line in frame.lines] if frame.quality == "ok" else []
    if rng is None:
        return lines
    found = [disturb(points, rng) for points in lines if rng.random() >= 0.1]
    return [*found, false_line(frame.image_size, rng)]


def _to_frame(frame: FrameTruth) -> Frame:
    image = np.broadcast_to(np.uint8(0), (*frame.image_size, 3))  # its size is all that is asked for
    times = frame.log_time_ns, frame.log_time_ns, frame.stamp_ns
    return Frame(1, flights.TOPIC, frame.frame_idx or 0, *times, "camera", image)


def _to_detections(frame: FrameTruth, rng: np.random.Generator | None) -> Detections:
    points = tuple(line.astype(np.float32) for line in seen_lines(frame, rng))
    ends = np.array([(*line[0], *line[-1]) for line in points], np.float32).reshape(-1, 4)
    scores = np.full(len(points), 0.9, np.float32)
    size = frame.image_size
    return Detections(Segments(ends, scores, size), Lines(points, scores, size))


def _to_place(frame: FrameTruth, hills: FlightPlan | None) -> FramePose:
    """The pose of a frame, as with a terrain model where there are `hills`."""
    names = ("lat_deg", "lon_deg", "alt_m", "height_m", "heading_deg", "cam_roll_deg", "cam_pitch_deg")
    columns = {name: getattr(frame, name) for name in (*names, "cam_yaw_deg", "pose_age_ms", "focal_px")}
    if hills and frame.height_m is not None:
        columns |= {"height_m": frame.height_m - frame.ground_m, "rise_m": frame.ground_m}
        columns |= _sight(frame, hills)
    place = FramePose(**columns, attitude_source="camera")
    return place if frame.pose_age_ms is not None else replace(place, pose_age_ms=None)


def _sight(frame: FrameTruth, plan: FlightPlan) -> dict[str, float]:
    """Where the optical axis meets hills, to a tenth of a metre, and metres per pixel there."""
    x, y = to_local(plan, np.array(frame.lat_deg), np.array(frame.lon_deg))
    left, up = np.radians((plan.azimuth_deg - frame.cam_yaw_deg, frame.cam_pitch_deg))
    away_m = np.arange(0.0, 100.0, 0.1)
    steps = np.outer(away_m, (np.cos(up) * np.cos(left), np.cos(up) * np.sin(left), np.sin(up)))
    points = steps + np.array((float(x), float(y), frame.height_m + plan.takeoff_m))
    is_below = points[:, 2] <= plan.line.route.ground_m(points[:, 0])
    if not is_below.any():
        return {}
    met = int(np.argmax(is_below))
    lat_deg, lon_deg, _ = to_geodetic(plan, points[met])
    return {"ground_lat_deg": lat_deg, "ground_lon_deg": lon_deg, "gsd_m": away_m[met] / frame.focal_px}
