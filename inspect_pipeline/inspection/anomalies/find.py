"""Find candidate anomalies of a flight.

    for anomaly in find_anomalies(cameras, spans, load_rules()):
        print(anomaly.kind, anomaly.reason, anomaly.evidence_frames)

Each kind has a rule: a function of the rows of one camera that yields findings. Rules about the conductors of
a span need spans, poses and a focal length; the others need none of these.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.anomalies.counts import count_conductors
from inspect_pipeline.inspection.anomalies.frames import FRAME_RULES
from inspect_pipeline.inspection.anomalies.lines import LINE_RULES
from inspect_pipeline.inspection.anomalies.on_spans import find_on_spans
from inspect_pipeline.inspection.judgement import merge_outcomes
from inspect_pipeline.inspection.poses import find_origin
from inspect_pipeline.inspection.rows import NO_TRACK, assess_frames
from inspect_pipeline.inspection.span_evidence import gather_evidence

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from inspect_pipeline.arrays import Mask
    from inspect_pipeline.inspection.anomalies.counts import CountRows
    from inspect_pipeline.inspection.anomalies.frames import Finding
    from inspect_pipeline.inspection.anomalies.on_spans import ConductorFindings
    from inspect_pipeline.inspection.conductors.rows import ConductorRow
    from inspect_pipeline.inspection.judgement import SpanJudgement
    from inspect_pipeline.inspection.rows import CameraRows, FrameRows
    from inspect_pipeline.inspection.rules import Priority, Rules
    from inspect_pipeline.inspection.span_evidence import SpanEvidence
    from inspect_pipeline.inspection.spans import Span

_MAX_EVIDENCE = 5
_MOSTLY = 0.5


@dataclass(frozen=True, slots=True)
class Anomaly:
    """A row of the table anomalies. anomaly_id is empty until `with_ids`."""

    kind: str
    channel_id: int
    reason: str
    value: float
    threshold: float
    unit: str
    first_frame_idx: int
    last_frame_idx: int
    evidence_frames: tuple[int, ...]
    start_ns: int
    end_ns: int
    track_id: int | None
    span_id: str | None
    lat_deg: float | None
    lon_deg: float | None
    priority: Priority
    anomaly_id: str = ""


@dataclass(frozen=True, slots=True)
class FlightFindings:
    """Anomalies of a flight, outcomes of the rules about conductors on its spans, conductors and counts."""

    anomalies: list[Anomaly]
    judgements: list[SpanJudgement]
    conductors: list[ConductorRow]
    counts: list[CountRows]


@dataclass(frozen=True, slots=True)
class Reviewed:
    """The anomaly of a review, as needed to find it again."""

    anomaly_id: str
    kind: str
    channel_id: int
    span_id: str | None
    start_ns: int
    end_ns: int


def find_anomalies(cameras: Sequence[CameraRows], spans: Sequence[Span], rules: Rules) -> list[Anomaly]:
    """Return the anomalies of a flight by all enabled rules, in time order."""
    return inspect_cameras(cameras, spans, rules).anomalies


def inspect_cameras(cameras: Sequence[CameraRows], spans: Sequence[Span], rules: Rules) -> FlightFindings:
    """Return the anomalies of a flight, and which parts of its spans each rule judged."""
    origin = find_origin(cameras)
    anomalies: list[Anomaly] = []
    judged: list[ConductorFindings] = []
    counts: list[CountRows] = []
    for camera in cameras:
        quality = assess_frames(camera.frames, rules)
        findings = [one for rule in (*FRAME_RULES, *LINE_RULES) for one in rule(camera, quality, rules)]
        evidence: list[SpanEvidence] = []
        if origin is not None:
            usable = quality.usable & _before_jumps(camera.frames, findings)
            evidence = gather_evidence(camera, spans, origin, usable, rules)
            judged.append(find_on_spans(camera.channel_id, evidence, origin, rules))
            findings = [
                one for one in findings if one.kind != "crossing_line" or not _is_on_span(one, evidence)
            ]
            findings += judged[-1].findings
        counts += count_conductors(camera, evidence, rules)
        anomalies += [
            _to_anomaly(camera, one, rules.priority(one.kind))
            for one in findings
            if rules.of(one.kind)["enabled"]
        ]
    anomalies.sort(key=lambda one: (one.start_ns, one.kind, one.channel_id, one.span_id or ""))
    return FlightFindings(
        anomalies,
        merge_outcomes([one.outcomes for one in judged]),
        [row for one in judged for row in one.conductors],
        counts,
    )


def _before_jumps(frames: FrameRows, findings: Sequence[Finding]) -> Mask:
    """Return the frames (N,) before any orientation jump, after which the recorded attitude is wrong."""
    jumps = [int(one.rows[-1]) for one in findings if one.kind == "orientation_jump"]
    return np.arange(len(frames)) < min(jumps, default=len(frames))


def _is_on_span(found: Finding, evidence: Sequence[SpanEvidence]) -> bool:
    """Return whether most frames of a crossing line show a span, whose own rule then applies."""
    if found.kind != "crossing_line":
        return False
    rows = [one.sight.rows[np.isfinite(one.sight.from_m)] for one in evidence]
    return bool(rows) and bool(np.isin(found.rows, np.concatenate(rows)).mean() > _MOSTLY)


def _to_anomaly(camera: CameraRows, found: Finding, priority: Priority) -> Anomaly:
    frames, rows = camera.frames, np.asarray(found.rows)
    # Lines without tracks have numbers that only the rules know.
    is_tracked = found.track_id != NO_TRACK and found.track_id in camera.lines.track
    evidence = rows[np.unique(np.linspace(0, len(rows) - 1, _MAX_EVIDENCE).round().astype(int))]
    first, last = int(rows[0]), int(rows[-1])
    lat_deg, lon_deg = found.place or (frames.lat_deg[first], frames.lon_deg[first])
    return Anomaly(
        kind=found.kind,
        channel_id=camera.channel_id,
        reason=found.reason,
        value=float(found.value),
        threshold=float(found.threshold),
        unit=found.unit,
        first_frame_idx=int(frames.frame_idx[first]),
        last_frame_idx=int(frames.frame_idx[last]),
        evidence_frames=tuple(frames.frame_idx[evidence].tolist()),
        start_ns=int(frames.log_time_ns[first]),
        end_ns=int(frames.log_time_ns[last]),
        track_id=found.track_id if is_tracked else None,
        span_id=found.span_id,
        lat_deg=float(lat_deg) if np.isfinite(lat_deg) else None,
        lon_deg=float(lon_deg) if np.isfinite(lon_deg) else None,
        priority=priority,
    )


def with_ids(flight_id: str, found: Sequence[Anomaly], reviewed: Sequence[Reviewed]) -> list[Anomaly]:
    """Give the anomalies of a flight ids that stay the same when it is processed again.

    A reviewed anomaly keeps its id as long as one of its kind overlaps its interval: another model or other
    thresholds may move its ends.
    """
    taken = _match(found, reviewed)
    occurrences: dict[str, int] = {}
    named = []
    for i, one in enumerate(found):
        key = f"{flight_id} {one.channel_id} {one.kind} {one.span_id} {one.first_frame_idx}"
        occurrences[key] = occurrences.get(key, 0) + 1
        own = hashlib.sha256(f"{key} {occurrences[key]}".encode()).hexdigest()[:12]
        named.append(replace(one, anomaly_id=taken.get(i, own)))
    return named


def _match(found: Sequence[Anomaly], reviewed: Sequence[Reviewed]) -> Mapping[int, str]:
    """Return reviewed ids by index of the anomaly, best overlap in time first."""
    pairs = sorted(_overlaps(found, reviewed), reverse=True)
    by_number: dict[int, str] = {}
    for _, number, anomaly_id in pairs:
        if number not in by_number and anomaly_id not in by_number.values():
            by_number[number] = anomaly_id
    return by_number


def _overlaps(found: Sequence[Anomaly], reviewed: Sequence[Reviewed]) -> Iterator[tuple[float, int, str]]:
    for number, one in enumerate(found):
        for old in reviewed:
            same = (old.kind, old.channel_id, old.span_id) == (one.kind, one.channel_id, one.span_id)
            common = min(one.end_ns, old.end_ns) - max(one.start_ns, old.start_ns)
            if same and common >= 0:
                whole = max(one.end_ns, old.end_ns) - min(one.start_ns, old.start_ns)
                yield (common / whole if whole else 1.0), number, old.anomaly_id
