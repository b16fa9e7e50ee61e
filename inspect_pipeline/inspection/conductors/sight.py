"""What the frames of a camera show of a span, as crossings of lines with bins, and how finely."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.span_view import view_span

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats, Ints, Mask
    from inspect_pipeline.geometry.camera import CameraPoses
    from inspect_pipeline.inspection.conductors.layout import Place
    from inspect_pipeline.inspection.rows import LineRows
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.span_view import SpanAxis, SpanView

_STEP_M = 0.1
_EXACT_SD_M = 0.3
_WIDEN_SD = 1.5  # of errors of positions


@dataclass(frozen=True, eq=False)
class SpanSight:
    """What N frames, the rows `rows` of a camera, show of a span of B bins.

    view: crossings (C,) of lines with bins, at the nominal height of the conductors. from_m, side_m (N,):
    positions of the camera along and to the left. above_m (N, B): heights of the camera above the nominal
    conductor. scale_px (N, B): pixels per metre across, perpendicular to the span in the image. gsd_m (N, B):
    metres per pixel. shown, coarse (N, B): where a frame shows a bin, and where too coarsely. noise_m:
    standard deviation of lines about the places of conductors. shift_sd_m: of errors of positions.
    """

    axis: SpanAxis
    rows: Ints
    cameras: CameraPoses
    lines: LineRows
    view: SpanView
    from_m: Floats
    side_m: Floats
    above_m: Floats
    scale_px: Floats
    gsd_m: Floats
    shown: Mask
    coarse: Mask
    noise_m: float = 0.1
    shift_sd_m: float = 0.1

    @property
    def widened_bins(self) -> int:
        """By how many bins errors of positions blur each end of a stretch without a conductor."""
        return round(_WIDEN_SD * self.shift_sd_m / self.axis.bin_m)

    @property
    def is_exact(self) -> bool:
        """Whether errors of positions are too small to look like parallax, or to mix up conductors."""
        return self.shift_sd_m <= _EXACT_SD_M

    @property
    def fine(self) -> Mask:
        """Where a frame shows a bin finely enough (N, B)."""
        return self.shown & ~self.coarse

    @property
    def parabola(self) -> Floats:
        """Share (B,) of the sag in the middle by which a conductor hangs below its chord."""
        share = self.axis.bins_m / self.axis.length_m
        return np.asarray(4 * share * (1 - share))

    def move(self, across_m: Floats, shift_m: Floats, scale: Floats) -> SpanSight:
        """Return the same sight with other positions across of its crossings, and of its cameras.

        shift_m, scale (N,): by which cameras are shifted across, and their heights multiplied.
        """
        return replace(
            self,
            view=replace(self.view, across_m=across_m),
            side_m=self.side_m + shift_m,
            above_m=self.above_m * np.asarray(scale)[:, np.newaxis],
        )

    def points_of(self, place: Place) -> Floats:
        """Return the points (B, 3) of a conductor at the bins."""
        across = np.outer(np.full(len(self.parabola), place.across_m), self.axis.across)
        lifted_m = place.raised_m - place.sag_m * self.parabola
        return np.asarray(self.axis.centres + np.column_stack((across, lifted_m)))

    def at_height(self, raised_m: float, sag_m: float) -> Floats:
        """Return positions across (C,) of crossings by a conductor that hangs higher, and with more sag."""
        view = self.view
        above_m = self.above_m[view.frame, view.bin]
        lifted_m = raised_m - sag_m * self.parabola[view.bin]
        side_m = self.side_m[view.frame]
        return np.asarray(side_m + (view.across_m - side_m) * (above_m - lifted_m) / above_m)

    def appear_at(self, across_m: float, raised_m: float, sag_m: float) -> Floats:
        """Return where (N, B) a conductor appears at the nominal height, in metres across."""
        lifted_m = raised_m - sag_m * self.parabola
        depth_m = np.maximum(self.above_m - lifted_m, _STEP_M)
        side_m = self.side_m[:, np.newaxis]
        return np.asarray(side_m + (across_m - side_m) * self.above_m / depth_m)


def look_at_span(
    axis: SpanAxis, rows: Ints, cameras: CameraPoses, lines: LineRows, rules: Rules
) -> SpanSight:
    """Return what frames show of a span; `lines` count their frames from the first of `rows`."""
    view = view_span(axis, cameras, lines, rules)
    shown = np.isfinite(
        view_span(axis, cameras, lines.take(np.zeros(0, np.int64)), rules, _margin(rules)).gsd_m
    )
    ground = cameras.positions[:, :2] - axis.start
    return SpanSight(
        axis=axis,
        rows=rows,
        cameras=cameras,
        lines=lines,
        view=view,
        from_m=ground @ axis.along,
        side_m=ground @ axis.across,
        above_m=cameras.positions[:, 2:] - axis.centres[:, 2],
        scale_px=_scale_px(axis, cameras),
        gsd_m=view.gsd_m,
        shown=shown,
        coarse=view.gsd_m > rules.coverage["max_gsd_m"],
    )


def _margin(rules: Rules) -> float:
    return float(rules.anomalies["margin_px"])


def _scale_px(axis: SpanAxis, cameras: CameraPoses) -> Floats:
    """Return by how many pixels (N, B) a conductor moves aside in the image per metre across."""
    with np.errstate(invalid="ignore"):
        here, _ = cameras.project(axis.centres)
        aside, _ = cameras.project(axis.centres + _STEP_M * np.append(axis.across, 0.0))
        ahead, _ = cameras.project(axis.centres + _STEP_M * np.append(axis.along, 0.0))
        along, across = ahead - here, (aside - here) / _STEP_M
        length = np.maximum(np.linalg.norm(along, axis=-1), 1e-9)
        crossed = along[..., 0] * across[..., 1] - along[..., 1] * across[..., 0]
    return np.asarray(np.abs(crossed) / length)
