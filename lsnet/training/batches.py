"""Samples as batches of tensors, encoded in worker processes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset

from lsnet.errors import LSNetError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from torch import Tensor

    from lsnet.synth.dataset import SampleSource
    from lsnet.training.tasks import Task

    Batch = list[Tensor]


class _Encoded(Dataset["tuple[Tensor, ...]"]):
    """Samples as tensors: image (3, H, W) uint8, and the targets of the task."""

    def __init__(self, samples: SampleSource, task: Task) -> None:
        self._samples, self._task = samples, task

    def __getitem__(self, index: int) -> tuple[Tensor, ...]:
        sample = self._samples[index]
        image = torch.from_numpy(np.ascontiguousarray(sample.image.transpose(2, 0, 1)))
        return image, *self._task.encode(sample)


def load_batches(
    samples: SampleSource, indices: range, task: Task, *, batch_size: int, workers: int
) -> Iterator[Batch]:
    """Yield the samples of `indices` in batches, in order: images, then the targets of the task.

    With workers, OpenCV runs on one thread from then on: a forked worker has no copies of OpenCV's threads,
    and would wait for them forever.

    Raises:
        LSNetError: A sample cannot be read.
    """
    if workers:
        cv2.setNumThreads(0)
    batches = DataLoader(
        _Encoded(samples, task),
        batch_size=batch_size,
        sampler=indices,
        num_workers=workers,
        prefetch_factor=6 if workers else None,
        worker_init_fn=_single_threaded,
    )
    try:
        yield from batches
    except LSNetError as err:  # from a worker it has the traceback before the message
        raise LSNetError(str(err.args[0]).rstrip().rpartition("LSNetError: ")[2]) from err


def _single_threaded(_worker: int) -> None:
    torch.set_num_threads(1)
