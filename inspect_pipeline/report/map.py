"""The map of a report: spans, path, gaps and anomalies in local metres, as shapes for the template."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.geometry.local_frame import LocalMetres
from inspect_pipeline.report.words import metres, nice_step

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from inspect_pipeline.arrays import Floats
    from inspect_pipeline.report.data import Row

WIDTH, _MIN_HEIGHT, _MAX_HEIGHT, _MARGIN = 720.0, 240.0, 440.0, 44.0  # in units of the drawing
_PATH_TOLERANCE = 0.7  # in units of the drawing
_MIN_EXTENT_M = 20.0
_LABEL_GAP, _MARK_GAP, _STRUCTURE_GAP = 34.0, 19.0, 9.0  # what is nearer to another is left out or small
_ASIDE = 13.0  # of the line, where labels of spans and structures stand
_UPRIGHT, _MAX_NAMES = 0.25, 16


@dataclass(frozen=True, slots=True)
class Stroke:
    """A polyline, as the value of the SVG attribute `points`."""

    points: str
    state: str
    title: str
    target: str = ""


@dataclass(frozen=True, slots=True)
class Mark:
    """A point with its text; `target` is the id of the element it leads to.

    kind: the priority of an anomaly, or the side of a label at which the point is (SVG text-anchor).
    """

    x: float
    y: float
    label: str
    title: str
    kind: str = ""
    target: str = ""


@dataclass(frozen=True, slots=True)
class FlightMap:
    """Everything on the map; `scale_px` is the length of the scale bar, which stands for `scale_label`."""

    height: float
    scale_px: float
    scale_label: str
    strokes: list[Stroke] = field(default_factory=list)
    path: list[str] = field(default_factory=list)
    gaps: list[Stroke] = field(default_factory=list)
    structures: list[Mark] = field(default_factory=list)
    labels: list[Mark] = field(default_factory=list)
    anomalies: list[Mark] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class _Projection:
    """From degrees to the drawing: x to the right, y down."""

    frame: LocalMetres
    left_m: float
    top_m: float
    per_m: float
    offset: Floats

    def __call__(self, lat_deg: Floats | float, lon_deg: Floats | float) -> Floats:
        east_north = self.frame.to_metres(lat_deg, lon_deg)
        drawn: Floats = (east_north - (self.left_m, self.top_m)) * (self.per_m, -self.per_m) + self.offset
        return drawn


def draw_map(
    *,
    spans: Sequence[Row],
    stretches: Sequence[Row],
    frames: Sequence[Row],
    gaps: Sequence[Row],
    anomalies: Sequence[Row],
    targets: Mapping[str, str],
) -> FlightMap | None:
    """Lay out the map of a flight; None without any position.

    Args:
        spans: with their ends and `share`.
        stretches: of spans, each with its state.
        frames: in time order, with positions where they are known.
        gaps: of coverage.
        anomalies: in the order in which they are numbered.
        targets: ids of the page's elements about spans, by span_id.
    """
    placed = [row for row in frames if row["lat_deg"] is not None]
    where = _positions(placed)
    ends = np.array(
        [[row[f"{end}_lat_deg"], row[f"{end}_lon_deg"]] for row in spans for end in ("from", "to")]
    ).reshape(-1, 2)
    everything = np.vstack(
        (where, ends, _positions([row for row in anomalies if row["lat_deg"] is not None]))
    )
    if not len(everything):
        return None
    project, height, scale_m = _fit(everything)
    drawn = FlightMap(height, scale_m * project.per_m, metres(scale_m))
    drawn_path = project(where[:, 0], where[:, 1])
    drawn.path.extend(_pieces(drawn_path, placed, gaps))
    drawn.gaps.extend(_gap_strokes(drawn_path, placed, gaps))
    ends_px = project(ends[:, 0], ends[:, 1]).reshape(-1, 2, 2)
    _add_spans(
        drawn, dict(zip((row["span_id"] for row in spans), ends_px, strict=True)), spans, stretches, targets
    )
    drawn.anomalies.extend(_anomaly_marks(project, anomalies))
    return drawn


def _anomaly_marks(project: _Projection, anomalies: Sequence[Row]) -> list[Mark]:
    """Return a mark for each anomaly with a place, the first ones last, so that they are on top.

    Those near an earlier one have no label.
    """
    marks: list[Mark] = []
    labelled: list[Floats] = []
    for number, row in enumerate(anomalies, 1):
        if row["lat_deg"] is not None:
            place = project(row["lat_deg"], row["lon_deg"])
            is_free = all(np.hypot(*(place - other)) > _MARK_GAP for other in labelled)
            if is_free:
                labelled.append(place)
            title, target = f"{number}: {row['reason']}", f"finding-{row['anomaly_id']}"
            label = str(number) if is_free else ""
            marks.append(Mark(float(place[0]), float(place[1]), label, title, row["priority"], target))
    marks.reverse()
    return sorted(marks, key=lambda mark: bool(mark.label))


def _positions(placed: Sequence[Row]) -> Floats:
    return np.array([[row["lat_deg"], row["lon_deg"]] for row in placed], np.float64).reshape(-1, 2)


def _fit(everything: Floats) -> tuple[_Projection, float, float]:
    """Return the projection that fits all (N, 2) degrees, the height of the drawing, and the scale in m."""
    low, high = everything.min(axis=0), everything.max(axis=0)
    frame = LocalMetres(*((low + high) / 2).tolist())
    places = frame.to_metres(everything[:, 0], everything[:, 1])
    low_m, high_m = places.min(axis=0), places.max(axis=0)
    extent = np.maximum(high_m - low_m, _MIN_EXTENT_M)
    middle = (low_m + high_m) / 2
    per_m = min((WIDTH - 2 * _MARGIN) / extent[0], (_MAX_HEIGHT - 2 * _MARGIN) / extent[1])
    height = max(_MIN_HEIGHT, float(extent[1] * per_m) + 2 * _MARGIN)
    offset = np.array([WIDTH / 2, height / 2])
    return _Projection(frame, middle[0], middle[1], per_m, offset), height, nice_step(75 / per_m, 1)


def _add_spans(
    drawn: FlightMap,
    ends: Mapping[str, Floats],
    spans: Sequence[Row],
    stretches: Sequence[Row],
    targets: Mapping[str, str],
) -> None:
    titles = {row["span_id"]: _describe_span(row) for row in spans}
    for one in stretches:
        if one["span_id"] in ends:
            start, end = ends[one["span_id"]]
            shares = np.array([one["first"], one["stop"]])[:, np.newaxis] / one["n_bins"]
            title, target = titles[one["span_id"]], targets.get(one["span_id"], "")
            drawn.strokes.append(Stroke(_points(start + shares * (end - start)), one["state"], title, target))
    _add_labels(drawn, ends, spans, titles)


def _add_labels(
    drawn: FlightMap, ends: Mapping[str, Floats], spans: Sequence[Row], titles: Mapping[str, str]
) -> None:
    """Add shares to the right of the spans, structures, and their names to the left while they are few."""
    taken: list[Floats] = []
    structures: dict[tuple[int, int], tuple[str, Floats, Floats]] = {}
    for row in spans:
        start, end = ends[row["span_id"]]
        aside, middle = _to_the_right(end - start), (start + end) / 2
        anchor = "start" if aside[0] > _UPRIGHT else "middle"
        if all(np.hypot(*(middle - other)) > _LABEL_GAP for other in taken):
            taken.append(middle)
            share = "?" if row["share"] is None else f"{100 * row['share']:.0f} %"
            drawn.labels.append(_mark(middle + _ASIDE * aside, share, titles[row["span_id"]], anchor))
        for which, place in (("from", start), ("to", end)):
            key = (round(float(place[0]) / _STRUCTURE_GAP), round(float(place[1]) / _STRUCTURE_GAP))
            structures.setdefault(key, (row[f"{which}_structure"] or "", place, aside))
    are_named = len(structures) <= _MAX_NAMES
    for name, place, aside in structures.values():
        drawn.structures.append(_mark(place, "", name))
        if are_named and name:
            anchor = "end" if aside[0] > _UPRIGHT else "middle"
            drawn.labels.append(_mark(place - _ASIDE * aside, name, name, anchor))


def _mark(place: Floats, label: str, title: str, kind: str = "") -> Mark:
    return Mark(float(place[0]), float(place[1]), label, title, kind)


def _to_the_right(along: Floats) -> Floats:
    """Return the unit vector across a direction (2,) that points to the right, of a level one upwards."""
    aside: Floats = np.array([-along[1], along[0]]) / max(float(np.hypot(*along)), 1e-9)
    is_right = aside[0] > 0 if abs(aside[0]) > _UPRIGHT else aside[1] < 0
    return aside if is_right else -aside


def _describe_span(row: Row) -> str:
    if row["share"] is None:
        return f"Span {row['span_id']}: not known, {row['reason']}"
    return f"Span {row['span_id']}: lines seen on {100 * row['share']:.0f} % of {metres(row['length_m'])}"


def _pieces(drawn: Floats, placed: Sequence[Row], gaps: Sequence[Row]) -> list[str]:
    """Return the path without the pauses between frames."""
    if len(drawn) < 2:
        return []
    times = np.array([row["log_time_ns"] for row in placed])
    ends = [gap["end_ns"] for gap in gaps if gap["kind"] == "frame"]
    cuts = [0, *np.unique(np.searchsorted(times, ends)).tolist(), len(times)]
    pieces = (drawn[start:stop] for start, stop in pairwise(cuts))
    return [_points(simplify(piece, _PATH_TOLERANCE)) for piece in pieces if len(piece) > 1]


def _gap_strokes(drawn: Floats, placed: Sequence[Row], gaps: Sequence[Row]) -> list[Stroke]:
    times = np.array([row["log_time_ns"] for row in placed])
    strokes = []
    for gap in gaps:
        start, stop = np.searchsorted(times, gap["start_ns"]), np.searchsorted(times, gap["end_ns"], "right")
        if stop - start > 1:
            what = "no frames" if gap["kind"] == "frame" else "no lines"
            title = f"{gap['duration_s']:.1f} s: {what}"
            points = _points(simplify(drawn[start:stop], _PATH_TOLERANCE))
            strokes.append(Stroke(points, f"gap-{gap['kind']}", title))
    return strokes


def simplify(points: Floats, tolerance: float) -> Floats:
    """Return the polyline (N, 2) without points nearer than `tolerance` to it, by Douglas and Peucker."""
    kept = np.zeros(len(points), bool)
    kept[[0, -1]] = True
    stack = [(0, len(points) - 1)]
    while stack:
        first, last = stack.pop()
        if last - first < 2:
            continue
        chord, inner = points[last] - points[first], points[first + 1 : last] - points[first]
        length2 = float(chord @ chord)
        shares = np.clip(inner @ chord / length2, 0, 1) if length2 else np.zeros(len(inner))
        aside = np.hypot(*(inner - shares[:, np.newaxis] * chord).T)
        worst = int(aside.argmax())
        if aside[worst] > tolerance:
            middle = first + 1 + worst
            kept[middle] = True
            stack += [(first, middle), (middle, last)]
    return points[kept]


def _points(points: Floats) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points.tolist())
