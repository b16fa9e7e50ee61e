"""Compute the ground truth of a simulated flight, without drawing it.

    truth = simulate_truth(SimulationOptions(seconds=60, faults=(FaultKind.MISSING_CONDUCTOR,)))

Points are sampled along the conductors and projected by the simulator's own camera. The code shares nothing
with the packages geometry, georeference, tracking and inspection, which are measured against it.
"""

from __future__ import annotations

from bisect import bisect_right
from functools import partial
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np
import pyproj

from inspect_pipeline.simulation.options import FaultKind
from inspect_pipeline.simulation.plan import POSE_PERIOD_NS, START_NS, plan_flight
from inspect_pipeline.simulation.power_line import POLE_HEIGHT_M, SPAN_M
from inspect_pipeline.simulation.records import (
    FaultTruth,
    FlightTruth,
    FrameTruth,
    LineTruth,
    SeenInterval,
    SpanTruth,
    SpanViewTruth,
    StructureTruth,
)
from inspect_pipeline.simulation.scene import visible_parts

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.arrays import Floats, Ints
    from inspect_pipeline.simulation.options import SimulationOptions
    from inspect_pipeline.simulation.plan import FlightPlan, Shot
    from inspect_pipeline.simulation.records import Quality
    from inspect_pipeline.simulation.scene import SimulatedCamera


GROUND_M = 43.0  # ellipsoidal altitude of z = 0
_ORIGIN_DEG = (52.09, 5.12)  # of x = y = 0
_EARTH = pyproj.Geod(ellps="WGS84")
_LINE_STEP_PX = 12.0
_SHOWN_SHARE = {FaultKind.CROSSING_LINE: 0.1}  # of the most evidence in a frame; else half
_STRUCK: dict[FaultKind, Quality] = {
    FaultKind.BLUR: "blurred",
    FaultKind.DARK: "dark",
    FaultKind.OVEREXPOSED: "overexposed",
}
_MEASURES: dict[Quality, tuple[float, float]] = {  # sharpness, mean_luma of drawn frames
    "ok": (200.0, 98.0),
    "blurred": (12.0, 98.0),
    "dark": (20.0, 12.0),
    "overexposed": (60.0, 243.0),
}


def simulate_truth(options: SimulationOptions) -> FlightTruth:
    """Return the ground truth of a flight. Raises ValueError for an impossible line."""
    return truth_of(plan_flight(options))


def truth_of(plan: FlightPlan) -> FlightTruth:
    """Return the ground truth of a planned flight."""
    frames: list[FrameTruth] = []
    shown, n_recorded = [], 0
    is_seen = np.zeros(len(plan.axis), bool)
    position_times_ns = plan.position_times_ns()
    for shot in plan.shots():
        camera = plan.camera(shot.time_ns)
        frame = _frame(plan, shot, camera, n_recorded, position_times_ns)
        n_recorded += not frame.dropped
        if frame.quality == "ok" and not frame.dropped:
            is_seen[plan.axis_seen(camera)] = True
        shown.append([_n_visible(camera, fault.evidence) for fault in plan.planted])
        frames.append(frame)
    return FlightTruth(
        options=plan.options,
        frames=tuple(frames),
        structures=_structures(plan),
        spans=_spans(plan),
        spans_seen=tuple(_spans_seen(plan, frames)),
        span_coverage={
            plan.span_id(i): float(share) for i, share in enumerate(plan.shares_of_spans(is_seen))
        },
        faults=(*_line_faults(plan, frames, np.array(shown)), *_timed_faults(plan, frames)),
    )


