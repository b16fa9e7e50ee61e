"""Batches that other processes draw."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from nets import TINY
from training_runs import Strokes

from lsnet.errors import LSNetError
from lsnet.training.batches import load_batches
from lsnet.training.tasks import LSNetTask

if TYPE_CHECKING:
    from lsnet.synth.drawing import Sample


class Unreadable(Strokes):
    """Samples of a file that is damaged."""

    def __getitem__(self, index: int) -> Sample:
        raise LSNetError("a.png: damaged; remove it")


@pytest.mark.parametrize("workers", [0, 1])
def test_a_sample_that_cannot_be_read_is_one_line(workers: int) -> None:
    with pytest.raises(LSNetError) as error:
        list(load_batches(Unreadable(), range(2), LSNetTask(TINY), batch_size=2, workers=workers))
    assert str(error.value) == "a.png: damaged; remove it"


class Blurred(Strokes):
    """Images that need OpenCV's threads, where it has any."""

    def __getitem__(self, index: int) -> Sample:
        cv2.GaussianBlur(np.zeros((500, 500, 3), np.uint8), (0, 0), 3)
        return super().__getitem__(index)


@pytest.mark.timeout(30)
def test_a_worker_draws_images_after_opencv_ran_threads_in_the_training_process() -> None:
    before = cv2.getNumThreads()
    cv2.setNumThreads(2)
    try:
        cv2.GaussianBlur(np.zeros((2000, 2000, 3), np.uint8), (0, 0), 3)
        batches = list(load_batches(Blurred(), range(4), LSNetTask(TINY), batch_size=2, workers=1))
    finally:
        cv2.setNumThreads(before)
    assert [len(images) for images, _, _ in batches] == [2, 2]
