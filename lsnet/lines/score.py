"""The learned score of a line: small networks on its features, the odds of its segments, and its context."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from safetensors.numpy import load as load_tensors

from lsnet.lines.context import (
    CONTEXT,
    LEAST_DOUBT,
    LEAST_PRIOR,
    LineContext,
    LineLayout,
    context_inputs,
    has_context,
)
from lsnet.lines.features import FEATURES, features_of, log_odds
from lsnet.lines.perceptrons import Perceptrons
from lsnet.weights_file import LINE_SCORE_PREFIX, unusable

if TYPE_CHECKING:
    from lsnet.arrays import Floats, Floats32, ImageArray, RealArray
    from lsnet.lines.proposals import Proposals
    from lsnet.weights_file import WeightsFile

LEAST_SCORE = 1e-9
MAX_LEARNED = 3.0  # logit of the networks for proposals with weak segments: on evaluation images 2.8
CONTEXT_PREFIX = "context."


@dataclass(frozen=True, slots=True, eq=False)
class LineScore:
    """M networks, whose logits are added to that of the prior, each with a factor, and the context.

    Attributes:
        networks: Of the features of proposals.
        blend: (M + 2,) factors of the logits of the networks, factor of that of the prior, and a constant.
        context: What other proposals say; None if they do not count.
    """

    networks: Perceptrons
    blend: Floats32
    context: LineContext | None = None

    def __post_init__(self) -> None:
        count = len(self.networks)
        if (
            self.networks.inputs != FEATURES
            or self.blend.shape != (count + 2,)
            or (self.context and self.context.networks.inputs != count + 2 + CONTEXT)
        ):
            raise ValueError("tensors of the line score that do not fit")

    def first_logits(self, learned: Floats32, priors: RealArray) -> RealArray:
        """Return (C,) logits of the score without the context, from those of the networks (M, C)."""
        out: RealArray = self.blend[:-2] @ learned + self._prior_logits(priors)
        return out

    def logits(self, learned: Floats32, priors: RealArray, layout: LineLayout | None) -> RealArray:
        """Return (C,) logits of the score; layout: None in an image that is too small for a context."""
        first = self.first_logits(learned, priors)
        if self.context is None or layout is None:
            return first
        return first + self.context.added(context_inputs(layout, learned, first))

    def _prior_logits(self, priors: RealArray) -> RealArray:
        """Return (C,) what the logits are without the networks."""
        out: RealArray = self.blend[-2] * log_odds(priors, LEAST_DOUBT) + self.blend[-1]
        return out

    def rate(
        self, image: ImageArray, cell_scores: Floats32, proposals: Proposals, min_score: float = 0.0
    ) -> Floats:
        """Return (C,) scores of proposals in an image (H, W, 3), from scores (R, K) of its cells.

        Proposals that the networks would have to give more than `MAX_LEARNED` to reach `min_score` are not
        looked at, unless they count as context of others: their score is without the networks.
        """
        logits = self._prior_logits(proposals.prior)
        reach = MAX_LEARNED * self.blend[:-2].sum()
        is_looked_at = logits + reach >= log_odds(np.array(min_score), LEAST_SCORE)
        is_alone = not has_context(proposals.image_size, proposals.enlargement)
        if is_looked_at.any():
            if not is_alone:
                is_looked_at |= proposals.prior >= LEAST_PRIOR
            chosen = np.flatnonzero(is_looked_at)
            learned = self.networks.logits(features_of(image, cell_scores, proposals, chosen))
            layout = None if is_alone else LineLayout.of(proposals, chosen)
            logits[chosen] = self.logits(learned, proposals.prior[chosen], layout)
        out: Floats = 1 / (1 + np.exp(-logits))
        return out

    def tensors(self) -> dict[str, Floats32]:
        """Return the tensors by their names in a weights file."""
        named = self.networks.tensors() | {"blend": self.blend}
        if self.context:
            named |= {CONTEXT_PREFIX + name: tensor for name, tensor in self.context.tensors().items()}
        return {LINE_SCORE_PREFIX + name: np.ascontiguousarray(tensor) for name, tensor in named.items()}

    @classmethod
    def from_tensors(cls, tensors: dict[str, Floats32]) -> LineScore:
        """Read what `tensors` returns. Raises LookupError or ValueError for other tensors."""
        if not all(np.isfinite(tensor).all() for tensor in tensors.values()):
            raise ValueError("infinite tensors of the line score")
        own = _below(LINE_SCORE_PREFIX, tensors)
        context = _below(CONTEXT_PREFIX, own)
        own = {name: tensor for name, tensor in own.items() if not name.startswith(CONTEXT_PREFIX)}
        return cls(*_networks_and_blend(own), LineContext(*_networks_and_blend(context)) if context else None)


def _below(prefix: str, tensors: dict[str, Floats32]) -> dict[str, Floats32]:
    """Tensors whose names begin with a prefix, by the rest of their names."""
    return {
        name.removeprefix(prefix): np.asarray(tensor, np.float32)
        for name, tensor in tensors.items()
        if name.startswith(prefix)
    }


def _networks_and_blend(named: dict[str, Floats32]) -> tuple[Perceptrons, Floats32]:
    """Raises LookupError or ValueError for other tensors."""
    blend = named.pop("blend")
    return Perceptrons.from_tensors(named), blend


def read_line_score(file: WeightsFile) -> LineScore | None:
    """Return the line score in a weights file, None if it has none.

    Raises:
        LSNetError: Its tensors do not fit.
    """
    if LINE_SCORE_PREFIX.encode() not in file.data:
        return None
    try:
        tensors = load_tensors(file.data)
        return LineScore.from_tensors({k: v for k, v in tensors.items() if k.startswith(LINE_SCORE_PREFIX)})
    except (ValueError, LookupError, TypeError) as err:
        raise unusable(file.path, err) from err
