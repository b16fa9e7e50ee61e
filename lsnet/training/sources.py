"""Sources of samples for a training run, and the export of its weights."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from lsnet.errors import LSNetError
from lsnet.model import LSNet
from lsnet.network_config import LSNetConfig
from lsnet.synth.backgrounds import BackgroundFolder, BackgroundPool
from lsnet.synth.dataset import SyntheticScenes
from lsnet.synth.paper import PaperScenes
from lsnet.synth.pbr.scenes import RenderedScenes, rendered_pictures
from lsnet.tiles import STRIDE_PX
from lsnet.training.checkpoints import LAST_KEYS, load_checkpoint
from lsnet.training.labels import LabelledScenes, load_labels
from lsnet.weights import save_weights
from lsnet.weights_file import WeightsCard

if TYPE_CHECKING:
    from pathlib import Path

    from lsnet.synth.backgrounds import Part
    from lsnet.synth.dataset import SampleSource

VALIDATION_SEED = 1_000_000  # added to the seed, which is smaller: validation images are never trained on


@dataclass(frozen=True, slots=True)
class TrainingData:
    """Where samples come from: cables drawn over backgrounds, or labelled images.

    Attributes:
        backgrounds: Folders to draw on, DIR or DIR:FIRST.
        data: Folder of labelled images to train on instead.
        validation: Folder of labelled images to validate on.
        labels: Labels that count as lines; empty for all.
        size: Side of the training images, px.
        seed: Seed of the samples, less than a million.
        rendered: Folder of `model synth`, whose cables replace drawn ones.
        augmentation: All techniques, or those of the paper only, as in `PaperScenes`.
    """

    backgrounds: tuple[str, ...]
    data: Path | None
    validation: Path | None
    labels: tuple[str, ...]
    size: int
    seed: int
    rendered: Path | None = None
    augmentation: Literal["all", "paper"] = "all"

    @property
    def holds_out(self) -> bool:
        """Whether the last tenth of the pictures and photographs is for validation only."""
        return self.rendered is not None or self.augmentation == "paper"

    def describe(self) -> str:
        """Return one line for the recipe, with names instead of paths."""
        if self.data:
            return f"labelled {self.data.name}, {self.size} px, seed {self.seed}"
        names = [str(BackgroundFolder.parse(text)) for text in self.backgrounds]
        how = f"{self.rendered.name} over" if self.rendered else "drawn on"
        text = f"{how} {', '.join(names) or 'plain grounds'}, {self.size} px, seed {self.seed}"
        text += ", last tenth held out" if self.holds_out else ""
        return text + (", augmentations of the paper" if self.augmentation == "paper" else "")


def open_sources(data: TrainingData) -> tuple[SampleSource, SampleSource]:
    """Open the samples for training and for validation.

    Raises:
        LSNetError: A folder cannot be used, the size does not fit the cells, or options contradict.
    """
    if data.size % STRIDE_PX:
        raise LSNetError(f"crops of {data.size} px do not fit the cells; give a multiple of {STRIDE_PX}")
    if not 0 <= data.seed < VALIDATION_SEED:
        raise LSNetError(
            f"seed {data.seed} is that of validation images; give one from 0 to {VALIDATION_SEED - 1}"
        )
    if data.data is None:
        if data.validation or data.labels:
            raise LSNetError(
                "validation images and labels need labelled images to train on; give some as data"
            )
        unseen = data.seed + VALIDATION_SEED
        if not data.holds_out:
            return _drawn(data, "all", data.seed), _drawn(data, "all", unseen)
        return _drawn(data, "training", data.seed), _drawn(data, "held out", unseen)
    if data.backgrounds or data.rendered:
        raise LSNetError("labelled images are used as they are; leave out backgrounds and rendered pictures")
    if data.augmentation == "paper":
        raise LSNetError("the paper's augmentations are of its rendered cables; leave out labelled images")
    if data.validation is None:
        raise LSNetError("labelled images need other ones for validation, to know when to stop")
    train, validation = (load_labels(folder, data.labels) for folder in (data.data, data.validation))
    return (
        LabelledScenes(train, data.size, data.seed),
        LabelledScenes(validation, data.size, data.seed + VALIDATION_SEED),
    )


def _drawn(data: TrainingData, part: Part, seed: int) -> SampleSource:
    folders = [BackgroundFolder.parse(text, part) for text in data.backgrounds]
    pictures = rendered_pictures(data.rendered, part) if data.rendered else []
    if data.augmentation == "paper":
        return PaperScenes(BackgroundPool(folders, drawn=False), data.size, seed, pictures)
    pool = BackgroundPool(folders)
    return (
        RenderedScenes(pictures, pool, data.size, seed)
        if pictures
        else SyntheticScenes(pool, data.size, seed)
    )


def export_run(run: Path, output: Path, name: str, min_score: float, metrics: Path | None) -> str:
    """Write the averaged weights with the least validation loss of a run; return the sha256 of the file.

    Raises:
        LSNetError: The folder has no finished validation, or checkpoints of two networks, or the metrics are
            not JSON lines.
    """
    if not (run / "best.pt").is_file() or not (run / "last.pt").is_file():
        raise LSNetError(f"{run}: no best.pt and last.pt in this folder; train to the first validation")
    best = load_checkpoint(run / "best.pt")
    recipe: dict[str, Any] = load_checkpoint(run / "last.pt", LAST_KEYS)["recipe"]
    try:
        measured = [json.loads(line) for line in metrics.read_text().splitlines()] if metrics else []
    except (OSError, ValueError, RecursionError) as err:
        raise LSNetError(f"{metrics}: not the output of lsnet-pipe model eval --json") from err
    if "rival" in recipe:
        raise LSNetError(f"{run}: a run of a rival; score it with lsnet-pipe model eval --rival {run}")
    try:
        config = LSNetConfig(**recipe.pop("network"))
        net = LSNet(config)
        net.load_state_dict(best["average"])
    except (LookupError, TypeError, RuntimeError) as err:
        raise LSNetError(f"{run}: best.pt is not of the network of last.pt; train it again") from err
    card = WeightsCard(
        name=name,
        preset=recipe["preset"],
        network=config,
        min_score=min_score,
        recipe=recipe | {"trained_steps": best["step"]},
        metrics={"evaluated": measured},
    )
    return save_weights(output, net, card)
