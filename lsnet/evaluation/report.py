"""All reports of `model eval` on one detector."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from lsnet.detector import Detector
from lsnet.errors import LSNetError
from lsnet.evaluation.baselines.hough import Hough
from lsnet.evaluation.baselines.learned import LearnedRival
from lsnet.evaluation.baselines.lsd import LSD
from lsnet.evaluation.baselines.mlsd import MLSD
from lsnet.evaluation.cables import evaluate_cables
from lsnet.evaluation.datasets import images_of
from lsnet.evaluation.grids import OnlyGrids, Remembered
from lsnet.evaluation.paper import PaperProtocol, evaluate_as_paper, evaluate_pixels_as_paper
from lsnet.evaluation.pixels import evaluate
from lsnet.evaluation.rasterize import SIGMA_PX
from lsnet.runtime.backend import open_backend
from lsnet.synth.backgrounds import BackgroundFolder, BackgroundPool
from lsnet.synth.dataset import SyntheticScenes
from lsnet.training.sources import VALIDATION_SEED
from lsnet.weights_file import read_weights

if TYPE_CHECKING:
    from collections.abc import Callable

    from lsnet.evaluation.cables import CableReport
    from lsnet.evaluation.paper import PaperScore
    from lsnet.evaluation.pixels import LineDetector, PixelReport, ShareReport, Use

    Report = PixelReport | ShareReport | PaperScore | CableReport

EVALUATION_SEED = 2 * VALIDATION_SEED  # these images are never trained or validated on


@dataclass(frozen=True, slots=True)
class EvalTask:
    """What to evaluate on.

    Attributes:
        folders: Evaluation sets.
        min_score: Score from which a detection counts.
        use: Score segments or lines.
        paper: Also compute the paper's scores.
        sigma_px: Width of the Gaussian of these.
        synthetic: Number of synthetic images.
        backgrounds: DIR or DIR:FIRST, for the synthetic images.
    """

    folders: tuple[Path, ...]
    min_score: float
    use: Use = "segments"
    paper: bool = False
    sigma_px: float = SIGMA_PX
    synthetic: int = 0
    backgrounds: tuple[str, ...] = ()

    def count_images(self) -> int:
        """Return how many images will be detected in.

        Raises:
            LSNetError: A folder has no images, there is nothing to do, or there are backgrounds but no
                synthetic images.
        """
        if not self.folders and not self.synthetic:
            raise LSNetError("nothing to evaluate; give folders of images, or a number of synthetic images")
        if self.backgrounds and not self.synthetic:
            raise LSNetError("backgrounds are for synthetic images only; give a number of these")
        count = self.synthetic
        for folder in self.folders:
            kind, files = images_of(folder)
            count += len(files) * (2 if self.paper and kind != "plain" else 1)
        return count


def open_line_detector(
    weights: str, runtime: str, rival: str | None, grids: str | None = None
) -> tuple[LineDetector | LearnedRival, float]:
    """Open the detector to evaluate, with a threshold of 0.05; return it with its default threshold.

    Args:
        weights: Name or file of weights.
        runtime: As in `Detector.load`.
        rival: Another detector instead: lsd, hough, the path of M-LSD's .tflite file, or the folder of a run
            of a learned rival.
        grids: Letters of the grids to use, as in `OnlyGrids`. Default: all.

    Raises:
        LSNetError: One of them is unknown or cannot be used.
    """
    if rival and grids:
        raise LSNetError("only LS-Net has grids; leave out the grids or the rival")
    if rival == "lsd":
        return LSD(), LSD.min_score
    if rival == "hough":
        return Hough(), Hough.min_score
    if rival and rival.endswith(".tflite"):
        return MLSD(Path(rival)), MLSD.min_score
    if rival:
        if not (Path(rival) / "best.pt").is_file():
            raise LSNetError(f"no rival {rival!r}; give lsd, hough, M-LSD's .tflite file, or a rival's run")
        return LearnedRival.load(Path(rival)), 0.5
    return open_grids(weights, runtime)(grids or "MHVC"), read_weights(weights).card.min_score


def open_grids(weights: str, runtime: str) -> Callable[[str], Detector]:
    """Return a function that opens a detector with some of the grids, with a threshold of 0.05.

    Raises:
        LSNetError: The weights or the runtime cannot be used.
    """
    file = read_weights(weights)
    backend = Remembered(open_backend(file, runtime))
    return lambda grids: Detector(file, OnlyGrids(backend, grids), file.card.scale, min_score=0.05)


def evaluate_all(
    detector: LineDetector | LearnedRival, task: EvalTask, on_image: Callable[[], None] = lambda: None
) -> list[Report]:
    """Return the reports of the folders in order, then of the synthetic images.

    A rival that scores pixels has the paper's scores only.

    Raises:
        LSNetError: A folder cannot be used, or the rival cannot be scored so.
    """
    reports: list[Report] = []
    if isinstance(detector, LearnedRival):
        for folder in task.folders:
            reports += evaluate_pixels_as_paper(detector, folder, on_image)
        if task.synthetic or not reports:
            raise LSNetError("a rival that scores pixels needs folders with masks or boundaries; give such")
        return reports
    min_score = task.min_score
    protocol = PaperProtocol(min_score=min_score, sigma_px=task.sigma_px, use=task.use)
    for folder in task.folders:
        reports += evaluate(detector, folder, min_score=min_score, use=task.use, on_image=on_image)
        if task.paper:
            reports += evaluate_as_paper(detector, folder, protocol, on_image)
    if task.synthetic:
        pool = BackgroundPool([BackgroundFolder.parse(text) for text in task.backgrounds])
        scenes = SyntheticScenes(pool, seed=EVALUATION_SEED)
        reports.append(
            evaluate_cables(
                detector, scenes, task.synthetic, min_score=min_score, use=task.use, on_image=on_image
            )
        )
    return reports
