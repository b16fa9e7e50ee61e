"""Prune a trained network to a narrower one: the least important channels are dropped.

Training it further takes a fraction of the steps of a training from scratch. The importance of a channel is
computed from the weights alone, after Li et al., "Pruning Filters for Efficient ConvNets": the scale of its
normalisation times the weights that read it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from lsnet.model import ConvNormAct, LSNet

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from lsnet.network_config import LSNetConfig


def slim(wide: LSNet, config: LSNetConfig) -> LSNet:
    """Return a network of `config` with the most important channels of `wide`.

    The residual blocks of a stage share its channels, so these are chosen once per stage.

    Raises:
        ValueError: The networks differ in more than their widths, `config` is the wider one, or they have no
            batch normalisation and residual blocks.
    """
    if wide.config == config:
        return wide
    _check(wide.config, config)
    narrow = LSNet(config)
    wide_trunks, narrow_trunks = _trunks(wide), _trunks(narrow)
    heads: list[tuple[Any, Any]] = [(wide.classifier, narrow.classifier), (wide.regressor, narrow.regressor)]
    transformations: list[Any] = [wide.shared] if wide.config.shared_head else [head[0] for head, _ in heads]
    kept_in = torch.arange(3)
    for i, (trunk, slimmed) in enumerate(zip(wide_trunks, narrow_trunks, strict=True)):
        readers = [trunk_of[0] for trunk_of in wide_trunks[i + 1 : i + 2]] or transformations
        kept_in = _slim_trunk(trunk, slimmed, kept_in, readers)
    if not config.shared_head:
        for head, slimmed_head in heads:
            _slim_head(head, slimmed_head, kept_in)
    elif wide.config.shared_head:
        kept = _strongest([wide.shared], [head[-1] for head, _ in heads], config.head_channels)
        _copy(wide.shared, narrow.shared, kept, kept_in)
        for head, slimmed_head in heads:
            _copy_outputs(head, slimmed_head, kept)
    else:
        _share(heads, narrow.shared, kept_in)
    return narrow


def _check(wide: LSNetConfig, config: LSNetConfig) -> None:
    widths = [(c.stem_channels or 0, *c.stage_channels, c.head_channels) for c in (wide, config)]
    same = replace(
        wide,
        stem_channels=config.stem_channels,
        stage_channels=config.stage_channels,
        head_channels=config.head_channels,
        plain_stages=max(config.plain_stages, wide.plain_stages),
        shared_head=config.shared_head or wide.shared_head,
        centred=config.centred,
    )
    if config.shared_head and not wide.shared_head:
        widths[0] = (*widths[0][:-1], 2 * wide.head_channels)
    is_narrower = len(widths[0]) == len(widths[1]) and all(n <= w for w, n in zip(*widths, strict=True))
    if same != config or not is_narrower or not wide.residual or wide.norm != "batch":
        raise ValueError(
            "the networks differ in more than widths and layers left out, or the new one is wider"
        )


def _trunks(net: LSNet) -> list[list[Any]]:
    """Group the layers: a convolution and the residual blocks that add to its output."""
    trunks: list[list[Any]] = []
    for layer in net.extractor:
        if isinstance(layer, ConvNormAct):
            trunks.append([])
        trunks[-1].append(layer)
    return trunks


def _slim_trunk(wide: Sequence[Any], narrow: Sequence[Any], kept_in: Tensor, readers: list[Any]) -> Tensor:
    """Copy the channels kept of a trunk, and return their numbers."""
    blocks: list[Any] = list(wide[1:])
    width = narrow[0][0].out_channels
    kept = _strongest(
        [wide[0], *(block.body[1] for block in blocks)], [*(b.body[0] for b in blocks), *readers], width
    )
    _copy(wide[0], narrow[0], kept, kept_in)
    for block, slimmed in zip(blocks, narrow[1:], strict=False):  # none in a plain stage
        inner = _strongest([block.body[0]], [block.body[1]], width)
        _copy(block.body[0], slimmed.body[0], inner, kept)
        _copy(block.body[1], slimmed.body[1], kept, inner)
    return kept


def _slim_head(wide: Any, narrow: Any, kept_in: Tensor) -> None:
    kept = _strongest([wide[0]], [wide[1]], narrow[1].in_channels)
    _copy(wide[0], narrow[0], kept, kept_in)
    _copy_outputs(wide, narrow, kept)


def _copy_outputs(wide: Any, narrow: Any, kept: Tensor) -> None:
    """Copy the last layer of a head, which reads the channels kept."""
    with torch.no_grad():
        narrow[-1].weight.copy_(wide[-1].weight[:, kept])
        narrow[-1].bias.copy_(wide[-1].bias)


def _share(heads: Iterable[tuple[Any, Any]], shared: Any, kept_in: Tensor) -> None:
    """Fill a shared transformation with channels of both heads; at first each reads its own half only."""
    half = shared[1].num_features // 2
    for k, (head, narrow) in enumerate(heads):
        rows = torch.arange(half) + k * half
        kept = _strongest([head[0]], [head[1]], half)
        with torch.no_grad():
            shared[0].weight[rows] = head[0][0].weight[kept][:, kept_in]
            for name, values in shared[1].state_dict().items():
                theirs = head[0][1].state_dict()[name]
                if values.ndim:
                    values[rows] = theirs[kept]
            narrow[-1].weight.zero_()
            narrow[-1].weight[:, rows] = head[1].weight[:, kept]
            narrow[-1].bias.copy_(head[1].bias)


def _strongest(drivers: Iterable[Any], readers: Iterable[Any], count: int) -> Tensor:
    """The `count` most important channels, in order."""
    driven = torch.stack([layer[1].weight.square() for layer in drivers]).sum(0)
    convolutions = [layer if isinstance(layer, nn.Conv2d) else layer[0] for layer in readers]
    read = torch.stack([conv.weight.square().sum((0, 2, 3)) for conv in convolutions]).sum(0)
    return (driven * read).topk(count).indices.sort().values


def _copy(wide: Any, narrow: Any, out: Tensor, into: Tensor) -> None:
    """Copy output channels `out` and input channels `into` of a convolution and its normalisation."""
    with torch.no_grad():
        narrow[0].weight.copy_(wide[0].weight[out][:, into])
        values = wide[1].state_dict()
        for name, kept in narrow[1].state_dict().items():
            kept.copy_(values[name][out] if values[name].ndim else values[name])
