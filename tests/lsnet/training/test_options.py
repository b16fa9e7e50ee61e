"""Options of networks, losses and devices."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from nets import TINY

from lsnet.errors import LSNetError
from lsnet.training.devices import choose_device
from lsnet.training.tasks import open_task


@pytest.mark.parametrize(
    ("network", "loss"),
    [
        (["depth=3"], []),
        (["head_channels"], []),
        (["head_channels=x"], []),
        (["downsample=mean"], []),
        ([], ["w=0"]),
        ([], ["any_order=maybe"]),
        ([], ["regression=l3"]),
    ],
)
def test_unusable_options_are_one_line(network: list[str], loss: list[str]) -> None:
    with pytest.raises(LSNetError, match="option") as error:
        open_task("tiny", network, loss)
    assert "\n" not in str(error.value)


def test_options_are_of_the_type_of_their_defaults() -> None:
    task = open_task("tiny", ["stage_channels=2,4,4", "stem_channels=2", "centred=true"], ["gamma=1"])
    assert task.network == replace(TINY, stage_channels=(2, 4, 4), stem_channels=2, centred=True)
    assert task.loss.gamma == 1.0


def test_devices_that_are_not_there_are_one_line() -> None:
    assert choose_device("cpu").type == "cpu"
    with pytest.raises(LSNetError, match="no device 'tpu'; choose one of"):
        choose_device("tpu")
    if torch.cuda.is_available():
        assert choose_device("auto").type == "cuda"
        return
    assert choose_device("auto").type == "cpu"
    with pytest.raises(LSNetError, match="no GPU that this build of torch can use; give --device cpu"):
        choose_device("cuda")
