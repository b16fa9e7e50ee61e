"""From the command line to a run and from a run to weights: what is trained on, and what is shipped."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from lsnet.errors import LSNetError
from lsnet.model import LSNet, LSNetConfig
from lsnet.synth.backgrounds import BackgroundFolder, BackgroundPool
from lsnet.synth.dataset import SyntheticScenes
from lsnet.synth.pbr.scenes import RenderedScenes
from lsnet.tiles import STRIDE_PX
from lsnet.training.checkpoints import LAST_KEYS, load_checkpoint
from lsnet.training.labels import LabelledScenes, load_labels
from lsnet.weights import WeightsCard, save_weights

if TYPE_CHECKING:
    from pathlib import Path

    from lsnet.synth.dataset import SampleSource

VALIDATION_SEED = 1_000_000  # added to the seed: no validation image is ever trained on


@dataclass(frozen=True, slots=True)
class TrainingData:
    """Where samples come from: `backgrounds` as DIR[:FIRST] to draw on, or `data` with labels.

    With `rendered`, a folder of `model synth`, its cables lie over the backgrounds instead of drawn ones.
    """

    backgrounds: tuple[str, ...]
    data: Path | None
    validation: Path | None
    labels: tuple[str, ...]
    size: int
    seed: int
    rendered: Path | None = None

    def describe(self) -> str:
        """One line for the recipe: names, not paths."""
        if self.data:
            return f"labelled {self.data.name}, {self.size} px, seed {self.seed}"
        names = [str(BackgroundFolder.parse(text)) for text in self.backgrounds]
        how = f"{self.rendered.name} over" if self.rendered else "drawn on"
        return f"{how} {', '.join(names) or 'plain grounds'}, {self.size} px, seed {self.seed}"


def open_sources(data: TrainingData) -> tuple[SampleSource, SampleSource]:
    """Samples to train and to validate on.

    Raises LSNetError for unusable folders, another size, or what does not go together.
    """
    if data.size % STRIDE_PX:
        raise LSNetError(f"crops of {data.size} px do not fit the cells; give a multiple of {STRIDE_PX}")
    if data.data is None:
        if data.validation or data.labels:
            raise LSNetError(
                "validation images and labels need labelled images to train on; give some as data"
            )
        pool = BackgroundPool([BackgroundFolder.parse(text) for text in data.backgrounds])
        unseen = SyntheticScenes(pool, data.size, data.seed + VALIDATION_SEED)
        if data.rendered:
            return RenderedScenes(data.rendered, pool, data.size, data.seed), unseen
        return SyntheticScenes(pool, data.size, data.seed), unseen
    if data.backgrounds or data.rendered:
        raise LSNetError("labelled images are used as they are; leave out backgrounds and rendered pictures")
    if data.validation is None:
        raise LSNetError("labelled images need other ones for validation, to know when to stop")
    train, validation = (load_labels(folder, data.labels) for folder in (data.data, data.validation))
    return (
        LabelledScenes(train, data.size, data.seed),
        LabelledScenes(validation, data.size, data.seed + VALIDATION_SEED),
    )


def export_run(run: Path, output: Path, name: str, min_score: float, metrics: Path | None) -> str:
    """Write the averaged weights of a run with the least validation loss; the sha256 of the file.

    Raises LSNetError when the folder holds no finished validation, or checkpoints of two networks, or the
    metrics are no JSON lines.
    """
    if not (run / "best.pt").is_file() or not (run / "last.pt").is_file():
        raise LSNetError(f"{run}: no best.pt and last.pt in it; train a run to its first validation")
    best = load_checkpoint(run / "best.pt")
    recipe: dict[str, Any] = load_checkpoint(run / "last.pt", LAST_KEYS)["recipe"]
    try:
        measured = [json.loads(line) for line in metrics.read_text().splitlines()] if metrics else []
    except (OSError, ValueError, RecursionError) as err:
        raise LSNetError(f"{metrics}: not the output of lsnet-pipe model eval --json") from err
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