def _frame(
    plan: FlightPlan, shot: Shot, camera: SimulatedCamera, frame_idx: int, position_times_ns: Sequence[int]
) -> FrameTruth:
    i = bisect_right(position_times_ns, shot.time_ns) - 1
    fixed_ns = position_times_ns[max(i, 0)]
    fixed = plan.recorded_pose(fixed_ns).position
    lat_deg, lon_deg, alt_m = to_geodetic(plan, np.array(fixed))
    turned = plan.recorded_pose(shot.time_ns - shot.time_ns % POSE_PERIOD_NS)
    quality = _quality(plan, shot)
    rng = np.random.default_rng([plan.options.seed, 2, shot.number])
    sharpness, mean_luma = _MEASURES[quality] * rng.uniform(0.95, 1.05, 2)
    return FrameTruth(
        frame_idx=None if shot.is_dropped else frame_idx,
        log_time_ns=START_NS + shot.time_ns,
        stamp_ns=plan.stamp_ns(shot.time_ns),
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        alt_m=alt_m,
        height_m=turned.position[2] - plan.takeoff_m,
        ground_m=float(plan.line.route.ground_m(fixed[0])) - plan.takeoff_m,
        heading_deg=compass_deg(plan, turned.heading_rad),
        cam_yaw_deg=compass_deg(plan, turned.yaw_rad),
        cam_pitch_deg=-float(np.rad2deg(turned.pitch_rad)),
        cam_roll_deg=float(np.rad2deg(turned.roll_rad)),
        pose_age_ms=(shot.time_ns - fixed_ns) / 1e6 if i >= 0 else None,
        image_size=camera.image_size,
        focal_px=camera.focal_px,
        quality=quality,
        sharpness=float(sharpness),
        mean_luma=float(mean_luma),
        lines=tuple(_visible_lines(plan, camera)),
        views=tuple(_views(plan, camera)),
    )


def _quality(plan: FlightPlan, shot: Shot) -> Quality:
    struck = (name for kind, name in _STRUCK.items() if plan.struck_by(kind, shot.time_ns))
    return next(struck, "ok")


def to_geodetic(plan: FlightPlan, point: Floats) -> tuple[float, float, float]:
    """Return latitude, longitude and ellipsoidal altitude of x, y, z in m."""
    along, left, up = point.tolist()
    lat_deg, lon_deg = _ORIGIN_DEG
    azimuth_deg = plan.azimuth_deg - np.rad2deg(np.arctan2(left, along))
    there_lon_deg, there_lat_deg, _ = _EARTH.fwd(lon_deg, lat_deg, azimuth_deg, np.hypot(along, left))
    return float(there_lat_deg), float(there_lon_deg), GROUND_M + up


def to_east_north(plan: FlightPlan, x: float, y: float) -> tuple[float, float]:
    """Return the metres east and north of the origin."""
    azimuth_rad = np.deg2rad(plan.azimuth_deg)
    sine, cosine = float(np.sin(azimuth_rad)), float(np.cos(azimuth_rad))
    return x * sine - y * cosine, x * cosine + y * sine


def to_local(plan: FlightPlan, lat_deg: Floats, lon_deg: Floats) -> tuple[Floats, Floats]:
    """Return x and y in m, each of the shape of latitudes and longitudes."""
    origin_lat_deg, origin_lon_deg = (np.full_like(lat_deg, degrees) for degrees in _ORIGIN_DEG)
    azimuth_deg, _, away_m = _EARTH.inv(origin_lon_deg, origin_lat_deg, lon_deg, lat_deg)
    turned_rad = np.deg2rad(plan.azimuth_deg - azimuth_deg)
    return away_m * np.cos(turned_rad), away_m * np.sin(turned_rad)


def compass_deg(plan: FlightPlan, yaw_rad: float) -> float:
    """Turn an angle to the left of x into one clockwise from north, within -180 <= angle < 180."""
    return float((plan.azimuth_deg - np.rad2deg(yaw_rad) + 180) % 360 - 180)


