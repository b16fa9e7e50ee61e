"""The paper's comparison (Section IV-A): LS-Net beside its rivals, trained and scored alike.

Scored as there: the segments of LS-Net 2 and 3 px wide, smoothed by a Gaussian; the maps of the rivals as
they are; both cut by Otsu's threshold.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from lsnet.evaluation.baselines.hough import Hough
from lsnet.evaluation.baselines.learned import RIVALS, LearnedRival, rival_task
from lsnet.evaluation.baselines.lsd import LSD
from lsnet.evaluation.baselines.wsl_cnn import WSLCNNConfig
from lsnet.evaluation.compare.ablation import AblationRow, Published, chosen, thin_paper, with_leads
from lsnet.evaluation.compare.compare import grids_of
from lsnet.evaluation.compare.trainings import Trainings, Variant
from lsnet.evaluation.paper import COMPARED, PaperProtocol, evaluate_as_paper, evaluate_pixels_as_paper
from lsnet.training.tasks import LSNetTask

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from torch import nn

    from lsnet.evaluation.baselines.wd_dcnn import WDDCNNConfig
    from lsnet.evaluation.paper import PaperScore
    from lsnet.evaluation.pixels import LineDetector

PUBLISHED = {
    "WSL-CNN": Published(None, 0.6256, None),
    "WD-DCNN": Published(0.4713, 0.7192, 0.4835),
    "WD-DCNN-GN": Published(0.4148, 0.8292, 0.4882),
    "WD-DCNN-FL": Published(0.4680, 0.7514, 0.5079),
    "WD-DCNN-GNFL": Published(0.4690, 0.7930, 0.5218),
    "LS-Net-W2": Published(0.4874, 0.7972, 0.5344),
    "LS-Net-W3": Published(0.4483, 0.8525, 0.5256),
}
UNTRAINED: dict[str, type[LSD | Hough]] = {"LSD, 2 px": LSD, "Canny, Hough, parallel, 2 px": Hough}
NOT_PUBLISHED = Published(None, None, None)


def thinned(config: WDDCNNConfig | WSLCNNConfig, thinner: int) -> WDDCNNConfig | WSLCNNConfig:
    """Return a rival with a fraction of its channels."""
    if isinstance(config, WSLCNNConfig):
        return replace(config, channels=tuple(c // thinner for c in config.channels))
    return replace(config, channels=config.channels // thinner)


def rivals_of(only: Sequence[str] = ()) -> list[str]:
    """Return the presets of the rivals of these names as in the table; all for none. Raises LSNetError."""
    return [name.lower() for name in chosen(only, [preset.upper() for preset in RIVALS])]


def compare_rivals(
    trainings: Trainings, thinner: int, seeds: int, only: Sequence[str] = ()
) -> list[AblationRow]:
    """Train LS-Net and its rivals with several seeds, where there is no result yet, and score all.

    Raises:
        LSNetError: As of `Trainings.score` and `rivals_of`.
    """
    sets = trainings.sets
    own = LSNetTask(thin_paper(thinner))
    found: dict[str, list[dict[str, Any]]] = {}
    for seed in range(seeds):
        for preset in rivals_of(only):
            variant = Variant(preset.upper(), rival_task(thinned(RIVALS[preset], thinner)), seed)
            scores = trainings.score(variant, "comparison", lambda net: _pixel_scores(net, sets)).scores
            found.setdefault(variant.name, []).append(scores)
        lsnet = Variant("LS-Net", own, seed)
        scores = trainings.score(lsnet, "comparison", lambda net: _segment_scores(net, sets)).scores
        for name in ("LS-Net-W2", "LS-Net-W3"):
            found.setdefault(name, []).append(scores[name])
    for name, kind in UNTRAINED.items():
        detector = kind()
        found[name] = [_both_widths(detector, detector.min_score, sets)["LS-Net-W2"]]
    rows = [
        AblationRow(
            "comparison", name, folder, [s[folder] for s in of_seeds], PUBLISHED.get(name, NOT_PUBLISHED)
        )
        for name, of_seeds in found.items()
        for folder in of_seeds[0]
    ]
    return with_leads(rows, "LS-Net-W2")


def count_rivals(seeds: int, only: Sequence[str] = ()) -> int:
    """Return how often `compare_rivals` asks for a trained network."""
    return seeds * (len(rivals_of(only)) + 1)


def _pixel_scores(net: nn.Module, sets: Sequence[Path]) -> dict[str, list[float]]:
    rival = LearnedRival(net)
    return {str(folder): _means(evaluate_pixels_as_paper(rival, folder)[0]) for folder in sets}


def _segment_scores(net: nn.Module, sets: Sequence[Path]) -> dict[str, dict[str, list[float]]]:
    return _both_widths(grids_of(net)("MHVC"), 0.5, sets)


def _both_widths(
    detector: LineDetector, min_score: float, sets: Sequence[Path]
) -> dict[str, dict[str, list[float]]]:
    protocol = PaperProtocol(COMPARED, min_score)
    of_sets = {str(folder): evaluate_as_paper(detector, folder, protocol) for folder in sets}
    return {
        name: {folder: _means(scores[k]) for folder, scores in of_sets.items()}
        for k, name in enumerate(("LS-Net-W2", "LS-Net-W3"))
    }


def _means(score: PaperScore) -> list[float]:
    return [score.apr, score.arr, score.f1]
