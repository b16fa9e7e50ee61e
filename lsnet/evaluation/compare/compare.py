"""Short trainings of several networks or losses on the same synthetic images, scored and timed the same way.

Each variant sees the same crops in the same order, from initial weights of the same seed. Results are kept as
JSON lines: a variant that has one is not run again, and an interrupted one continues.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from importlib.util import find_spec
from typing import TYPE_CHECKING

import torch

from lsnet.detector import Detector
from lsnet.errors import LSNetError
from lsnet.evaluation.compare.data import Crops, draw_set
from lsnet.evaluation.grids import OnlyGrids
from lsnet.evaluation.pixels import PixelReport, evaluate
from lsnet.evaluation.speed import least_cpu_ms
from lsnet.losses import MultiTaskLoss
from lsnet.model import PRESETS, LSNet, LSNetConfig
from lsnet.runtime import OpenVinoBackend, TorchBackend
from lsnet.training.recipe import TrainConfig
from lsnet.training.tasks import LSNetTask
from lsnet.training.trainer import Trainer
from lsnet.weights import Weights, WeightsCard

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from lsnet.runtime import Backend

FAST = PRESETS["fast"]
RESULTS_FILE = "results.jsonl"
VALIDATION_IMAGES = 128  # the last images of the set


@dataclass(frozen=True, slots=True)
class Variant:
    """One network with one loss; `seed` sets its initial weights and its crops."""

    name: str
    network: LSNetConfig = FAST
    loss: MultiTaskLoss = field(default_factory=MultiTaskLoss)
    seed: int = 0


NETWORKS = (
    Variant("fast"),
    Variant("fast, another seed", seed=1),
    Variant("wider", replace(FAST, stem_channels=24, stage_channels=(32, 64, 128), head_channels=128)),
    Variant("narrower", replace(FAST, stage_channels=(24, 32, 64), head_channels=64)),
    Variant("no context block", replace(FAST, context_blocks=0)),
    Variant("deep", replace(FAST, stage_blocks=2)),
    Variant("GroupNorm", replace(FAST, norm="group")),
    Variant("head of 48", replace(FAST, head_channels=48)),
)
ABLATIONS = (
    Variant("fast"),
    Variant("fast, another seed", seed=1),
    Variant("one grid", loss=MultiTaskLoss(main_grid_only=True)),
    Variant("cross entropy", loss=MultiTaskLoss(classification="cross_entropy")),
    Variant("smooth L1", loss=MultiTaskLoss(regression="smooth_l1")),
    Variant("L2", loss=MultiTaskLoss(regression="l2")),
    Variant("ends from left to right", loss=MultiTaskLoss(any_order=False)),
)
VARIANTS = {"networks": NETWORKS, "ablations": ABLATIONS}


@dataclass(frozen=True, slots=True)
class Comparison:
    """Folders of the set and of the runs, and how long each variant is trained."""

    folder: Path
    backgrounds: tuple[str, ...]
    sets: tuple[Path, ...]  # folders with pixel truth to evaluate on
    images: int = 3700
    steps: int = 4000
    batch_size: int = 4
    crop: int = 192
    seed: int = 7

    @property
    def drawn(self) -> Path:
        """Folder of the training set."""
        return self.folder / "set"

    def draw(self, workers: int, on_image: Callable[[], None]) -> None:
        """Draw the set, unless it exists."""
        count = self.images + VALIDATION_IMAGES
        draw_set(self.drawn, self.backgrounds, count, seed=self.seed, workers=workers, on_image=on_image)


@dataclass(frozen=True, slots=True)
class Result:
    """Scores of one variant: ODS at 1 px of raw segments by set, and the loss on the validation images."""

    name: str
    parameters: int
    steps: int
    validation_loss: float
    ods: dict[str, float]


@dataclass(frozen=True, slots=True)
class Row:
    """A result with the CPU time of a 512 x 512 image on one thread, ms, by runtime."""

    result: Result
    cpu_ms: dict[str, float]


def compare_all(
    comparison: Comparison,
    variants: Sequence[Variant],
    *,
    workers: int = 1,
    report: Callable[[str, int], None] = lambda _task, _step: None,
) -> list[Row]:
    """Draw the set, run each variant that has no result yet, and time all of them.

    `report` is called with the current task and the steps of all variants so far.
    """
    comparison.draw(workers, on_image=lambda: report("draw", 0))
    results = []
    for i, variant in enumerate(variants):

        def report_step(step: int, name: str = variant.name, before: int = i * comparison.steps) -> None:
            report(name, before + step)

        results.append(run_variant(comparison, variant, report_step))
    return [Row(r, cpu_ms_of(v.network)) for r, v in zip(results, variants, strict=True)]


@cache
def cpu_ms_of(network: LSNetConfig) -> dict[str, float]:
    """Measure the CPU time of a 512 x 512 image on one thread, ms, by the installed runtimes."""
    torch.manual_seed(0)
    net = LSNet(network).eval()
    backends: dict[str, Backend] = {"torch": TorchBackend(net)}
    if find_spec("openvino") is not None:
        precisions = ["f32", "bf16", *(["int8"] if find_spec("nncf") is not None else [])]
        backends |= {f"openvino {p}": OpenVinoBackend(net, p, threads=1) for p in precisions}
    return {name: least_cpu_ms(backend) for name, backend in backends.items()}


def results_of(comparison: Comparison) -> dict[str, Result]:
    """The results kept so far, by variant. Raises LSNetError for a damaged file."""
    path = comparison.folder / RESULTS_FILE
    try:
        lines = path.read_text().splitlines() if path.exists() else []
        results = [Result(**json.loads(line)) for line in lines]
    except (OSError, ValueError, TypeError, RecursionError) as err:
        raise LSNetError(f"{path}: damaged; delete it and run again") from err
    return {result.name: result for result in results if result.steps == comparison.steps}


def run_variant(
    comparison: Comparison, variant: Variant, report: Callable[[int], None] = lambda _step: None
) -> Result:
    """Train and score one variant, unless there is a result; `report` is called with each step."""
    kept = results_of(comparison)
    if variant.name in kept:
        return kept[variant.name]
    trainer = _trainer(comparison, variant)
    train_on = Crops.of(comparison.drawn, 0, comparison.images, size=comparison.crop, seed=variant.seed)
    last = comparison.images + VALIDATION_IMAGES
    validate_on = Crops.of(
        comparison.drawn, comparison.images, last, size=comparison.crop, seed=comparison.seed
    )
    trainer.run(train_on, validate_on, report=lambda _progress: report(trainer.step))
    net = trainer.average
    assert isinstance(net, LSNet)  # noqa: S101
    validation = list(trainer.batches(validate_on, range(VALIDATION_IMAGES)))
    result = Result(
        name=variant.name,
        parameters=sum(p.numel() for p in net.parameters()),
        steps=comparison.steps,
        validation_loss=float(trainer.validate(validation).total),
        ods=score(net, comparison.sets, main_grid_only=variant.loss.main_grid_only),
    )
    with (comparison.folder / RESULTS_FILE).open("a") as log:
        log.write(json.dumps(asdict(result)) + "\n")
    return result


def _trainer(comparison: Comparison, variant: Variant) -> Trainer:
    config = TrainConfig(
        preset=variant.name,
        steps=comparison.steps,
        batch_size=comparison.batch_size,
        warmup_steps=min(100, comparison.steps),
        validate_every=max(1, comparison.steps // 2),
        validation_images=VALIDATION_IMAGES,
        workers=0,
    )
    run = comparison.folder / "runs" / variant.name.replace(" ", "_")
    return Trainer(config, run, seed=variant.seed, task=LSNetTask(variant.network, variant.loss))


def score(net: LSNet, sets: Sequence[Path], *, main_grid_only: bool = False) -> dict[str, float]:
    """Return the ODS at 1 px of the raw segments of a network, by name of the set."""
    card = WeightsCard("compared", "compared", net.config, min_score=0.5)
    backend = OnlyGrids(TorchBackend(net), "M" if main_grid_only else "MHVC")
    detector = Detector(Weights(net, card, ""), backend, scale=None, min_score=0.05)
    found = {}
    for folder in sets:
        (report,) = evaluate(detector, folder, min_score=0.5, tolerances_px=(1.0,))
        if not isinstance(report, PixelReport):
            raise LSNetError(f"{folder}: has no pixel truth; give folders with masks or boundaries")
        found[folder.name] = report.ods.f1
    return found
