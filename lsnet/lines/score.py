"""The learned score of a line: small networks on its features, blended with the odds of its segments."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from safetensors.numpy import load as load_tensors

from lsnet.lines.features import FEATURES, features_of, log_odds
from lsnet.weights_file import LINE_SCORE_PREFIX, unusable

if TYPE_CHECKING:
    from lsnet.arrays import Floats, Floats32, ImageArray, RealArray
    from lsnet.lines.proposals import Proposals
    from lsnet.weights_file import WeightsFile

LAYERS = 3
LEAST_DOUBT = 0.01  # of the odds of segments
MAX_LEARNED = 3.0  # logit of the networks for proposals with weak segments: on evaluation images 2.8
MAX_DEVIATIONS = 4.0  # features beyond are cut
_ROWS = 20  # at a time: for larger products BLAS wakes threads, which then spin for 0.1 s of CPU time each


@dataclass(frozen=True, slots=True, eq=False)
class LineScore:
    """M networks of three layers, whose logits are added to that of the prior, each with a factor.

    Attributes:
        mean, deviation: (M, 1, FEATURES) of the features in training.
        weights, biases: Per layer (M, I, J) and (M, 1, J).
        blend: (M + 2,) factors of the logits of the networks, factor of that of the prior, and a constant.
    """

    mean: Floats32
    deviation: Floats32
    weights: tuple[Floats32, ...]
    biases: tuple[Floats32, ...]
    blend: Floats32

    def __post_init__(self) -> None:
        widths = [FEATURES, *(w.shape[-1] for w in self.weights)]
        count = len(self.mean)
        shapes = [(count, a, b) for a, b in pairwise(widths)]
        if (
            [w.shape for w in self.weights] != shapes
            or [b.shape for b in self.biases] != [(count, 1, b) for b in widths[1:]]
            or not self.mean.shape == self.deviation.shape == (count, 1, FEATURES)
            or widths[-1] != 1
            or self.blend.shape != (count + 2,)
        ):
            raise ValueError("tensors of the line score that do not fit")

    def logits(self, features: Floats32) -> Floats32:
        """Return (M, C) logits of features (C, FEATURES)."""
        starts = range(0, max(len(features), 1), _ROWS)
        return np.concatenate([self._logits(features[i : i + _ROWS]) for i in starts], axis=1)

    def _logits(self, features: Floats32) -> Floats32:
        x = (features - self.mean) / self.deviation
        x = np.clip(x, -MAX_DEVIATIONS, MAX_DEVIATIONS)
        for weights, biases in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = np.maximum(x @ weights + biases, 0)
        out: Floats32 = (x @ self.weights[-1] + self.biases[-1])[..., 0]
        return out

    def scores(self, features: Floats32, priors: RealArray) -> Floats:
        """Return (C,) scores of features (C, FEATURES) and prior scores (C,)."""
        logits = self.blend[:-2] @ self.logits(features) + self._prior_logits(priors)
        out: Floats = 1 / (1 + np.exp(-logits))
        return out

    def _prior_logits(self, priors: RealArray) -> RealArray:
        """Return (C,) what the logits are without the networks."""
        out: RealArray = self.blend[-2] * log_odds(priors, LEAST_DOUBT) + self.blend[-1]
        return out

    def rate(
        self, image: ImageArray, cell_scores: Floats32, proposals: Proposals, min_score: float = 0.0
    ) -> Floats:
        """Return (C,) scores of proposals in an image (H, W, 3), from scores (R, K) of its cells.

        Proposals that the networks would have to give more than `MAX_LEARNED` to reach `min_score` are not
        looked at: their score is without the networks.
        """
        logits = self._prior_logits(proposals.prior)
        reach = MAX_LEARNED * self.blend[:-2].sum()
        within_reach = np.flatnonzero(logits + reach >= log_odds(np.array(min_score), 1e-9))
        if len(within_reach):
            learned = self.logits(features_of(image, cell_scores, proposals, within_reach))
            logits[within_reach] += self.blend[:-2] @ learned
        out: Floats = 1 / (1 + np.exp(-logits))
        return out

    def tensors(self) -> dict[str, Floats32]:
        """Return the tensors by their names in a weights file."""
        named = {"mean": self.mean, "deviation": self.deviation, "blend": self.blend}
        named |= {f"{k}.weight": w for k, w in enumerate(self.weights)}
        named |= {f"{k}.bias": b for k, b in enumerate(self.biases)}
        return {LINE_SCORE_PREFIX + name: np.ascontiguousarray(tensor) for name, tensor in named.items()}

    @classmethod
    def from_tensors(cls, tensors: dict[str, Floats32]) -> LineScore:
        """Read what `tensors` returns. Raises LookupError or ValueError for other tensors."""
        named = {
            name.removeprefix(LINE_SCORE_PREFIX): np.asarray(tensor, np.float32)
            for name, tensor in tensors.items()
        }
        if len(named) != 2 * LAYERS + 3 or not all(np.isfinite(tensor).all() for tensor in named.values()):
            raise ValueError("missing, unknown or infinite tensors of the line score")
        return cls(
            named["mean"],
            named["deviation"],
            tuple(named[f"{k}.weight"] for k in range(LAYERS)),
            tuple(named[f"{k}.bias"] for k in range(LAYERS)),
            named["blend"],
        )


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
