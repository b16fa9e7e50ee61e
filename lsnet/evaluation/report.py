"""All that `model eval` tells of one detector, in one go."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from lsnet.detector import Detector
from lsnet.errors import LSNetError
from lsnet.evaluation.baselines.lsd import LSD
from lsnet.evaluation.baselines.mlsd import MLSD
from lsnet.evaluation.cables import evaluate_cables
from lsnet.evaluation.datasets import images_of
from lsnet.evaluation.grids import OnlyGrids
from lsnet.evaluation.paper import evaluate_as_paper
from lsnet.evaluation.pixels import evaluate
from lsnet.runtime import open_backend
from lsnet.synth.backgrounds import BackgroundFolder, BackgroundPool
from lsnet.synth.dataset import SyntheticScenes
from lsnet.training.sources import VALIDATION_SEED
from lsnet.weights import load_weights

if TYPE_CHECKING:
    from collections.abc import Callable

    from lsnet.evaluation.pixels import LineDetector, Use

EVALUATION_SEED = 2 * VALIDATION_SEED  # no drawn image is trained or validated on


class Report(Protocol):
    """One line of the table."""

    def to_dict(self) -> dict[str, object]:
        """Plain values for JSON."""
        ...


@dataclass(frozen=True, slots=True)
class EvalTask:
    """What to score on: folders, by the paper's scores too or not, and so many drawn images."""

    folders: tuple[Path, ...]
    use: Use
    paper: bool
    synthetic: int
    backgrounds: tuple[str, ...]

    def count_images(self) -> int:
        """How many images will be looked at.

        Raises LSNetError for a folder without, nothing to do, or backgrounds that nothing is drawn on.
        """
        if not self.folders and not self.synthetic:
            raise LSNetError("nothing to evaluate on; give folders of images, or --synthetic")
        if self.backgrounds and not self.synthetic:
            raise LSNetError("--background is drawn on; say how many images, with --synthetic")
        count = self.synthetic
        for folder in self.folders:
            kind, files = images_of(folder)
            count += len(files) * (2 if self.paper and kind != "plain" else 1)
        return count


def open_line_detector(
    weights: str, runtime: str, rival: str | None, grids: str = "MHVC"
) -> tuple[LineDetector, float]:
    """What is to be scored, telling all from score 0.05 up, and its own threshold.

    rival: lsd, or the path of M-LSD's .tflite. grids: those of the weights that are used. Raises LSNetError
    for others.
    """
    if rival == "lsd":
        return LSD(), LSD.min_score
    if rival and rival.endswith(".tflite"):
        return MLSD(Path(rival)), MLSD.min_score
    if rival:
        raise LSNetError(f"no rival {rival!r}; give lsd, or the path of M-LSD's .tflite file")
    loaded = load_weights(weights)
    backend = OnlyGrids(open_backend(loaded.net, runtime), grids)
    return Detector(loaded, backend, loaded.card.scale, min_score=0.05), loaded.card.min_score


def evaluate_all(
    finder: LineDetector, task: EvalTask, min_score: float, on_image: Callable[[], None] = lambda: None
) -> list[Report]:
    """The table, line by line: the folders in order, then the drawn images."""
    reports: list[Report] = []
    for folder in task.folders:
        reports += evaluate(finder, folder, min_score=min_score, use=task.use, on_image=on_image)
        if task.paper:
            reports += evaluate_as_paper(finder, folder, use=task.use, on_image=on_image)
    if task.synthetic:
        pool = BackgroundPool([BackgroundFolder.parse(text) for text in task.backgrounds])
        scenes = SyntheticScenes(pool, seed=EVALUATION_SEED)
        reports.append(
            evaluate_cables(
                finder, scenes, task.synthetic, min_score=min_score, use=task.use, on_image=on_image
            )
        )
    return reports
