"""Training on the CPU (Section III-D), from synthetic or labelled images to checkpoints.

The folder of a run holds `last.pt` (the state to continue from), `best.pt` (the averaged weights with the
least validation loss) and `log.jsonl`. An interrupted run continues from `last.pt`, with the samples that it
would have seen.
"""

from __future__ import annotations

import json
import math
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from lsnet.errors import LSNetError
from lsnet.files import make_folder
from lsnet.losses import LossParts, MultiTaskLoss
from lsnet.model import PRESETS, LSNet, LSNetConfig
from lsnet.training.batches import load_batches
from lsnet.training.checkpoints import LAST_KEYS, load_checkpoint, save_checkpoint
from lsnet.training.pruning import slim
from lsnet.weights import load_weights

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from lsnet.synth.dataset import SampleSource
    from lsnet.training.batches import Batch


@dataclass(frozen=True, slots=True)
class TrainConfig:
    """Recipe of one run."""

    preset: str = "fast"
    steps: int = 10_000
    batch_size: int = 8
    learning_rate: float = 2e-3
    weight_decay: float = 0.01
    warmup_steps: int = 200
    ema_decay: float = 0.998  # of the averaged weights, which are exported
    validate_every: int = 500
    validation_images: int = 256
    patience: int = 12  # validations without improvement before the run stops
    threads: int = 1
    workers: int = 1
    data: str = ""  # description of the training data


@dataclass(frozen=True, slots=True)
class TrainingProgress:
    """Report during training: mean losses since the last report."""

    step: int
    steps: int
    loss: float
    classification: float
    regression: float
    images_per_s: float
    validation_loss: float | None = None


def learning_rate_at(step: int, config: TrainConfig) -> float:
    """Return the learning rate: linear warm-up, then a cosine down to a hundredth."""
    if step < config.warmup_steps:
        return config.learning_rate * (step + 1) / config.warmup_steps
    t = (step - config.warmup_steps) / max(1, config.steps - config.warmup_steps)
    return config.learning_rate * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * min(t, 1.0))))


