"""Lines that count as evidence: confirmed by a track, and carried over frames in which they were missed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.rows import NO_TRACK, count_up

if TYPE_CHECKING:
    from inspect_pipeline.inspection.rows import LineRows
    from inspect_pipeline.inspection.rules import Rules


def confirmed_lines(lines: LineRows, rules: Rules) -> LineRows:
    """Return the lines of long tracks, or all lines of a flight without tracks."""
    if not np.any(lines.track != NO_TRACK):
        return lines
    tracks, inverse, counts = np.unique(lines.track, return_inverse=True, return_counts=True)
    is_long = (counts >= rules.tracks["min_frames"]) & (tracks != NO_TRACK)
    return lines.take(np.flatnonzero(is_long[inverse]))


def number_untracked(lines: LineRows) -> LineRows:
    """Give each line without a track an id of its own."""
    untracked = lines.track == NO_TRACK
    own_ids = lines.track.max(initial=NO_TRACK) + np.cumsum(untracked)
    return replace(lines, track=np.where(untracked, own_ids, lines.track))


def carry_over(lines: LineRows, max_missed: float) -> LineRows:
    """Repeat a line of a track in the frames that lack it, where at most `max_missed` in a row do.

    The result has no lines without a track.
    """
    order = np.lexsort((lines.frame, lines.track))
    order = order[lines.track[order] != NO_TRACK]
    if not len(order):
        return lines.take(order)
    frame, track = lines.frame[order], lines.track[order]
    # Pieces of one track in one frame are repeated together, as a group.
    begins = np.flatnonzero((np.diff(frame, prepend=-1) != 0) | (np.diff(track, prepend=track[0] - 1) != 0))
    sizes = np.diff(begins, append=len(order))
    steps = np.append(np.diff(frame[begins]), 1)
    is_bridged = np.append(np.diff(track[begins]) == 0, False) & (steps <= max_missed + 1)
    repeats = np.where(is_bridged, steps, 1)
    group = np.repeat(np.arange(len(begins)), repeats)
    age = count_up(repeats)
    taken = np.repeat(begins[group], sizes[group]) + count_up(sizes[group])
    frames = np.repeat(frame[begins][group] + age, sizes[group])
    by_frame = np.argsort(frames, kind="stable")
    carried = lines.take(order[taken][by_frame])
    return replace(carried, frame=frames[by_frame], source_frame=carried.frame)
