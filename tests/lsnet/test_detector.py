"""The detector on tiny networks with random weights, and on a backend without a network."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch
from nets import TINY, openvino_or_skip, photo, save_tiny, tiny_net

from lsnet import Detector, LSNetError
from lsnet.files import write_png
from lsnet.runtime.openvino import OpenVinoBackend
from lsnet.runtime.torch import TorchBackend
from lsnet.weights import Weights
from lsnet.weights_file import WeightsCard

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from lsnet.arrays import Maps
    from lsnet.runtime.backend import Backend


@pytest.fixture(scope="module")
def openvino_backend() -> Backend:
    openvino_or_skip()
    return OpenVinoBackend.convert(tiny_net())


@dataclass
class DarkColumns:
    """A backend without a network: reports a vertical line at the centroid of the dark columns of each cell.

    takes_cut: Also in cells whose first or last column is dark, which may hold only a part of a cable.
    """

    takes_cut: bool = False
    name, precision, threads, n_calls, n_images = "fake", "f32", 1, 1, 1

    def run(self, images: Sequence[NDArray[np.uint8]]) -> list[Maps]:
        return [self._run_one(image) for image in images]

    def _run_one(self, image: NDArray[np.uint8]) -> Maps:
        rows, columns = image.shape[0] // 16 - 1, image.shape[1] // 16 - 1
        scores, endpoints = np.zeros((rows, columns), np.float32), np.zeros((rows, columns, 4), np.float32)
        for r, c in np.ndindex(rows, columns):
            cell = image[r * 16 : r * 16 + 32, c * 16 : c * 16 + 32, 0]
            darkness = np.clip(190.0 - cell.mean(axis=0), 0, None)
            if darkness.sum() > 40 and (self.takes_cut or not darkness[[0, -1]].any()):
                x = (darkness * (np.arange(32) + 0.5)).sum() / darkness.sum() / 32
                scores[r, c], endpoints[r, c] = 0.9, (x, 0, x, 1)
        return scores, endpoints


def detector(backend: object, scale: float = 1.0, min_score: float = 0.5) -> Detector:
    card = WeightsCard("tiny", "fast", TINY, min_score)
    return Detector(Weights(tiny_net(), card, "00"), backend, scale, min_score)


def vertical_cable(x_px: float, height: int, width: int, thickness_px: int = 9) -> NDArray[np.uint8]:
    """Darken each pixel by the share that the cable covers; the centre of column j is at j + 0.5."""
    distance = np.abs(np.arange(width) + 0.5 - x_px)
    coverage = np.clip(thickness_px / 2 + 0.5 - distance, 0, 1)
    row = np.round(200 - 180 * coverage).astype(np.uint8)
    return np.repeat(np.repeat(row[None, :, None], height, 0), 3, 2)


@pytest.mark.parametrize("scale", [0.5, 0.75, 1.0, 1.7])
@pytest.mark.parametrize("size", [(200, 300), (203, 311), (97, 500)])
def test_the_scale_is_undone_within_half_a_pixel(scale: float, size: tuple[int, int]) -> None:
    height, width = size
    for x in (40.5, 151.5, 247.0):
        found = detector(DarkColumns(), scale).detect([vertical_cable(x, height, width)])[0].segments
        assert len(found)
        np.testing.assert_allclose(found.endpoints[:, [0, 2]], x, atol=0.2)
        assert found.image_size == size


def test_segments_in_the_padding_are_clipped() -> None:
    """An image of 200 x 300 is run at 208 x 304: no segment may extend beyond it."""
    net_says = DarkColumns(takes_cut=True)
    image = vertical_cable(297.5, 200, 300, thickness_px=5)
    segments = detector(net_says).detect([image])[0].segments
    assert len(segments)
    assert segments.endpoints[:, [0, 2]].max() <= 300
    assert segments.endpoints[:, [1, 3]].max() == 200
    dark_edge = np.full((200, 300, 3), 200, np.uint8)
    dark_edge[:, -1] = 0  # repeated into the padding: its centroid lies there
    assert len(detector(net_says).detect([dark_edge])[0].segments) == 0


@pytest.mark.parametrize("size", [(1, 1), (5, 40), (31, 33), (16, 2000)])
def test_images_of_any_size_are_detected_in(size: tuple[int, int]) -> None:
    found = detector(TorchBackend(tiny_net()), min_score=0.0).detect([photo(*size)])[0]
    assert found.segments.image_size == found.lines.image_size == size
    assert np.isfinite(found.segments.endpoints).all()
    assert (found.segments.endpoints >= 0).all()
    assert (found.segments.endpoints <= np.tile(size[::-1], 2)).all()


def test_detector_batch_equals_single_images(openvino_backend: Backend) -> None:
    images = [photo(100, 130), photo(64, 64), photo(40, 1100), photo(100, 130)]
    used = detector(openvino_backend, min_score=0.3)
    for together, image in zip(used.detect(images), images, strict=True):
        alone = used.detect([image])[0]
        assert len(together.segments) == len(alone.segments) > 0
        np.testing.assert_allclose(together.segments.endpoints, alone.segments.endpoints, atol=1e-3)
        np.testing.assert_allclose(together.segments.scores, alone.segments.scores, atol=1e-5)
    assert used.detect([]) == []


def test_threshold_only_removes_segments() -> None:
    backend, image = TorchBackend(tiny_net()), photo(96, 96)
    counts = []
    for min_score in (0.0, 0.3, 0.5, 0.7, 1.0):
        segments = detector(backend, min_score=min_score).detect([image])[0].segments
        assert (segments.scores >= min_score).all()
        counts.append(len(segments))
    assert all(more >= fewer for more, fewer in pairwise(counts))
    assert counts[0] > counts[2]


def test_torch_and_openvino_report_the_same_segments(openvino_backend: Backend) -> None:
    image = photo(90, 150)
    ours, theirs = (
        detector(backend, min_score=0.0).detect([image])[0].segments
        for backend in (TorchBackend(tiny_net()), openvino_backend)
    )
    np.testing.assert_allclose(ours.endpoints, theirs.endpoints, atol=0.01)
    np.testing.assert_allclose(ours.scores, theirs.scores, atol=1e-4)


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((40, 40), np.uint8),
        np.zeros((40, 40, 4), np.uint8),
        np.zeros((40, 40, 3), np.float32),
        np.zeros((1, 40, 40, 3), np.uint8),
        np.zeros((0, 40, 3), np.uint8),
        torch.zeros(40, 40, 3, dtype=torch.uint8),
        None,
        b"JPEG",
    ],
    ids=["grey", "alpha", "float", "batch", "empty", "tensor", "none", "bytes"],
)
def test_images_of_another_type_or_shape_are_refused(image: object) -> None:
    used = detector(TorchBackend(tiny_net()))
    with pytest.raises(LSNetError, match=r"must be uint8 arrays \(height, width, 3\)|is not an image"):
        used.detect([image])
    if isinstance(image, np.ndarray) and image.ndim < 4:
        with pytest.raises(LSNetError, match="images must be uint8 arrays"):
            used.detect(image)


def test_paths_single_images_and_stacks_are_accepted(tmp_path: Path) -> None:
    image = photo(40, 64)
    write_png(tmp_path / "x.png", image)
    used = detector(TorchBackend(tiny_net()), min_score=0.0)
    (expected,) = used.detect([image])
    path = tmp_path / "x.png"
    bgr = np.ascontiguousarray(image[..., ::-1])
    for found in (
        used.detect(str(path)),
        used.detect(path),
        used.detect([path, str(path)])[1:],
        used.detect(image),
        used.detect(np.stack([image, image]))[1:],
        used.detect(bgr, color="bgr"),
        used.detect(path, color="bgr"),  # of arrays only
    ):
        (one,) = found
        np.testing.assert_array_equal(one.segments.endpoints, expected.segments.endpoints)
        np.testing.assert_array_equal(one.segments.scores, expected.segments.scores)
    assert not np.array_equal(used.detect(bgr)[0].segments.scores, expected.segments.scores)
    with pytest.raises(LSNetError, match=r"none\.jpg: cannot be read as an image"):
        used.detect("none.jpg")
    with pytest.raises(LSNetError, match="no color order 'rgba'; choose rgb or bgr"):
        used.detect(image, color="rgba")


def test_detector_uses_the_defaults_of_its_weights(tmp_path: Path) -> None:
    path = save_tiny(tmp_path / "w.safetensors", scale=1.5, min_score=0.3)
    used = Detector.load(path, runtime="torch")
    assert (used.scale, used.min_score) == (1.5, 0.3)
    result = used.describe()
    assert result["weights"] == "tiny"
    assert result["preset"] == "fast"
    assert (result["backend"], result["precision"]) == ("torch", "f32")
    assert len(str(result["weights_sha256"])) == 64
    other = Detector.load(path, runtime="torch", scale=0.5, min_score=0.0)
    assert (other.scale, other.min_score) == (0.5, 0.0)


@pytest.mark.parametrize(
    ("size", "scale"), [((96, 130), 4), ((140, 128), 3), ((192, 400), 2), ((193, 200), 1), ((400, 500), 1)]
)
def test_small_images_are_enlarged_unless_a_scale_is_asked_for(
    tmp_path: Path, size: tuple[int, int], scale: int
) -> None:
    path, image = save_tiny(tmp_path / "w.safetensors"), photo(*size)
    auto, result = (Detector.load(path, runtime="torch", scale=s, min_score=0.0) for s in (None, scale))
    ours, theirs = (detector.detect([image])[0].segments for detector in (auto, result))
    np.testing.assert_array_equal(ours.endpoints, theirs.endpoints)
    assert ours.image_size == size
    assert (auto.describe()["scale"], result.describe()["scale"]) == ("auto", scale)


@pytest.mark.parametrize(
    "options",
    [{"scale": 0.0}, {"scale": 4.1}, {"scale": float("nan")}, {"min_score": -0.1}, {"min_score": 1.1}],
)
def test_numbers_out_of_range_are_one_line(tmp_path: Path, options: dict[str, float]) -> None:
    path = save_tiny(tmp_path / "w.safetensors")
    with pytest.raises(LSNetError, match="out of range; give"):
        Detector.load(path, runtime="torch", **options)


def test_unknown_weights_are_one_line() -> None:
    with pytest.raises(LSNetError, match="no such weights"):
        Detector.load("nonesuch")
