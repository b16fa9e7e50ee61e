"""The network against the paper's table, and the properties of its parts."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from nets import TINY, tiny_net
from torch import nn

from lsnet.model import EndPadded, LSNet
from lsnet.network_config import PRESETS, LSNetConfig
from lsnet.runtime.torch import fold_norms

# Table I of the paper: kernel, channels, stride.
EXTRACTOR_ROWS = [
    *((3, 64, 1), (3, 64, 1), (3, 64, 2)),
    *((3, 128, 1), (3, 128, 1), (3, 128, 2)),
    *((3, 256, 1), (3, 256, 1), (3, 256, 2)),
    *((3, 512, 1), (3, 512, 1), (3, 512, 2)),
]
HEAD_ROWS = {"classifier": [(2, 512, 1), (1, 2, 1)], "regressor": [(2, 512, 1), (1, 4, 1)]}


def rows_of(module: nn.Module) -> list[tuple[int, int, int]]:
    convolutions = [m for m in module.modules() if isinstance(m, nn.Conv2d)]
    return [(c.kernel_size[0], c.out_channels, c.stride[0]) for c in convolutions]


def table_parameters() -> int:
    """Weights of each convolution, two per channel for each GroupNorm, a bias if there is no norm."""
    total, c_in = 0, 3
    for kernel, channels, _ in EXTRACTOR_ROWS:
        total += kernel * kernel * c_in * channels + 2 * channels
        c_in = channels
    for outputs in (2, 4):
        total += 2 * 2 * 512 * 512 + 2 * 512
        total += 512 * outputs + outputs
    return total


@pytest.fixture(scope="module")
def paper() -> LSNet:
    torch.manual_seed(0)
    return LSNet(PRESETS["paper"]).eval()


def test_paper_has_the_rows_of_the_table(paper: LSNet) -> None:
    assert rows_of(paper.extractor) == EXTRACTOR_ROWS
    assert rows_of(paper.classifier) == HEAD_ROWS["classifier"]
    assert rows_of(paper.regressor) == HEAD_ROWS["regressor"]


def test_paper_pads_the_extractor_only_and_normalises_before_activations(paper: LSNet) -> None:
    convolutions = [m for m in paper.modules() if isinstance(m, nn.Conv2d)]
    padded = {(c.kernel_size[0], c.padding[0]) for c in convolutions if not isinstance(c, EndPadded)}
    assert padded == {(3, 1), (2, 0), (1, 0)}
    kinds = [type(m) for m in paper.extractor.modules() if not list(m.children())]
    assert kinds == [nn.Conv2d, nn.GroupNorm, nn.ReLU] * 11 + [EndPadded, nn.GroupNorm, nn.ReLU]
    assert not any(isinstance(m, nn.MaxPool2d) for m in paper.modules())


def test_paper_has_as_many_parameters_as_the_table(paper: LSNet) -> None:
    assert sum(p.numel() for p in paper.parameters()) == table_parameters() == 9_924_934


def test_paper_preset_has_31_by_31_cells_at_512() -> None:
    with torch.device("meta"):  # shapes without the arithmetic
        output = LSNet(PRESETS["paper"])(torch.zeros(1, 3, 512, 512))
    assert output.logits.shape == (1, 2, 31, 31)
    assert output.endpoints.shape == (1, 4, 31, 31)
    assert output.scores.shape == (1, 31, 31)


def test_fast_preset_is_small_with_the_same_map_size() -> None:
    with torch.device("meta"):
        net = LSNet(PRESETS["fast"])
        output = net(torch.zeros(2, 3, 512, 512))
    assert output.logits.shape == (2, 2, 31, 31)
    assert output.endpoints.shape == (2, 4, 31, 31)
    assert sum(p.numel() for p in net.parameters()) < 1_000_000
    assert rows_of(net.extractor)[0] == (3, 16, 2)


@pytest.mark.parametrize("config", [PRESETS["paper"], PRESETS["fast"], TINY])
@pytest.mark.parametrize(("height", "width"), [(32, 32), (48, 160), (272, 304)])
def test_any_multiple_of_16_gives_its_map(config: LSNetConfig, height: int, width: int) -> None:
    with torch.device("meta"):
        output = LSNet(config).eval()(torch.zeros(1, 3, height, width))
    assert output.logits.shape[2:] == (height // 16 - 1, width // 16 - 1)


@pytest.mark.parametrize("preset", ["tiny", "paper"])
def test_batch_equals_single_images(preset: str, paper: LSNet) -> None:
    net = paper if preset == "paper" else tiny_net()
    images = torch.rand(3, 3, 48, 64)
    with torch.no_grad():
        batch, singles = net(images), [net(image[None]) for image in images]
    for i, single in enumerate(singles):
        torch.testing.assert_close(batch.logits[i : i + 1], single.logits, atol=1e-4, rtol=1e-4)
        torch.testing.assert_close(batch.endpoints[i : i + 1], single.endpoints, atol=1e-4, rtol=1e-4)


def test_group_norm_does_not_see_the_batch_even_in_training(paper: LSNet) -> None:
    images = torch.rand(2, 3, 32, 32)
    paper.train()
    try:
        with torch.no_grad():
            batch, single = paper(images), paper(images[:1])
    finally:
        paper.eval()
    torch.testing.assert_close(batch.logits[:1], single.logits, atol=1e-4, rtol=1e-4)


def test_scores_are_the_softmax_of_having_a_segment() -> None:
    net, image = tiny_net(), torch.rand(1, 3, 32, 48)
    with torch.no_grad():
        output = net(image)
    expected = 1 / (1 + torch.exp(output.logits[:, 0] - output.logits[:, 1]))
    torch.testing.assert_close(output.scores, expected)


def test_pixels_are_normalised_inside_the_network() -> None:
    """A grey image of the mean is zero to the first convolution."""
    net, seen = tiny_net(), []
    net.extractor.register_forward_pre_hook(lambda _module, inputs: seen.append(inputs[0]))
    with torch.no_grad():
        net(torch.full((1, 3, 32, 32), TINY.pixel_mean))
        net(torch.ones(1, 3, 32, 32))
    assert not seen[0].any()
    white = (1 - TINY.pixel_mean) / TINY.pixel_std
    assert torch.allclose(seen[1], torch.full_like(seen[1], white), rtol=1e-6)


@pytest.mark.parametrize("config", [TINY, PRESETS["fast"]])
def test_folding_norms_keeps_the_output(config: LSNetConfig) -> None:
    net = tiny_net(config=config)
    folded, images = fold_norms(net), torch.rand(2, 3, 64, 64)
    assert not any(isinstance(m, nn.BatchNorm2d) for m in folded.modules())
    assert any(isinstance(m, nn.BatchNorm2d) for m in net.modules())
    with torch.no_grad():
        ours, theirs = net(images), folded(images)
    torch.testing.assert_close(ours.scores, theirs.scores, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(ours.endpoints, theirs.endpoints, atol=1e-3, rtol=1e-3)


def test_group_norms_stay_when_folding() -> None:
    config = LSNetConfig(stage_channels=(16, 16, 16, 16), head_channels=16, norm="group")
    net = LSNet(config).eval()
    image = torch.rand(1, 3, 32, 32)
    with torch.no_grad():
        torch.testing.assert_close(net(image).logits, fold_norms(net)(image).logits)


def receptive_centre(config: LSNetConfig) -> tuple[float, float]:
    """Centre (x, y) of the pixels that change a cell, relative to the centre of the cell, px."""
    net = LSNet(config).eval()
    with torch.no_grad():
        for module in net.modules():
            if isinstance(module, nn.Conv2d):
                module.weight.fill_(1 / module.weight[0].numel())  # nothing cancels, no ReLU is off
    image = torch.ones(1, 3, 512, 512, requires_grad=True)
    net(image).logits[0, 1, 15, 14].backward()
    rows, columns = image.grad[0].sum(0).nonzero().T
    spans = ((columns.min() + columns.max() + 1) / 2, (rows.min() + rows.max() + 1) / 2)
    return float(spans[0]) - (14 * 16 + 16), float(spans[1]) - (15 * 16 + 16)


THIN = LSNetConfig(stage_channels=(1, 1, 1, 1), head_channels=1, norm="batch")


@pytest.mark.parametrize("config", [THIN, TINY])
def test_receptive_fields_are_centred_if_asked_for(config: LSNetConfig) -> None:
    assert receptive_centre(config) == (-7.5, -7.5)
    assert receptive_centre(replace(config, centred=True)) == (0.5, 0.5)


def test_pooling_halves_after_a_convolution_of_stride_one() -> None:
    """LS-Net-P: as many parameters and cells, no strides."""
    nets = [LSNet(replace(THIN, downsample=how)) for how in ("last", "pool")]
    assert len({sum(p.numel() for p in net.parameters()) for net in nets}) == 1
    assert [stride for _, _, stride in rows_of(nets[1].extractor)] == [1] * 12
    assert sum(isinstance(m, nn.MaxPool2d) for m in nets[1].extractor) == 4
    assert nets[1].eval()(torch.zeros(1, 3, 64, 96)).logits.shape == (1, 2, 3, 5)


def test_unknown_downsampling_is_refused() -> None:
    with pytest.raises(ValueError, match="unknown norm or downsampling"):
        replace(THIN, downsample="mean")