def _visible_lines(plan: FlightPlan, camera: SimulatedCamera) -> list[LineTruth]:
    lines = []
    for conductor in (*plan.line.conductors, *plan.line.foreign):
        for part in visible_parts(camera, conductor):
            walked_px = np.concatenate(([0.0], np.hypot(*np.diff(part.pixels, axis=0).T).cumsum()))
            _, kept = np.unique(walked_px // _LINE_STEP_PX, return_index=True)
            kept = np.union1d(kept, [len(walked_px) - 1])
            spans: list[int] = []
            if conductor not in plan.line.foreign:
                spans = plan.line.span_numbers(plan.line.along[part.first : part.last]).tolist()
            most = max(set(spans), key=spans.count, default=None)
            lines.append(
                LineTruth(
                    conductor_id=conductor.conductor_id,
                    span_id=None if most is None else plan.span_id(most),
                    span_ids=tuple(plan.span_id(span) for span in sorted(set(spans))),
                    points=part.pixels[kept],
                    width_px=part.widths_px[kept],
                )
            )
    return lines


def _views(plan: FlightPlan, camera: SimulatedCamera) -> list[SpanViewTruth]:
    seen = plan.axis_seen(camera)
    along = plan.axis_along[seen]
    numbers = plan.line.span_numbers(along)
    views = []
    for span in np.unique(numbers).tolist():
        is_here = numbers == span
        along_m = along[is_here] - plan.line.structures_along[span]
        gsd_m = np.linalg.norm(plan.axis[seen[is_here]] - camera.position, axis=1) / camera.focal_px
        views.append(
            SpanViewTruth(
                plan.span_id(span),
                float(along_m.min()),
                float(along_m.max()),
                float(gsd_m.min()),
                float(gsd_m.max()),
            )
        )
    return views


def _n_visible(camera: SimulatedCamera, points: Floats) -> int:
    return int(np.count_nonzero(camera.sees(*camera.project(points))))


def _structures(plan: FlightPlan) -> tuple[StructureTruth, ...]:
    return tuple(
        StructureTruth(plan.structure_id(i), *to_geodetic(plan, structure.foot), POLE_HEIGHT_M)
        for i, structure in enumerate(plan.line.structures)
    )


def _spans(plan: FlightPlan) -> tuple[SpanTruth, ...]:
    return tuple(
        SpanTruth(
            plan.span_id(span),
            (plan.structure_id(span), plan.structure_id(span + 1)),
            SPAN_M,
            len(plan.line.conductors),
        )
        for span in range(plan.line.n_structures - 1)
    )


def _spans_seen(plan: FlightPlan, frames: Sequence[FrameTruth]) -> list[SeenInterval]:
    recorded = [frame for frame in frames if not frame.dropped]
    seen = []
    for span in _spans(plan):
        for is_shown, run in groupby(recorded, partial(_shows, span_id=span.span_id)):
            if is_shown:
                times_ns = [frame.log_time_ns for frame in run]
                seen.append(SeenInterval(span.span_id, times_ns[0], times_ns[-1]))
    return sorted(seen, key=lambda interval: (interval.start_ns, interval.span_id))


def _shows(frame: FrameTruth, span_id: str) -> bool:
    return any(view.span_id == span_id for view in frame.views)


def _line_faults(plan: FlightPlan, frames: Sequence[FrameTruth], shown: Ints) -> list[FaultTruth]:
    """Return the faults that recorded frames show; shown (n_frames, n_faults) counts points of evidence."""
    recorded = [i for i, frame in enumerate(frames) if not frame.dropped]
    faults = []
    for number, fault in enumerate(plan.planted):
        counts = shown[recorded, number]
        least = max(1.0, _SHOWN_SHARE.get(fault.kind, 0.5) * counts.max())
        edges = np.flatnonzero(np.diff(counts >= least, prepend=False, append=False)).reshape(-1, 2)
        if len(edges):
            first, end = edges[np.argmax(edges[:, 1] - edges[:, 0])].tolist()
            start_ns, end_ns = (frames[recorded[i]].log_time_ns for i in (first, end - 1))
            span_id = plan.span_id(fault.span)
            faults.append(FaultTruth(fault.kind, start_ns, end_ns, span_id, fault.conductor_ids))
    return faults


def _timed_faults(plan: FlightPlan, frames: Sequence[FrameTruth]) -> list[FaultTruth]:
    times_ns = [frame.log_time_ns for frame in frames if not frame.dropped]
    fixes_ns = [START_NS + time_ns for time_ns in plan.position_times_ns()]
    faults = []
    for fault in plan.timed:
        start_ns, end_ns = (START_NS + round(t * 1e9) for t in (fault.start_s, fault.end_s))
        if fault.kind in _STRUCK:
            inside = [time_ns for time_ns in times_ns if start_ns <= time_ns < end_ns]
            around = (inside[0], inside[-1]) if inside else None
        elif fault.kind == FaultKind.GPS_GAP:
            around = _around(fixes_ns, start_ns, end_ns)
        elif fault.kind == FaultKind.DROPOUT:
            around = _around(times_ns, start_ns, end_ns)
        else:
            around = _around(times_ns, start_ns, start_ns)
        if around:
            faults.append(FaultTruth(fault.kind, *around, None, ()))
    return faults


def _around(times_ns: Sequence[int], start_ns: int, end_ns: int) -> tuple[int, int] | None:
    """Return the last time before an interval and the first after it; None when either is missing."""
    before = [time_ns for time_ns in times_ns if time_ns < start_ns]
    after = [time_ns for time_ns in times_ns if time_ns >= end_ns]
    return (before[-1], after[0]) if before and after else None
