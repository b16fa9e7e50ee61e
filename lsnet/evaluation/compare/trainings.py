"""Short trainings of several networks or losses on the same synthetic images, whose results are kept.

Each variant sees the same crops in the same order. A result is found again by a digest of all that it depends
on: drawn set and photographs behind it, network, loss, seed, recipe, and evaluation sets. So nothing is shown
that belongs to other data, a variant that has a result is not run again, and an interrupted one continues.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

from lsnet.errors import LSNetError
from lsnet.evaluation.compare.data import DRAWN_PX, Crops, draw_set, write_held_out
from lsnet.evaluation.datasets import images_of
from lsnet.files import digest_of, make_folder
from lsnet.synth.backgrounds import BackgroundFolder
from lsnet.training.recipe import HOW_COMPUTED, TrainConfig
from lsnet.training.tasks import LSNetTask
from lsnet.training.trainer import Trainer

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from torch import nn

    from lsnet.training.tasks import Task

    Scores = dict[str, Any]

RESULTS_FILE = "results.jsonl"
VALIDATION_IMAGES = 128  # the last images of the set
VALIDATIONS = 10  # points of the curves of losses
# Of networks with GroupNorm and without skip connections: at twice the rate, losses stay for the first 400
# batches where they start.
PAPER_RATE = 1e-3


@dataclass(frozen=True, slots=True)
class Variant:
    """One network with one loss; `seed` sets its initial weights and its crops."""

    name: str
    task: Task = field(default_factory=LSNetTask)
    seed: int = 0


@dataclass(frozen=True, slots=True)
class Comparison:
    """Folders of the sets and of the runs, and how long each variant is trained."""

    folder: Path
    backgrounds: tuple[str, ...]
    sets: tuple[Path, ...]  # folders with pixel truth to evaluate on
    images: int = 3700
    steps: int = 4000
    batch_size: int = 4
    crop: int = 192
    seed: int = 7  # of the drawn set
    as_paper: bool = False  # its kind of images, at the rate at which its networks learn
    device: str = "auto"
    threads: int = 1

    def __post_init__(self) -> None:
        if self.crop > DRAWN_PX:
            raise LSNetError(f"crops of {self.crop} px do not fit the drawn images; give at most {DRAWN_PX}")

    def recipe(self) -> TrainConfig:
        """Return the recipe of every variant."""
        return TrainConfig(
            preset="compared",
            steps=self.steps,
            batch_size=self.batch_size,
            learning_rate=PAPER_RATE if self.as_paper else TrainConfig().learning_rate,
            warmup_steps=min(100, self.steps),
            validate_every=max(1, self.steps // VALIDATIONS),
            validation_images=VALIDATION_IMAGES,
            patience=self.steps,
            threads=self.threads,
            workers=0,
            device=self.device,
        )


@dataclass(frozen=True, slots=True)
class Result:
    """Scores of one variant, as `score` of its kind of comparison gives them."""

    key: str
    name: str
    seed: int
    parameters: int
    steps: int
    validation_loss: float
    scores: Scores


class Trainings:
    """The drawn set of a comparison, and the results that are kept in its folder."""

    def __init__(
        self,
        comparison: Comparison,
        *,
        workers: int = 1,
        report: Callable[[str, int], None] = lambda _task, _step: None,
    ) -> None:
        """Draw the set, unless it exists, and keep its last images for evaluation.

        Args:
            comparison: What is compared.
            workers: Processes that draw.
            report: Called with the current task and the steps of all variants so far.

        Raises:
            LSNetError: A folder cannot be used.
        """
        self.comparison, self._report, self._steps_done = comparison, report, 0
        digests = [_digest_of_set(folder) for folder in comparison.sets]  # before a set is drawn for nothing
        make_folder(comparison.folder)
        count = comparison.images + VALIDATION_IMAGES
        folders = [BackgroundFolder.parse(text) for text in comparison.backgrounds]
        photos = [digest_of(folder.files()) for folder in folders]
        self._set_digest = _digest([photos, count, DRAWN_PX, comparison.seed, comparison.as_paper])
        self.drawn = comparison.folder / f"set-{self._set_digest}"
        draw_set(
            self.drawn,
            comparison.backgrounds,
            count,
            seed=comparison.seed,
            workers=workers,
            as_paper=comparison.as_paper,
            on_image=lambda: report("draw", 0),
        )
        held_out = write_held_out(self.drawn, comparison.images)
        self.sets = (*comparison.sets, held_out)
        self._scored_on = _digest([*digests, _digest_of_set(held_out)])

    def run_of(self, variant: Variant) -> Path:
        """Return the folder of the run of a variant: a digest of all that its weights depend on."""
        recipe = {k: v for k, v in asdict(self.comparison.recipe()).items() if k not in HOW_COMPUTED}
        key = [self._set_digest, self.comparison.crop, recipe, variant.task.describe(), variant.seed]
        return self.comparison.folder / "runs" / _digest(key)

    def score(self, variant: Variant, kind: str, score: Callable[[nn.Module], Scores]) -> Result:
        """Return the kept result of a variant, or train and score it.

        Args:
            variant: What is trained.
            kind: Name of the way of scoring.
            score: Scores a network on the sets of the comparison.

        Raises:
            LSNetError: The kept results are damaged, or a folder cannot be used.
        """
        key = _digest([self.run_of(variant).name, self._scored_on, kind])
        kept = results_of(self.comparison.folder)
        if key not in kept:
            result = self._train_and_score(variant, key, score)
            with (self.comparison.folder / RESULTS_FILE).open("a") as log:
                log.write(json.dumps(asdict(result)) + "\n")
            kept[key] = result
        self._steps_done += self.comparison.steps
        self._report(variant.name, self._steps_done)
        return kept[key]

    def _train_and_score(self, variant: Variant, key: str, score: Callable[[nn.Module], Scores]) -> Result:
        images, crop = self.comparison.images, self.comparison.crop
        trainer = Trainer(
            self.comparison.recipe(), self.run_of(variant), seed=variant.seed, task=variant.task
        )
        train_on = Crops.of(self.drawn, 0, images, size=crop, seed=variant.seed)
        seed = self.comparison.seed
        validate_on = Crops.of(self.drawn, images, images + VALIDATION_IMAGES, size=crop, seed=seed)
        label = f"{variant.name}, seed {variant.seed}"
        trainer.run(
            train_on, validate_on, report=lambda state: self._report(label, self._steps_done + state.step)
        )
        validated = trainer.validate(list(trainer.batches(validate_on, range(VALIDATION_IMAGES))))
        net = trainer.average.eval().cpu()
        return Result(
            key=key,
            name=variant.name,
            seed=variant.seed,
            parameters=sum(p.numel() for p in net.parameters()),
            steps=self.comparison.steps,
            validation_loss=float(validated.total),
            scores=score(net),
        )


def results_of(folder: Path) -> dict[str, Result]:
    """Return the results kept in the folder of a comparison, by key. Raises LSNetError for a damaged file."""
    path = folder / RESULTS_FILE
    try:
        lines = path.read_text().splitlines() if path.exists() else []
        results = [Result(**json.loads(line)) for line in lines]
    except (OSError, ValueError, TypeError, RecursionError) as err:
        raise LSNetError(f"{path}: damaged, or of an older version; delete it and run again") from err
    return {result.key: result for result in results}


def _digest_of_set(folder: Path) -> str:
    """Return a digest of the images of an evaluation set and of their truth."""
    kind, files = images_of(folder)
    if kind == "plain":
        raise LSNetError(f"{folder}: has no pixel truth; give folders with masks or boundaries")
    truth = folder / "masks" if kind == "masks" else folder
    return digest_of([*files, *sorted(f for f in truth.iterdir() if f.is_file() and f not in files)])


def _digest(values: Any) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:16]
