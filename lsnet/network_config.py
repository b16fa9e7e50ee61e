"""Parameters of networks, and the presets; without torch, whose import takes seconds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

MAX_VALUES = 136 << 20  # into and out of the largest layer, 3 to 9 bytes each: 0.4 to 1.2 GiB
HALVINGS = 4  # from pixels to positions of the interleaved grids, 16 px apart


@dataclass(frozen=True, slots=True)
class LSNetConfig:
    """Parameters of one network. Raises ValueError when they are out of range."""

    stage_channels: tuple[int, ...]  # channels per stage; each stage halves the image once
    head_channels: int  # channels of the transformation layers of both heads
    norm: Literal["group", "batch"]  # group as in the paper; batch folds into the convolutions
    stem_channels: int | None = (
        None  # of a stride-2 convolution before the stages; None, as in the paper, for no stem
    )
    # How a stage halves the image: a stride of its first or last convolution, or pooling after it (LS-Net-P).
    downsample: Literal["first", "last", "pool"] = "last"
    context_blocks: int = 0  # residual blocks of dilation 2, 4, 8 ... after the last stage
    residual: bool = False  # skip connections around the last two convolutions of a stage
    stage_blocks: int = 1  # such pairs of convolutions per stage, with `residual`
    plain_stages: int = 0  # first stages that have no such pairs
    shared_head: bool = False  # one transformation layer for both heads; in the paper each has its own
    centred: bool = False  # put receptive fields on the centres of the cells: see `EndPadded`
    pixel_mean: float = 0.5  # of images in [0, 1]
    pixel_std: float = 0.25

    def __post_init__(self) -> None:
        channels = (*self.stage_channels, self.head_channels, self.stem_channels or 1)
        if not all(isinstance(c, int) and 0 < c <= 4096 for c in channels):
            raise ValueError("channels must be whole numbers from 1 to 4096")
        if len(self.stage_channels) + (self.stem_channels is not None) != HALVINGS:
            raise ValueError(f"stem and stages must halve the image {HALVINGS} times")
        if not (0 <= self.context_blocks <= 8 and 1 <= self.stage_blocks <= 8):
            raise ValueError("too many or too few blocks")
        if not 0 <= self.plain_stages <= len(self.stage_channels) * self.residual:
            raise ValueError("only stages with residual blocks can be without them")
        if self.norm not in {"group", "batch"} or self.downsample not in {
            "first",
            "last",
            "pool",
        }:
            raise ValueError("unknown norm or downsampling")

    @property
    def pixels_at_once(self) -> int:
        """How many pixels run at once, in one image or several: 17.8 million for the preset `fast`."""
        first = 1 if self.downsample == "first" else 0  # halvings before the convolutions of the first stage
        stem = [self.stem_channels] if self.stem_channels else []
        levels = enumerate([*stem, *self.stage_channels], first)
        return int(MAX_VALUES / max(2 * channels / 4**level for level, channels in levels))


PRESETS = {
    "paper": LSNetConfig(stage_channels=(64, 128, 256, 512), head_channels=512, norm="group", centred=True),
    "fast": LSNetConfig(
        stem_channels=16,
        stage_channels=(32, 48, 96),
        head_channels=96,
        norm="batch",
        downsample="first",
        context_blocks=1,
        residual=True,
    ),
}
