"""LS-Net (Nguyen, Jenssen and Roverso, Section III-B, Table I), bottom-up.

A feature extractor reduces an image to maps of 1/16 its size; the classifier and the regressor turn each
2 x 2 neighbourhood of them into one cell of the four interleaved grids (`lsnet.grid`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

if TYPE_CHECKING:
    from lsnet.network_config import LSNetConfig

GROUP_SIZE = 16  # channels per group of GroupNorm; the paper leaves it open


class EndPadded(nn.Conv2d):
    """A convolution of stride 2 that pads below and to the right only.

    Padded on all sides, output i is centred on input 2 i, half an input pixel before the middle of the pair
    that it replaces. After four such convolutions the receptive field of a cell is centred 7.5 px before the
    cell's centre. Moving the last by one of its input pixels, which are 8 px apart, leaves 0.5 px.
    """

    def forward(self, x: Tensor) -> Tensor:
        """Map (N, C, H, W) to half the height and width."""
        return super().forward(F.pad(x, (0, 1, 0, 1)))


class ConvNormAct(nn.Sequential):
    """Convolution, normalisation, ReLU ("we adopt Group Normalization before activations")."""

    def __init__(
        self,
        c_in: int,
        c_out: int,
        norm: str,
        *,
        kernel: int = 3,
        stride: int = 1,
        dilation: int = 1,
        end_padded: bool = False,
    ) -> None:
        is_padded = kernel == 3 and not end_padded  # no padding in the heads
        convolution = EndPadded if end_padded else nn.Conv2d
        super().__init__(
            convolution(c_in, c_out, kernel, stride, dilation if is_padded else 0, dilation, bias=False),
            nn.GroupNorm(max(1, c_out // GROUP_SIZE), c_out) if norm == "group" else nn.BatchNorm2d(c_out),
            nn.ReLU(inplace=True),
        )


class Residual(nn.Module):
    """Two convolutions with a skip connection: x + f(x)."""

    def __init__(self, channels: int, norm: str, dilation: int = 1) -> None:
        super().__init__()
        self.body = nn.Sequential(
            ConvNormAct(channels, channels, norm, dilation=dilation),
            ConvNormAct(channels, channels, norm, dilation=dilation),
        )

    def forward(self, x: Tensor) -> Tensor:
        """Map (N, C, H, W) to the same shape."""
        out: Tensor = x + self.body(x)
        return out


class FeatureExtractor(nn.Sequential):
    """VGG-16 up to its last pooling, with strides for pooling: (N, 3, H, W) to (N, C, H/16, W/16)."""

    def __init__(self, config: LSNetConfig) -> None:
        layers: list[nn.Module] = []
        c_in = 3
        if config.stem_channels:
            layers.append(ConvNormAct(c_in, config.stem_channels, config.norm, stride=2))
            c_in = config.stem_channels
        for i, c_out in enumerate(config.stage_channels, 1):
            end_padded = config.centred and i == len(config.stage_channels)
            layers += self._stage(
                c_in, c_out, config, end_padded=end_padded, is_plain=i <= config.plain_stages
            )
            c_in = c_out
        layers += [Residual(c_in, config.norm, dilation=2 << i) for i in range(config.context_blocks)]
        super().__init__(*layers)

    @staticmethod
    def _stage(
        c_in: int, c_out: int, config: LSNetConfig, *, end_padded: bool, is_plain: bool
    ) -> list[nn.Module]:
        norm, blocks = config.norm, 0 if is_plain else config.stage_blocks
        if config.downsample == "first":
            first = ConvNormAct(c_in, c_out, norm, stride=2, end_padded=end_padded)
            if config.residual:
                return [first, *(Residual(c_out, norm) for _ in range(blocks))]
            return [first, ConvNormAct(c_out, c_out, norm), ConvNormAct(c_out, c_out, norm)]
        pair = [ConvNormAct(c_in, c_out, norm), ConvNormAct(c_out, c_out, norm)]
        if config.downsample == "pool":
            return [*pair, ConvNormAct(c_out, c_out, norm), nn.MaxPool2d(2)]
        return [*pair, ConvNormAct(c_out, c_out, norm, stride=2, end_padded=end_padded)]


class Head(nn.Sequential):
    """A 2 x 2 convolution to the four grids, then 1 x 1: (N, C, R + 1, S + 1) to (N, K, R, S).

    Without the first where both heads share it. `biases` (K,) are those that the outputs start with.
    """

    def __init__(self, c_in: int, config: LSNetConfig, biases: tuple[float, ...]) -> None:
        final = nn.Conv2d(config.head_channels, len(biases), 1)
        final.bias = nn.Parameter(torch.tensor(biases))
        own = [] if config.shared_head else [transformation(c_in, config)]
        super().__init__(*own, final)


def transformation(c_in: int, config: LSNetConfig) -> ConvNormAct:
    """Return the layer from the features to the cells of the four grids."""
    return ConvNormAct(c_in, config.head_channels, config.norm, kernel=2)


class Classifier(Head):
    """Two logits per cell: without and with a line segment."""

    def __init__(self, c_in: int, config: LSNetConfig) -> None:
        super().__init__(
            c_in, config, biases=(1.0, -1.0)
        )  # near the share of cells with lines, as in RetinaNet


class Regressor(Head):
    """Endpoints of the longest segment per cell: x1 y1 x2 y2 in cell fractions."""

    def __init__(self, c_in: int, config: LSNetConfig) -> None:
        super().__init__(c_in, config, biases=(0.5,) * 4)


class RawOutput(NamedTuple):
    """Output of the network for a batch, before any threshold."""

    logits: Tensor  # (N, 2, R, C)
    endpoints: Tensor  # (N, 4, R, C) in cell fractions

    @property
    def scores(self) -> Tensor:
        """(N, R, C) probabilities that the cells hold a segment."""
        return self.logits.softmax(dim=1)[:, 1]


class LSNet(nn.Module):
    """The network: images (N, 3, H, W) in [0, 1], H and W multiples of 16, to `RawOutput`."""

    def __init__(self, config: LSNetConfig) -> None:
        super().__init__()
        self.config = config
        features = config.stage_channels[-1]
        self.extractor = FeatureExtractor(config)
        self.shared = transformation(features, config) if config.shared_head else nn.Identity()
        self.classifier = Classifier(features, config)
        self.regressor = Regressor(features, config)
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
        for head in (self.classifier, self.regressor):
            nn.init.normal_(head[-1].weight, std=0.01)  # type: ignore[arg-type]

    def forward(self, images: Tensor) -> RawOutput:
        """Run a batch; the results equal those of its images one by one."""
        x = (images - self.config.pixel_mean) / self.config.pixel_std
        return self.run(x.to(self.dtype))

    def run(self, pixels: Tensor) -> RawOutput:
        """Run a batch of normalised pixels."""
        features = self.shared(self.extractor(pixels))
        return RawOutput(self.classifier(features), self.regressor(features))

    @property
    def dtype(self) -> torch.dtype:
        """Type of the weights."""
        weight = self.classifier[-1].weight
        assert isinstance(weight, Tensor)  # noqa: S101
        return weight.dtype
