"""Which frame shows an anomaly or a span best, and where in it: chosen from the index, without any image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.index.cameras import load_places
from inspect_pipeline.index.reading import open_index
from inspect_pipeline.inspection.places import PLACE_COLUMNS
from inspect_pipeline.inspection.rules import PRIORITIES

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from inspect_pipeline.arrays import Floats
    from inspect_pipeline.index.reading import IndexReader
    from inspect_pipeline.report.data import Row
    from inspect_pipeline.store.store import Store

MAX_ANOMALIES, MAX_SPANS = 500, 40  # of a flight that get pictures
_CROP_M = 6.0  # side of a crop
_CROP_SHARES = (0.14, 0.4)  # and its limits, as shares of the longer side of the image

_ANOMALIES = "SELECT * FROM anomalies WHERE flight_id = ? ORDER BY start_ns, anomaly_id"
_FRAMES = f"""
SELECT f.channel_id, f.frame_idx, f.log_time_ns, {", ".join(PLACE_COLUMNS)}
FROM frames AS f
WHERE f.flight_id = $flight_id AND f.status <> 'bad'
  AND {{'channel_id': f.channel_id, 'frame_idx': f.frame_idx}} IN (SELECT unnest($keys))
"""  # noqa: S608 - names of columns
# The middle one of the frames in which conductors were counted on a span, of the camera with most of them.
_SPAN_FRAMES = """
SELECT span_id, channel_id, quantile_disc(frame_idx, 0.5) AS frame_idx
FROM conductor_counts
WHERE flight_id = ? AND span_id IS NOT NULL
GROUP BY span_id, channel_id
QUALIFY row_number() OVER (PARTITION BY span_id ORDER BY count(*) DESC, channel_id) = 1
ORDER BY span_id
"""
_LINES = """
SELECT channel_id, frame_idx, track_id, score, list_transform(points, lambda p: [p.x, p.y]) AS points
FROM lines
WHERE flight_id = $flight_id
  AND {'channel_id': channel_id, 'frame_idx': frame_idx} IN (SELECT unnest($keys))