class Trainer:
    """A run: the network, its average, the optimizer, and their progress."""

    def __init__(
        self,
        config: TrainConfig,
        run_dir: Path,
        *,
        seed: int = 0,
        start: str | Path | None = None,
        network: LSNetConfig | None = None,
        loss: MultiTaskLoss | None = None,
    ) -> None:
        """Start a run, or continue the one in the folder.

        Args:
            config: The recipe.
            run_dir: Folder of the run.
            seed: Of the initial weights.
            start: Initial weights: the `best.pt` of another run, or as in `load_weights`. A narrower network
                takes their most important channels.
            network: Replaces that of the preset, for comparisons.
            loss: Replaces the default loss.

        Raises:
            LSNetError: The folder holds a run with other recipe, or the network does not fit.
        """
        torch.manual_seed(seed)
        torch.set_num_threads(config.threads)
        self.config, self.run_dir = config, run_dir
        network = network or PRESETS[config.preset]
        self.net = LSNet(network).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.average = LSNet(network).eval()
        self.optimizer = torch.optim.AdamW(
            self.net.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay
        )
        self.loss = loss or MultiTaskLoss()
        self.step, self.best_loss, self.bad_validations = 0, math.inf, 0
        make_folder(run_dir)
        if (run_dir / "last.pt").exists():
            self._restore()
        elif start:
            self._begin_with(start)
        if self.step == 0:
            self.average.load_state_dict(self.net.state_dict())

    def run(
        self, samples: SampleSource, validation: SampleSource, report: Callable[[TrainingProgress], None]
    ) -> None:
        """Train to the last step or until validation stops improving; `report` is called every 50 steps.

        Raises:
            LSNetError: The loss is no longer finite, or a checkpoint cannot be written.
        """
        config = self.config
        if self.step >= config.steps or self.bad_validations >= config.patience:
            return
        sizes = {"batch_size": config.batch_size, "workers": config.workers}
        validation_batches = list(load_batches(validation, range(config.validation_images), **sizes))
        first, last = self.step * config.batch_size, config.steps * config.batch_size
        batches = load_batches(samples, range(first, last), **sizes)
        for progress in self._epoch(batches):
            if not self._is_validation_due():
                report(progress)
                continue
            loss = self.validate(validation_batches)
            if not math.isfinite(loss):
                raise LSNetError(f"{self.run_dir}: the loss is no longer finite; lower the learning rate")
            report(replace(progress, validation_loss=loss))
            self._log(replace(progress, validation_loss=loss))
            self._keep(loss)
            if self.bad_validations >= config.patience:
                return

    def validate(self, batches: list[Batch]) -> float:
        """Return the mean loss of the averaged network."""
        with torch.no_grad():
            losses = [float(self._losses(self.average, batch).total) for batch in batches]
        return sum(losses) / len(losses)

    def _epoch(self, batches: Iterator[Batch]) -> Iterator[TrainingProgress]:
        """Train on the batches; yield progress every 50 steps and before each validation."""
        totals, count, clock = np.zeros(3), 0, time.monotonic()
        for batch in batches:
            losses = self._train_step(batch)
            totals += [float(part.detach()) for part in losses]
            count += 1
            if self.step % 50 and not self._is_validation_due():
                continue
            rate = count * self.config.batch_size / (time.monotonic() - clock)
            mean = totals / count
            yield TrainingProgress(self.step, self.config.steps, mean[0], mean[1], mean[2], rate)
            totals, count, clock = np.zeros(3), 0, time.monotonic()

    def _is_validation_due(self) -> bool:
        return self.step % self.config.validate_every == 0 or self.step == self.config.steps

    def _train_step(self, batch: Batch) -> LossParts:
        self.net.train()
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate_at(self.step, self.config)
        losses = self._losses(self.net, batch)
        self.optimizer.zero_grad(set_to_none=True)
        losses.total.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self.net.parameters(), 5.0)
        self.optimizer.step()
        self.step += 1
        self._update_average()
        return losses

    def _losses(self, net: LSNet, batch: Batch) -> LossParts:
        images, labels, endpoints = batch
        pixels = images.to(memory_format=torch.channels_last).float().div_(255)
        with torch.autocast("cpu", dtype=torch.bfloat16):
            output = net(pixels)
        return self.loss(output, labels, endpoints)

    def _update_average(self) -> None:
        """Update the exponential moving average, with a shorter memory in early steps."""
        decay = min(self.config.ema_decay, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            now = self.net.state_dict()
            for name, kept in self.average.state_dict().items():
                if kept.is_floating_point():
                    kept.lerp_(now[name].to(kept.dtype), 1 - decay)
                else:
                    kept.copy_(now[name])

    def _keep(self, loss: float) -> None:
        if loss < self.best_loss:
            self.best_loss, self.bad_validations = loss, 0
            best = {"average": self.average.state_dict(), "step": self.step}
            save_checkpoint(best, self.run_dir / "best.pt")
        else:
            self.bad_validations += 1
        save_checkpoint(self._state(), self.run_dir / "last.pt")

    def _state(self) -> dict[str, Any]:
        return {
            "recipe": self._recipe(),
            "net": self.net.state_dict(),
            "average": self.average.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "step": self.step,
            "best_loss": self.best_loss,
            "bad_validations": self.bad_validations,
        }

    def _recipe(self) -> dict[str, Any]:
        return asdict(self.config) | {"network": asdict(self.net.config)}

    def _begin_with(self, start: str | Path) -> None:
        try:
            if Path(start).suffix == ".pt":
                state = load_checkpoint(Path(start))["average"]
            else:
                state = slim(load_weights(start).net, self.net.config).state_dict()
            self.net.load_state_dict(state)
        except (RuntimeError, ValueError) as err:
            raise LSNetError(
                f"{start}: not weights of a {self.config.preset} network or a wider one; give such weights"
            ) from err

    def _restore(self) -> None:
        path = self.run_dir / "last.pt"
        state = load_checkpoint(path, LAST_KEYS)
        ours = self._recipe()
        changed = [k for k in ours if k not in ("threads", "workers") and state["recipe"].get(k) != ours[k]]
        if changed:
            raise LSNetError(
                f"{self.run_dir}: holds a run with other {', '.join(changed)}; give another run folder"
            )
        try:
            self.net.load_state_dict(state["net"])
            self.average.load_state_dict(state["average"])
            self.optimizer.load_state_dict(state["optimizer"])
        except (LookupError, RuntimeError, ValueError) as err:
            raise LSNetError(f"{path}: damaged or of another version; give another run folder") from err
        self.step, self.best_loss = state["step"], state["best_loss"]
        self.bad_validations = state["bad_validations"]

    def _log(self, progress: TrainingProgress) -> None:
        with (self.run_dir / "log.jsonl").open("a") as log:
            log.write(json.dumps(asdict(progress)) + "\n")
