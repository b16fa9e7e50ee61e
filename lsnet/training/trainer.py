"""Training (Section III-D), from synthetic or labelled images to checkpoints.

The folder of a run holds `last.pt` (the state to continue from), `best.pt` (the averaged weights with the
least validation loss) and `log.jsonl`. An interrupted run continues from `last.pt`, with the samples that it
would have seen.
"""

from __future__ import annotations

import json
import math
import time
from dataclasses import asdict, replace
from functools import reduce
from typing import TYPE_CHECKING, Any

import torch

from lsnet.errors import LSNetError
from lsnet.files import make_folder
from lsnet.network_config import PRESETS
from lsnet.training.batches import load_batches
from lsnet.training.checkpoints import LAST_KEYS, load_checkpoint, other_options, read_start, save_checkpoint
from lsnet.training.devices import autocast, choose_device
from lsnet.training.losses import LossParts, LossSums
from lsnet.training.recipe import TrainConfig, TrainingProgress, learning_rate_at
from lsnet.training.tasks import LSNetTask

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from torch import nn

    from lsnet.synth.dataset import SampleSource
    from lsnet.training.batches import Batch
    from lsnet.training.tasks import Task


class Trainer:
    """A run: the network, its average, the optimizer, and their progress."""

    def __init__(
        self,
        config: TrainConfig,
        run_dir: Path,
        *,
        seed: int = 0,
        start: str | Path | None = None,
        task: Task | None = None,
    ) -> None:
        """Start a run, or continue the one in the folder.

        Args:
            config: The recipe.
            run_dir: Folder of the run.
            seed: Of the initial weights.
            start: Initial weights: the `best.pt` of another run, or as in `load_weights`. A narrower network
                takes their most important channels.
            task: Network, targets and loss. Default: LS-Net of the preset with the default loss.

        Raises:
            LSNetError: The folder holds a run with other options, or the network or the device does not fit.
        """
        torch.manual_seed(seed)
        torch.set_num_threads(config.threads)
        self.config, self.run_dir = config, run_dir
        self.task: Task = task or LSNetTask(PRESETS[config.preset])
        self.device = choose_device(config.device)
        self.net = self._build()
        self.average = self._build().eval()
        self.optimizer = torch.optim.AdamW(
            self.net.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay
        )
        self.step, self.best_loss, self.bad_validations = 0, math.inf, 0
        started, self._start_sha256 = read_start(start, self.net) if start else ({}, "")
        make_folder(run_dir)
        if (run_dir / "last.pt").exists():
            self._restore()
        elif started:
            self.net.load_state_dict(started)
        if self.step == 0:
            self.average.load_state_dict(self.net.state_dict())

    def _build(self) -> nn.Module:
        net: nn.Module = self.task.build().to(self.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        return net

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
        validation_batches = list(self.batches(validation, range(config.validation_images)))
        indices = range(self.step * config.batch_size, config.steps * config.batch_size)
        for progress in self._epoch(self.batches(samples, indices)):
            if not self._is_validation_due():
                report(progress)
                continue
            losses = [float(part) for part in self.validate(validation_batches)]
            if not math.isfinite(losses[0]):
                raise LSNetError(f"{self.run_dir}: the loss is no longer finite; lower the learning rate")
            validated = replace(
                progress,
                validation_loss=losses[0],
                validation_classification=losses[1],
                validation_regression=losses[2],
            )
            report(validated)
            self._log(validated)
            self._keep(losses[0])
            if self.bad_validations >= config.patience:
                return

    def batches(self, samples: SampleSource, indices: range) -> Iterator[Batch]:
        """Yield the samples of `indices` in batches of the recipe."""
        sizes = {"batch_size": self.config.batch_size, "workers": self.config.workers}
        return load_batches(samples, indices, self.task, **sizes)

    def validate(self, batches: list[Batch]) -> LossParts:
        """Return the losses of the averaged network over the cells of all batches."""
        with torch.no_grad():
            sums = [self._sums(self.average, batch) for batch in batches]
        return reduce(LossSums.plus, sums).mean()

    def _epoch(self, batches: Iterator[Batch]) -> Iterator[TrainingProgress]:
        """Train on the batches; yield progress every 50 steps and before each validation."""
        totals, count, clock = torch.zeros(3, device=self.device), 0, time.monotonic()
        for batch in batches:
            losses = self._train_step(batch)
            totals += torch.stack(
                [part.detach() for part in losses]
            )  # not read at each step: a GPU would wait
            count += 1
            if self.step % 50 and not self._is_validation_due():
                continue
            rate = count * self.config.batch_size / (time.monotonic() - clock)
            loss, cells, ends = (totals / count).tolist()
            yield TrainingProgress(self.step, self.config.steps, loss, cells, ends, rate)
            totals, count, clock = torch.zeros(3, device=self.device), 0, time.monotonic()

    def _is_validation_due(self) -> bool:
        return self.step % self.config.validate_every == 0 or self.step == self.config.steps

    def _train_step(self, batch: Batch) -> LossParts:
        self.net.train()
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate_at(self.step, self.config)
        losses = self._sums(self.net, batch).mean()
        self.optimizer.zero_grad(set_to_none=True)
        losses.total.backward()  # type: ignore[no-untyped-call]
        if self.config.clip_norm is not None:
            torch.nn.utils.clip_grad_norm_(self.net.parameters(), self.config.clip_norm)
        self.optimizer.step()
        self.step += 1
        self._update_average()
        return losses

    def _sums(self, net: nn.Module, batch: Batch) -> LossSums:
        images, *targets = (tensor.to(self.device, non_blocking=True) for tensor in batch)
        pixels = images.to(memory_format=torch.channels_last).float().div_(255)
        with autocast(self.device):
            output = net(pixels)
        return self.task.sums(output, *targets)

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
            best = {"average": self.average.state_dict(), "step": self.step, "recipe": self._recipe()}
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
        return asdict(self.config) | self.task.describe() | {"start_sha256": self._start_sha256}

    def _restore(self) -> None:
        path = self.run_dir / "last.pt"
        state = load_checkpoint(path, LAST_KEYS)
        changed = other_options(state["recipe"], self._recipe())
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