ORDER BY channel_id, frame_idx, line_idx
"""

FrameKey = tuple[int, int]  # channel_id, frame_idx


@dataclass(frozen=True, slots=True)
class Crop:
    """A square of an image: its left and top edge and its side, px."""

    left: int
    top: int
    side: int


@dataclass(frozen=True, slots=True)
class Evidence:
    """The frame that shows something, and where: the mark (x, y, radius) in px of the image."""

    channel_id: int
    frame_idx: int
    log_time_ns: int
    width: int
    height: int
    mark: tuple[float, float, float] | None = None
    crop: Crop | None = None

    @property
    def key(self) -> FrameKey:
        """The frame."""
        return self.channel_id, self.frame_idx

    @property
    def picture_names(self) -> list[str]:
        """The names of its pictures, which say all that decides them."""
        name = f"{self.channel_id}-{self.frame_idx}"
        crop = self.crop
        return [f"{name}.jpg", *([f"{name}-{crop.left}-{crop.top}-{crop.side}.jpg"] if crop else [])]


@dataclass(frozen=True, slots=True)
class FlightEvidence:
    """Evidence of a flight by anomaly_id and by span_id, and the lines of its frames."""

    of_anomalies: Mapping[str, Evidence]
    of_spans: Mapping[str, Evidence]
    lines: Mapping[FrameKey, list[Row]]


def load_evidence(store: Store, flight_id: str) -> FlightEvidence:
    """Choose the frames as `find_evidence` does, from the index of the store. Raises StoreError."""
    with open_index(store) as index:
        return find_evidence(index, store, flight_id)


def find_evidence(index: IndexReader, store: Store, flight_id: str) -> FlightEvidence:
    """Choose the frames with which a report shows the anomalies and spans of a flight.

    Raises RulesError, SpansError, and the errors of the index.
    """
    anomalies = sorted(
        index.select(_ANOMALIES, [flight_id]), key=lambda row: PRIORITIES.index(row["priority"])
    )[:MAX_ANOMALIES]
    of_spans = index.select(_SPAN_FRAMES, [flight_id])[:MAX_SPANS]
    wanted = [(row["channel_id"], number) for row in anomalies for number in _candidates(row)]
    wanted += [(row["channel_id"], row["frame_idx"]) for row in of_spans]
    frames = {
        (row["channel_id"], row["frame_idx"]): row for row in _of_frames(index, _FRAMES, flight_id, wanted)
    }
    places = _Places(store, flight_id)
    found = {}
    for row in anomalies:
        own = [frames[key] for i in _candidates(row) if (key := (row["channel_id"], i)) in frames]
        if own:
            found[row["anomaly_id"]] = places.choose(row, own)
    spans = {
        row["span_id"]: _plain(frames[key])
        for row in of_spans
        if (key := (row["channel_id"], row["frame_idx"])) in frames
    }
    lines: dict[FrameKey, list[Row]] = {}
    for row in _of_frames(index, _LINES, flight_id, [one.key for one in (*found.values(), *spans.values())]):
        lines.setdefault((row["channel_id"], row["frame_idx"]), []).append(row)
    marked = {
        row["anomaly_id"]: _mark_track(row, found[row["anomaly_id"]], lines)
        for row in anomalies
        if row["anomaly_id"] in found
    }
    return FlightEvidence(marked, spans, lines)


def _candidates(anomaly: Row) -> list[int]:
    return anomaly["evidence_frames"] or [anomaly["first_frame_idx"]]


def _of_frames(index: IndexReader, sql: str, flight_id: str, keys: Iterable[FrameKey]) -> list[Row]:
    structs = [{"channel_id": channel_id, "frame_idx": frame_idx} for channel_id, frame_idx in set(keys)]
    return index.select(sql, {"flight_id": flight_id, "keys": structs}) if structs else []


def _plain(frame: Row) -> Evidence:
    names = ("channel_id", "frame_idx", "log_time_ns", "width", "height")
    return Evidence(*(frame[name] for name in names))


class _Places:
    """Places of anomalies on spans, seen by the cameras of frames."""

    def __init__(self, store: Store, flight_id: str) -> None:
        self._see = load_places(store, flight_id)

    def choose(self, anomaly: Row, frames: Sequence[Row]) -> Evidence:
        """Return the frame in which the place is nearest to the middle, else the middle frame."""
        seen = self._see(anomaly, frames)
        if np.isnan(seen).all():
            return _plain(frames[len(frames) // 2])
        sizes = np.array([[row["width"], row["height"]] for row in frames], np.float64)
        best = int(np.nanargmin(np.hypot(*(seen[:, :2] / sizes - 0.5).T)))
        return _marked(_plain(frames[best]), seen[best, :2], _CROP_M / seen[best, 2])


def _mark_track(anomaly: Row, evidence: Evidence, lines: Mapping[FrameKey, list[Row]]) -> Evidence:
    """Return evidence with the middle of the anomaly's own line marked, where it has one and no place."""
    if evidence.mark is not None or anomaly["track_id"] is None:
        return evidence
    for row in lines.get(evidence.key, ()):
        if row["track_id"] == anomaly["track_id"]:
            middle = np.asarray(row["points"], np.float64).mean(axis=0)
            return _marked(evidence, middle, 0.2 * max(evidence.width, evidence.height))
    return evidence


def _marked(evidence: Evidence, pixel: Floats, crop_px: float) -> Evidence:
    """Return evidence with a mark at a pixel, and a square crop around it inside the image."""
    longer, shorter = max(evidence.width, evidence.height), min(evidence.width, evidence.height)
    side = int(min(np.clip(crop_px, _CROP_SHARES[0] * longer, _CROP_SHARES[1] * longer), shorter))
    left = int(np.clip(pixel[0] - side / 2, 0, evidence.width - side))
    top = int(np.clip(pixel[1] - side / 2, 0, evidence.height - side))
    x, y = (round(float(value), 1) for value in pixel)
    mark = (x, y, round(side * 0.36, 1))
    return Evidence(
        evidence.channel_id,
        evidence.frame_idx,
        evidence.log_time_ns,
        evidence.width,
        evidence.height,
        mark,
        Crop(left, top, side),
    )
