"""How much was seen, in four definitions that are never mixed.

frame      usable frames of those that the camera's median period lets expect
detection  time, and path, with at least one line that was followed over frames
span       metres of a span's axis with a line along it in a frame that shows them finely enough
corridor   the same of the ground below the path that was flown, with any followed line in the frame
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from inspect_pipeline.observations import (
    CameraRows,
    completed_lines,
    judge_frames,
    path_metres,
    place_cameras,
    tracked_lines,
)
from inspect_pipeline.projection import LocalMetres
from inspect_pipeline.span_views import make_axis, view_span, visible_gsd_m

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from inspect_pipeline.observations import FrameRows
    from inspect_pipeline.rules import Rules
    from inspect_pipeline.spans import Span

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]
    Mask = NDArray[np.bool_]

_MIN_GAP_FRAMES = 5  # without lines, before it is called a gap
_MAX_LOST = 2**31 - 1  # what its column holds; clocks that jump by centuries lose more


@dataclass(frozen=True, slots=True)
class Coverage:
    """A row of the table coverage."""

    kind: Literal["frame", "detection", "span", "corridor"]
    channel_id: int | None
    span_id: str | None
    unit: Literal["frames", "s", "m"]
    total: float
    imaged: float | None
    covered: float
    longest_gap_s: float | None
    longest_gap_m: float | None
    thresholds: dict[str, float]

    @property
    def share(self) -> float | None:
        """Covered of total, 0 to 1."""
        return self.covered / self.total if self.total > 0 else None


@dataclass(frozen=True, slots=True)
class Gap:
    """A row of the table coverage_gaps."""

    kind: Literal["frame", "detection"]
    channel_id: int
    first_frame_idx: int
    last_frame_idx: int
    n_frames: int
    start_ns: int
    end_ns: int
    length_m: float | None

    @property
    def duration_s(self) -> float:
        """From start to end."""
        return (self.end_ns - self.start_ns) / 1e9


@dataclass(frozen=True, slots=True, eq=False)
class Bins:
    """Rows of the table coverage_bins, those of one span or of the corridor: arrays (B,)."""

    kind: Literal["span", "corridor"]
    span_id: str | None
    bin_m: float
    lat_deg: Floats
    lon_deg: Floats
    n_frames: Ints
    n_detected: Ints
    best_gsd_m: Floats
    first_ns: Ints
    last_ns: Ints


@dataclass(frozen=True, slots=True)
class FlightCoverage:
    """All that a flight covered."""

    numbers: tuple[Coverage, ...]
    gaps: tuple[Gap, ...]
    bins: tuple[Bins, ...]


def measure_coverage(cameras: Sequence[CameraRows], spans: Sequence[Span], rules: Rules) -> FlightCoverage:
    """The coverage of a flight by all its cameras."""
    numbers: list[Coverage] = []
    gaps: list[Gap] = []
    for camera in cameras:
        numbers += [_frame_coverage(camera, rules), *_detection_coverage(camera, rules)]
        gaps += [*_dropouts(camera, rules), *_detection_gaps(camera, rules)]
    numbers += _over_cameras(numbers)
    origin = find_origin(cameras)
    if origin is None:
        return FlightCoverage(tuple(numbers), tuple(gaps), ())
    bins = [*_span_bins(cameras, spans, origin, rules), *_corridor_bins(cameras, origin, rules)]
    numbers += [_count_bins(one, rules) for one in bins]
    return FlightCoverage(tuple(numbers), tuple(gaps), tuple(bins))


def find_origin(cameras: Sequence[CameraRows]) -> LocalMetres | None:
    """The first known position of a flight."""
    for camera in cameras:
        known = np.flatnonzero(np.isfinite(camera.frames.lat_deg) & np.isfinite(camera.frames.lon_deg))
        if len(known):
            return LocalMetres(camera.frames.lat_deg[known[0]], camera.frames.lon_deg[known[0]])
    return None


def has_lines(camera: CameraRows, rules: Rules) -> Mask:
    """(N,) whether a frame has a line that was followed, be it missed in this frame."""
    lines = tracked_lines(camera.lines, rules)
    if len(lines) and np.any(lines.track >= 0):
        lines = completed_lines(lines, rules.tracks["max_missed_frames"])
    found = np.zeros(len(camera.frames), bool)
    found[lines.frame] = True
    return found & camera.frames.is_ok


def _frame_coverage(camera: CameraRows, rules: Rules) -> Coverage:
    frames = camera.frames
    usable = int(judge_frames(frames, rules).usable.sum())
    is_regular = len(frames) > 1 and frames.period_s > 0
    expected = round(frames.times_s[-1] / frames.period_s) + 1 if is_regular else len(frames)
    gaps = list(_dropouts(camera, rules))
    lengths_m = [gap.length_m for gap in gaps if gap.length_m is not None]
    return Coverage(
        "frame",
        camera.channel_id,
        None,
        "frames",
        total=float(max(expected, len(frames))),
        imaged=None,
        covered=float(usable),
        longest_gap_s=max((gap.duration_s for gap in gaps), default=0.0),
        longest_gap_m=max(lengths_m, default=None),
        thresholds=dict(rules.frames),
    )


def _dropouts(camera: CameraRows, rules: Rules) -> Iterator[Gap]:
    """Pauses between frames."""
    frames, walked = camera.frames, path_metres(camera.frames)
    pauses = np.diff(frames.times_s)
    factor = rules.frames["dropout_factor"]
    for i in np.flatnonzero(pauses > factor * frames.period_s).tolist() if len(pauses) else ():
        n_lost = max(1, round(pauses[i] / frames.period_s) - 1) if frames.period_s > 0 else 1
        yield _gap("frame", camera, (i, i + 1), min(n_lost, _MAX_LOST), walked)


def _detection_gaps(camera: CameraRows, rules: Rules) -> Iterator[Gap]:
    """Stretches of good frames without lines; bad frames neither count nor interrupt."""
    good = np.flatnonzero(camera.frames.is_ok)
    walked = path_metres(camera.frames)
    for first, stop in _runs(~has_lines(camera, rules)[good]):
        if stop - first >= _MIN_GAP_FRAMES:
            rows = int(good[first]), int(good[stop - 1])
            yield _gap("detection", camera, rows, stop - first, walked)


def _gap(
    kind: Literal["frame", "detection"], camera: CameraRows, rows: tuple[int, int], n: int, walked: Floats
) -> Gap:
    first, last = rows
    frames, length_m = camera.frames, walked[last] - walked[first]
    return Gap(
        kind,
        camera.channel_id,
        int(frames.frame_idx[first]),
        int(frames.frame_idx[last]),
        n,
        int(frames.log_time_ns[first]),
        int(frames.log_time_ns[last]),
        float(length_m) if np.isfinite(length_m) else None,
    )


def _detection_coverage(camera: CameraRows, rules: Rules) -> Iterator[Coverage]:
    """By time and by path: a frame stands for half the way to its neighbours, unless frames are missing."""
    frames, found = camera.frames, has_lines(camera, rules)
    pauses = np.diff(frames.times_s)
    is_whole = pauses <= rules.frames["dropout_factor"] * frames.period_s
    share = np.where(is_whole, (found[:-1].astype(np.float64) + found[1:]) / 2, 0.0)
    gaps = list(_detection_gaps(camera, rules))
    lengths_m = [gap.length_m for gap in gaps if gap.length_m is not None]
    steps_m = np.diff(path_metres(frames))
    known = np.isfinite(steps_m)
    thresholds = {**rules.tracks, "dropout_factor": rules.frames["dropout_factor"]}
    measures: list[tuple[Literal["s", "m"], Floats, Floats]] = [("s", pauses, share)]
    if known.any():
        measures.append(("m", steps_m[known], share[known]))
    for unit, steps, shares in measures:
        yield Coverage(
            "detection",
            camera.channel_id,
            None,
            unit,
            total=float(steps.sum()),
            imaged=None,
            covered=float((steps * shares).sum()),
            longest_gap_s=max((gap.duration_s for gap in gaps), default=0.0),
            longest_gap_m=max(lengths_m, default=None),
            thresholds=thresholds,
        )


def _over_cameras(numbers: Sequence[Coverage]) -> list[Coverage]:
    """The sums over the cameras of a flight, by kind and unit; the longest gap is that of any camera."""
    sums = []
    for kind, unit in dict.fromkeys((one.kind, one.unit) for one in numbers):
        same = [one for one in numbers if (one.kind, one.unit) == (kind, unit)]
        gaps_s = [one.longest_gap_s for one in same if one.longest_gap_s is not None]
        gaps_m = [one.longest_gap_m for one in same if one.longest_gap_m is not None]
        sums.append(
            Coverage(
                kind,
                None,
                None,
                unit,
                total=sum(one.total for one in same),
                imaged=None,
                covered=sum(one.covered for one in same),
                longest_gap_s=max(gaps_s, default=None),
                longest_gap_m=max(gaps_m, default=None),
                thresholds=same[0].thresholds,
            )
        )
    return sums


def _span_bins(
    cameras: Sequence[CameraRows], spans: Sequence[Span], origin: LocalMetres, rules: Rules
) -> Iterator[Bins]:
    """The bins of the spans near the path."""
    paths = [origin.to_metres(c.frames.lat_deg, c.frames.lon_deg) for c in cameras]
    path = np.concatenate(paths)
    path = path[np.isfinite(path).all(axis=1)]
    for span in spans:
        axis = make_axis(span, origin, rules)
        if not is_near(axis.middles[:, :2], path, rules.coverage["near_m"]):
            continue
        seen = _Seen(len(axis.middles))
        for camera in cameras:
            usable = judge_frames(camera.frames, rules).usable
            placed = place_cameras(camera.frames, origin, rules)
            lines = tracked_lines(camera.lines, rules)
            view = view_span(axis, placed, lines, rules)
            shown = _fine(view.gsd_m, usable, rules)
            hit = np.zeros(shown.shape, bool)
            hit[view.frame, view.bin] = True
            seen.add(shown, hit & np.isfinite(shown), camera.frames)
        yield seen.to_bins("span", span.span_id, axis.bin_m, axis.middles, origin)


def _corridor_bins(cameras: Sequence[CameraRows], origin: LocalMetres, rules: Rules) -> Iterator[Bins]:
    """The bins of the path on the ground, of the first camera with positions: all fly together."""
    flown = next(c.frames for c in cameras if np.isfinite(c.frames.lat_deg).any())
    middles, bin_m = _cut_path(flown, origin, rules.coverage["bin_m"])
    if not len(middles):
        return
    seen = _Seen(len(middles))
    for camera in cameras:
        usable = judge_frames(camera.frames, rules).usable
        placed = place_cameras(camera.frames, origin, rules)
        shown = _fine(visible_gsd_m(placed, middles), usable, rules)
        hit = np.isfinite(shown) & has_lines(camera, rules)[:, np.newaxis]
        seen.add(shown, hit, camera.frames)
    yield seen.to_bins("corridor", None, bin_m, middles, origin)


def _cut_path(frames: FrameRows, origin: LocalMetres, bin_m: float) -> tuple[Floats, float]:
    """(B, 3) the middles of pieces of the path, on the ground, and how long each is."""
    walked = path_metres(frames)
    known = np.isfinite(walked) & np.isfinite(frames.lat_deg) & np.isfinite(frames.lon_deg)
    if known.sum() < 2 or walked[known][-1] < bin_m:
        return np.zeros((0, 3)), bin_m
    places = origin.to_metres(frames.lat_deg[known], frames.lon_deg[known])
    total = walked[known][-1]
    n_bins = max(1, round(total / bin_m))
    at = (np.arange(n_bins) + 0.5) * total / n_bins
    columns = [np.interp(at, walked[known], column) for column in places.T]
    return np.column_stack((*columns, np.zeros(n_bins))), total / n_bins


def _fine(gsd_m: Floats, usable: Mask, rules: Rules) -> Floats:
    """The metres per pixel where a usable frame shows a bin finely enough, else NaN."""
    with np.errstate(invalid="ignore"):
        is_fine = gsd_m <= rules.coverage["max_gsd_m"]
    return np.where(usable[:, np.newaxis] & is_fine, gsd_m, np.nan)


class _Seen:
    """What the cameras of a flight saw of bins."""

    def __init__(self, n_bins: int) -> None:
        self.n_frames = np.zeros(n_bins, np.int64)
        self.n_detected = np.zeros(n_bins, np.int64)
        self.best_gsd_m = np.full(n_bins, np.nan)
        self.first_ns = np.full(n_bins, np.iinfo(np.int64).max)
        self.last_ns = np.zeros(n_bins, np.int64)

    def add(self, gsd_m: Floats, hit: Mask, frames: FrameRows) -> None:
        """Count frames: gsd_m (N, B) is NaN where a frame does not show a bin, hit (N, B) has its lines."""
        self.n_frames += np.isfinite(gsd_m).sum(axis=0)
        self.n_detected += hit.sum(axis=0)
        self.best_gsd_m = np.fmin(self.best_gsd_m, np.fmin.reduce(gsd_m, axis=0, initial=np.nan))
        rows, bins = np.nonzero(hit)
        np.minimum.at(self.first_ns, bins, frames.log_time_ns[rows])
        np.maximum.at(self.last_ns, bins, frames.log_time_ns[rows])

    def to_bins(
        self,
        kind: Literal["span", "corridor"],
        span_id: str | None,
        bin_m: float,
        middles: Floats,
        origin: LocalMetres,
    ) -> Bins:
        lat_deg, lon_deg = origin.to_degrees(middles[:, :2])
        return Bins(
            kind,
            span_id,
            bin_m,
            lat_deg,
            lon_deg,
            self.n_frames,
            self.n_detected,
            self.best_gsd_m,
            self.first_ns,
            self.last_ns,
        )


def _count_bins(bins: Bins, rules: Rules) -> Coverage:
    is_covered = bins.n_detected > 0
    longest = max((stop - first for first, stop in _runs(~is_covered)), default=0)
    names = ("bin_m", "max_gsd_m", "corridor_half_m", "max_angle_deg", "max_pose_age_ms")
    return Coverage(
        bins.kind,
        None,
        bins.span_id,
        "m",
        total=len(is_covered) * bins.bin_m,
        imaged=float((bins.n_frames > 0).sum() * bins.bin_m),
        covered=float(is_covered.sum() * bins.bin_m),
        longest_gap_s=None,
        longest_gap_m=float(longest * bins.bin_m),
        thresholds={name: rules.coverage[name] for name in names},
    )


def is_near(places: Floats, path: Floats, near_m: float) -> bool:
    """Whether any of (B, 2) places is within a distance of any of (N, 2) places of a path."""
    if not len(path):
        return False
    step = max(1, len(path) // 2000)
    away = places[:, np.newaxis] - path[np.newaxis, ::step]
    return bool((np.hypot(away[..., 0], away[..., 1]) <= near_m).any())


def _runs(mask: Mask) -> list[tuple[int, int]]:
    """First and one past the last of each run of True."""
    edges = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0))
    return [(int(first), int(stop)) for first, stop in edges.reshape(-1, 2)]
