"""Pruning: channels without effect can be dropped without changing the output."""

from dataclasses import replace

import pytest
import torch
from nets import TINY, save_tiny, tiny_net

from lsnet import LSNetError
from lsnet.model import ConvNormAct, LSNet, Residual
from lsnet.network_config import PRESETS, LSNetConfig
from lsnet.training.pruning import slim
from lsnet.training.trainer import TrainConfig, Trainer

NARROW = replace(TINY, stem_channels=3, stage_channels=(2, 5, 6), head_channels=4, context_blocks=1)


def silence(layer: torch.nn.Module, live: torch.Tensor) -> None:
    """Set all channels but `live` to zero."""
    dead = torch.ones(layer[1].num_features, dtype=torch.bool)
    dead[live] = False
    with torch.no_grad():
        layer[1].weight[dead] = 0
        layer[1].bias[dead] = 0


def silenced(config: LSNetConfig) -> LSNet:
    """Return a wider network with as many active channels as `config`, different ones in each layer."""
    net = tiny_net(config=replace(TINY, context_blocks=1))
    widths = [config.stem_channels, *config.stage_channels]
    trunk = -1
    for layer in net.extractor:
        if isinstance(layer, ConvNormAct):
            trunk += 1
            live = torch.randperm(layer[1].num_features)[: widths[trunk]]
            silence(layer, live)
        elif isinstance(layer, Residual):
            silence(layer.body[0], torch.randperm(len(layer.body[0][1].weight))[: widths[trunk]])
            silence(layer.body[1], live)
    for head in (net.classifier, net.regressor):
        silence(head[0], torch.randperm(TINY.head_channels)[: config.head_channels])
    return net


@pytest.mark.parametrize("seed", range(3))
def test_pruning_silent_channels_changes_nothing(seed: int) -> None:
    torch.manual_seed(seed)
    wide = silenced(NARROW)
    narrow = slim(wide, NARROW).eval()
    images = torch.rand(2, 3, 96, 64)
    assert sum(p.numel() for p in narrow.parameters()) < sum(p.numel() for p in wide.parameters())
    for ours, theirs in zip(narrow(images), wide(images), strict=True):
        torch.testing.assert_close(ours, theirs)


def test_the_same_widths_are_the_same_network() -> None:
    net = tiny_net()
    assert slim(net, TINY) is net


@pytest.mark.parametrize(
    "other",
    [
        replace(TINY, head_channels=16),
        replace(TINY, stem_channels=None, stage_channels=(4, 4, 8, 8)),
        replace(TINY, stage_blocks=2),
    ],
    ids=["wider", "stages", "depth"],
)
def test_only_widths_can_shrink(other: LSNetConfig) -> None:
    with pytest.raises(ValueError, match="widths"):
        slim(tiny_net(), other)


def test_training_starts_from_the_most_important_channels(tmp_path, monkeypatch) -> None:
    wide = save_tiny(tmp_path / "wide.safetensors")
    monkeypatch.setitem(PRESETS, "fast", replace(TINY, stage_channels=(4, 6, 8)))
    trainer = Trainer(TrainConfig(), tmp_path / "run", start=wide)
    expected = slim(tiny_net(), PRESETS["fast"]).state_dict()
    for name, value in trainer.average.state_dict().items():
        torch.testing.assert_close(value, expected[name])
    monkeypatch.setitem(PRESETS, "fast", replace(TINY, stage_channels=(4, 6, 9)))
    with pytest.raises(LSNetError, match=r"wide\.safetensors: not weights of this network or a wider one"):
        Trainer(TrainConfig(), tmp_path / "other", start=wide)


@pytest.mark.parametrize("is_shared", [False, True], ids=["own", "shared"])
def test_a_head_that_both_share_holds_the_channels_of_each(is_shared: bool) -> None:
    own = LSNet(replace(TINY, shared_head=is_shared))
    width = TINY.head_channels * (1 if is_shared else 2)
    ours = slim(own, replace(own.config, shared_head=True, head_channels=width)).eval()
    images = torch.rand(2, 3, 64, 96)
    for expected, found in zip(own.eval()(images), ours(images), strict=True):
        torch.testing.assert_close(found, expected)


def test_plain_stages_lose_their_residual_blocks_only() -> None:
    wide = tiny_net()
    silence(wide.extractor[2].body[1], torch.tensor([], dtype=torch.long))
    ours = slim(wide, replace(TINY, plain_stages=1)).eval()
    images = torch.rand(1, 3, 64, 64)
    assert len(ours.extractor) == len(wide.extractor) - 1
    for expected, found in zip(wide(images), ours(images), strict=True):
        torch.testing.assert_close(found, expected)
