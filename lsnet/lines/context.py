"""What the other proposals of an image say about a proposal: wires come in parallel groups, or not at all.

The first score rates each proposal by itself. From the scores and places of the others, small networks learn
how much more likely, or less, it is a wire.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lsnet.lines.features import log_odds

if TYPE_CHECKING:
    from lsnet.arrays import Floats, Floats32, Indices, Mask, RealArray
    from lsnet.lines.perceptrons import Perceptrons
    from lsnet.lines.proposals import Proposals

CONTEXT = 21  # features
LEAST_PRIOR = 0.03  # of a proposal that counts as context of others
LEAST_SIDE_PX = 192  # smaller images hold too few proposals
LEAST_DOUBT = 0.01  # of the odds of segments
MAX_LOGIT = 6.0
MAX_EVIDENCE = 2.0  # of the context, in logits before the factor: more is seen only where training was not
PARALLEL_SINE = float(np.sin(np.radians(10)))
OVERLAP_SHARE = 0.3  # of the shorter of two lines beside each other
LEAST_ASIDE_PX = 3.0  # nearer lines are doubles or continue each other
BANDS = ((0.0, 0.04), (0.04, 0.15), (0.15, 0.6))  # distances of lines beside a line, in shorter sides
NEAR = 0.25  # distance of those whose likely lengths are added up
HIGHEST = 3  # scores of others that count
CHUNK = 256  # lines that are compared at once with all others, to bound the memory
_NEARER, _FARTHER = np.array(BANDS).T[:, :, None, None]


@dataclass(frozen=True, slots=True, eq=False)
class LineLayout:
    """Where C proposals of one image lie.

    Attributes:
        ends: (C, 4) x1, y1, x2, y2.
        lengths_px: (C,).
        priors: (C,) scores by the odds of the segments and the length alone.
        image_size: (height, width) in pixels.
    """

    ends: Floats
    lengths_px: Floats
    priors: Floats
    image_size: tuple[int, int]

    @classmethod
    def of(cls, proposals: Proposals, chosen: Indices) -> LineLayout:
        """Return the layout of chosen proposals."""
        return cls(
            proposals.ends[chosen],
            proposals.extent_px[chosen],
            proposals.prior[chosen],
            proposals.image_size,
        )


@dataclass(frozen=True, slots=True, eq=False)
class LineContext:
    """A network for the evidence of the context, and how it counts.

    Attributes:
        networks: One; inputs as from `context_inputs`.
        blend: (2,) factor of its logits, and a constant.
    """

    networks: Perceptrons
    blend: Floats32

    def __post_init__(self) -> None:
        if len(self.networks) != 1 or self.blend.shape != (2,):
            raise ValueError("tensors of the line score that do not fit")

    def added(self, inputs: Floats32) -> Floats:
        """Return (C,) what is added to the logits of proposals with inputs (C, F)."""
        evidence = np.clip(self.networks.logits(inputs)[0], -MAX_EVIDENCE, MAX_EVIDENCE)
        out: Floats = self.blend[0] * evidence + self.blend[1]
        return out

    def tensors(self) -> dict[str, Floats32]:
        """Return the tensors by name."""
        return self.networks.tensors() | {"blend": self.blend}


def has_context(image_size: tuple[int, int], enlargement: float) -> bool:
    """Return whether an image of (height, width), enlarged before detection, is large enough."""
    return min(image_size) / enlargement > LEAST_SIDE_PX


def context_inputs(layout: LineLayout, learned: Floats32, logits: RealArray) -> Floats32:
    """Return (C, M + 2 + CONTEXT) inputs of the networks of a context.

    From M logits (M, C) of each proposal, and the logits (C,) of its first score.
    """
    own = [learned.T, log_odds(layout.priors, LEAST_DOUBT)[:, None], logits[:, None]]
    return np.concatenate([*own, context_of(layout, logits)], axis=1, dtype=np.float32)


def context_of(layout: LineLayout, logits: RealArray) -> Floats:
    """Return (C, CONTEXT) features of what else is proposed, from the logits (C,) of the first score."""
    source = np.flatnonzero(layout.priors >= LEAST_PRIOR)
    sure = np.clip(logits[source], -MAX_LOGIT, MAX_LOGIT)
    rows = np.arange(len(logits))
    cuts = range(CHUNK, len(rows), CHUNK)
    parts = [_context_of(layout, each, source, sure) for each in np.split(rows, cuts)]
    return np.concatenate(parts, axis=1).T


def _context_of(layout: LineLayout, rows: Indices, source: Indices, sure: RealArray) -> Floats:
    """(CONTEXT, R) features of some proposals, from all S sources and their logits (S,)."""
    lengths_px, short_px = layout.lengths_px[rows], min(layout.image_size)
    of_sources_px = layout.lengths_px[source]
    shares = 1 / (1 + np.exp(-sure))
    likely_px = of_sources_px * shares
    is_other = rows[:, None] != source
    is_parallel, is_beside, aside = _relations(layout, rows, source)
    is_parallel, is_beside = is_parallel & is_other, is_beside & is_other
    groups = np.concatenate([is_other[None], is_beside & (aside >= _NEARER) & (aside < _FARTHER)])
    sums = groups @ np.array([np.ones(len(source)), of_sources_px, of_sources_px * sure, likely_px]).T
    count, all_px, _, all_likely_px = sums[0].T
    means = np.where(sums[..., 0] > 0, sums[..., 2] / np.maximum(sums[..., 1], 1), -MAX_LOGIT)
    highest = np.where(groups[1:], sure, -MAX_LOGIT).max(axis=2, initial=-MAX_LOGIT)
    near_px = (is_beside & (aside < NEAR)) * np.minimum(of_sources_px, lengths_px[:, None])
    along_px = is_parallel @ likely_px
    pixels = layout.image_size[0] * layout.image_size[1]
    return np.array(
        [
            *_highest(is_other, sure),
            means[0],
            all_likely_px / np.maximum(all_px, 1),
            np.log1p(all_likely_px / short_px * 4),
            *np.stack([np.log1p(sums[1:, :, 0]), highest, means[1:]], axis=1).reshape(-1, len(rows)),
            np.log1p(near_px @ shares / lengths_px),
            along_px / np.maximum(all_likely_px, 1),
            np.log1p(along_px / short_px),
            np.log(count + 1),
            np.log((count + 1) / pixels * 1e6),
            np.log(lengths_px / short_px),
        ]
    )


def _relations(layout: LineLayout, rows: Indices, source: Indices) -> tuple[Mask, Mask, Floats]:
    """Return (R, S) which sources are parallel, which of them lie beside, and their distances.

    Distances are of the middle of a source from the line, in shorter sides of the image.
    """
    starts, ends = (layout.ends[:, ::2] + 1j * layout.ends[:, 1::2]).T  # points as complex numbers
    chords, middles = ends - starts, (starts + ends) / 2
    chords_px = np.maximum(np.abs(chords), 1e-6)
    directions = chords / chords_px
    backwards = directions[rows, None].conj()
    places = (middles[source] - middles[rows, None]) * backwards  # along and across each line
    aside_px, own_px, other_px = np.abs(places.imag), chords_px[rows, None], chords_px[source]
    is_parallel = np.abs((directions[source] * backwards).imag) < PARALLEL_SINE
    overlap_px = (own_px + other_px) / 2 - np.abs(places.real)
    is_beside = is_parallel & (overlap_px > OVERLAP_SHARE * np.minimum(own_px, other_px))
    return is_parallel, is_beside & (aside_px > LEAST_ASIDE_PX), aside_px / min(layout.image_size)


def _highest(is_other: Mask, logits: RealArray) -> list[RealArray]:
    """Return the two highest logits of others, and the mean of the three highest."""
    none = np.full((len(is_other), HIGHEST), -MAX_LOGIT)
    highest = np.sort(np.concatenate([np.where(is_other, logits, -MAX_LOGIT), none], axis=1), axis=1)
    return [highest[:, -1], highest[:, -2], highest[:, -HIGHEST:].mean(axis=1)]
