"""Backends, tiles and the detector on tiny networks with random weights."""

from __future__ import annotations

import importlib
import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from nets import TINY, openvino_or_skip, save_tiny, tiny_net

from lsnet import Detector, LSNetError, load_weights, tiles
from lsnet.files import write_png
from lsnet.model import PRESETS
from lsnet.runtime import InferenceModule, OpenVinoBackend, TorchBackend, open_backend
from lsnet.weights import Weights, WeightsCard

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from lsnet.arrays import Maps
    from lsnet.model import LSNet
    from lsnet.runtime import Backend

TOLERANCE = 1e-4  # of scores and of cell fractions, against torch in fp32
RNG = np.random.default_rng(0)


def photo(height: int, width: int) -> NDArray[np.uint8]:
    return RNG.integers(0, 256, (height, width, 3), dtype=np.uint8)


def plain_torch(net: LSNet, image: NDArray[np.uint8]) -> Maps:
    """The network as it was trained: fp32, norms not folded, one image."""
    with torch.no_grad():
        output = net(torch.from_numpy(image.transpose(2, 0, 1).copy())[None].float() / 255)
    return output.scores[0].numpy(), output.endpoints[0].permute(1, 2, 0).numpy()


def assert_close(found: Sequence[Maps], expected: Sequence[Maps], tolerance: float = TOLERANCE) -> None:
    for ours, theirs in zip(found, expected, strict=True):
        for a, b in zip(ours, theirs, strict=True):
            assert a.dtype == np.float32
            np.testing.assert_allclose(a, b, atol=tolerance, rtol=0)


@pytest.fixture(scope="module")
def openvino_backend() -> Backend:
    openvino_or_skip()
    return OpenVinoBackend(tiny_net())


@pytest.fixture(params=["torch", "openvino"])
def backend(request: pytest.FixtureRequest) -> Backend:
    if request.param == "torch":
        return TorchBackend(tiny_net())
    found: Backend = request.getfixturevalue("openvino_backend")
    return found


def test_backends_agree_with_plain_torch_whatever_the_sizes(backend: Backend) -> None:
    """More sizes in one batch than compiled networks are kept."""
    images = [photo(height, 64) for height in (64, 32, 48, 64, 80, 96)]
    assert_close(backend.run(images), [plain_torch(tiny_net(), image) for image in images])


def test_a_batch_equals_its_singles(backend: Backend) -> None:
    images = [photo(64, 64) for _ in range(5)]
    assert_close(backend.run(images), [backend.run([image])[0] for image in images], tolerance=1e-6)
    assert backend.run([]) == []


def test_windows_of_a_larger_frame_are_taken_as_they_are(backend: Backend) -> None:
    frame = photo(96, 96)
    window = frame[16:80, 32:96]
    assert not window.flags.c_contiguous
    assert_close(backend.run([window]), [plain_torch(tiny_net(), window)])


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["fast", "paper"])
def test_openvino_agrees_with_torch_on_whole_presets(preset: str) -> None:
    openvino_or_skip()
    net, images = tiny_net(config=PRESETS[preset]), [photo(256, 320), photo(512, 512)]
    assert_close(OpenVinoBackend(net).run(images), [plain_torch(net, i) for i in images], tolerance=1e-3)


@pytest.mark.slow
def test_a_quantised_network_says_nearly_the_same(capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("nncf")
    net, image = (
        load_weights("fast").net,
        cv2.imread(str(Path(__file__).parents[2] / "docs/images/renders.jpg")),
    )
    image = np.ascontiguousarray(image[:256, :512])
    (expected,) = TorchBackend(net).run([image])
    found = [OpenVinoBackend(net, "int8").run([image])[0] for _ in range(2)]
    np.testing.assert_array_equal(found[0][0], found[1][0])  # the same network each time
    assert capfd.readouterr().out == ""
    assert np.abs(found[0][0] - expected[0]).mean() < 0.03
    sure = expected[0] > 0.7
    assert sure.sum() > 20
    assert (found[0][0][sure] > 0.5).mean() > 0.97
    assert np.median(np.abs(found[0][1] - expected[1])[sure]) < 0.03  # about a pixel
    assert (found[0][0] != expected[0]).any()


def test_nncf_that_is_not_installed_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    openvino_or_skip()
    monkeypatch.setattr("lsnet.quantization.find_spec", lambda _name: None)
    with pytest.raises(LSNetError, match=r"NNCF is not installed; pip install 'lsnet-pipe\[int8\]', or use"):
        open_backend(tiny_net(), "openvino-int8")


def test_runtimes_have_the_precision_in_their_name() -> None:
    ov = openvino_or_skip()
    has_bf16 = "BF16" in ov.Core().get_property("CPU", "OPTIMIZATION_CAPABILITIES")
    backends = {name: open_backend(tiny_net(), name) for name in ("openvino", "openvino-bf16", "auto")}
    assert {name: (backend.name, backend.precision) for name, backend in backends.items()} == {
        "openvino": ("openvino", "f32"),
        "openvino-bf16": ("openvino", "bf16"),
        "auto": ("openvino", "bf16" if has_bf16 else "f32"),
    }
    image = photo(64, 64)
    assert_close(
        backends["openvino-bf16"].run([image]),
        [plain_torch(tiny_net(), image)],
        tolerance=0.1,  # of random weights, through many layers of 8 bits of mantissa
    )


def test_openvino_tells_nobody_that_it_is_used(openvino_backend: Backend) -> None:
    """What its own package of telemetry would do at each import and conversion, in a process each."""
    assert sys.modules["openvino_telemetry"] is None
    with pytest.raises(ImportError):
        importlib.import_module("openvino_telemetry")


def test_conversion_to_openvino_does_not_warn(recwarn: pytest.WarningsRecorder) -> None:
    openvino_or_skip()
    OpenVinoBackend(tiny_net())
    assert [str(w.message) for w in recwarn] == []


def test_an_openvino_that_cannot_be_imported_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "openvino", None)
    monkeypatch.setattr("lsnet.runtime.find_spec", lambda _name: True)
    with pytest.raises(LSNetError, match=r"OpenVINO is not installed; pip install 'lsnet-pipe\[openvino\]'"):
        open_backend(tiny_net(), "openvino")


def test_runtimes_by_name() -> None:
    assert open_backend(tiny_net(), "torch").name == "torch"
    with pytest.raises(LSNetError, match="no runtime 'tensorrt'; choose one of auto, torch, openvino"):
        open_backend(tiny_net(), "tensorrt")


def test_openvino_that_is_not_installed_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lsnet.runtime.find_spec", lambda _name: None)
    assert open_backend(tiny_net(), "auto").name == "torch"
    for name in ("openvino", "openvino-bf16", "openvino-int8"):
        with pytest.raises(LSNetError, match=r"pip install 'lsnet-pipe\[openvino\]'"):
            open_backend(tiny_net(), name)


@settings(max_examples=60, deadline=None)
@given(st.integers(2, 400), st.integers(2, 160))
def test_every_position_is_taken_once_and_far_from_cuts(rows: int, columns: int) -> None:
    height, width = rows * 16, columns * 16
    taken = np.zeros((rows - 1, columns - 1), int)
    for tile in tiles.tiles_of(height, width):
        taken[tile.taken] += 1
        for window, own, inner, side in zip(
            tile.window, tile.taken, tile.inner(), (height, width), strict=True
        ):
            assert 0 <= window.start < window.stop <= side
            assert window.stop - window.start == min(side, tiles.TILE_PX)
            assert window.start % 16 == 0
            assert inner.start * 16 + window.start == own.start * 16
            assert inner.stop - inner.start == own.stop - own.start
            first_px, last_px = own.start * 16, (own.stop - 1) * 16 + 32
            assert window.start == 0 or first_px - window.start >= 128
            assert window.stop == side or window.stop - last_px >= 128
    assert (taken == 1).all()


@pytest.mark.parametrize("config", [TINY, PRESETS["fast"]], ids=["tiny", "fast"])
def test_tiles_equal_the_whole_frame(config: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiles, "TILE_PX", 448)
    run = InferenceModule(tiny_net(config=config)).eval()
    frame = torch.from_numpy(photo(32, 1008))[None]
    cut = tiles.tiles_of(32, 1008)
    assert len(cut) > 3
    with torch.inference_mode():
        whole = [part[0].numpy() for part in run(frame)]
        parts = [tuple(part[0].numpy() for part in run(frame[:, t.window[0], t.window[1]])) for t in cut]
    scores, endpoints = tiles.join(32, 1008, cut, parts)
    np.testing.assert_allclose(scores, whole[0], atol=1e-4)
    np.testing.assert_allclose(endpoints, whole[1], atol=1e-4)


@dataclass
class DarkColumns:
    """A backend that needs no weights: says in each cell with dark columns a vertical line at their centroid.

    takes_cut: also cells whose first or last column is dark, which may hold a part of a cable only.
    """

    takes_cut: bool = False
    name, precision, threads = "fake", "f32", 1

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
    """Each pixel as dark as the share of it that the cable covers; the centre of column j is j + 0.5."""
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


def test_what_lies_in_the_padding_is_cut_off() -> None:
    """A frame of 200 x 300 is run at 208 x 304: no segment may leave it, or lie beyond it."""
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
def test_frames_of_any_size_are_run(size: tuple[int, int]) -> None:
    found = detector(TorchBackend(tiny_net()), min_score=0.0).detect([photo(*size)])[0]
    assert found.segments.image_size == found.lines.image_size == size
    assert np.isfinite(found.segments.endpoints).all()
    assert (found.segments.endpoints >= 0).all()
    assert (found.segments.endpoints <= np.tile(size[::-1], 2)).all()


def test_a_detector_gives_a_batch_what_its_images_get(openvino_backend: Backend) -> None:
    images = [photo(100, 130), photo(64, 64), photo(40, 1100), photo(100, 130)]
    used = detector(openvino_backend, min_score=0.3)
    for together, image in zip(used.detect(images), images, strict=True):
        alone = used.detect([image])[0]
        assert len(together.segments) == len(alone.segments) > 0
        np.testing.assert_allclose(together.segments.endpoints, alone.segments.endpoints, atol=1e-3)
        np.testing.assert_allclose(together.segments.scores, alone.segments.scores, atol=1e-5)
    assert used.detect([]) == []


def test_the_threshold_only_leaves_out() -> None:
    backend, image = TorchBackend(tiny_net()), photo(96, 96)
    counts = []
    for min_score in (0.0, 0.3, 0.5, 0.7, 1.0):
        segments = detector(backend, min_score=min_score).detect([image])[0].segments
        assert (segments.scores >= min_score).all()
        counts.append(len(segments))
    assert all(more >= fewer for more, fewer in pairwise(counts))
    assert counts[0] > counts[2]


def test_torch_and_openvino_find_the_same_segments(openvino_backend: Backend) -> None:
    image = photo(90, 150)
    ours, theirs = (
        detector(backend, min_score=0.0).detect([image])[0].segments
        for backend in (TorchBackend(tiny_net()), openvino_backend)
    )
    np.testing.assert_allclose(ours.endpoints, theirs.endpoints, atol=0.01)
    np.testing.assert_allclose(ours.scores, theirs.scores, atol=TOLERANCE)


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


def test_a_loaded_detector_takes_what_its_weights_say(tmp_path: Path) -> None:
    path = save_tiny(tmp_path / "w.safetensors", scale=1.5, min_score=0.3)
    used = Detector.load(path, runtime="torch")
    assert (used.scale, used.min_score) == (1.5, 0.3)
    told = used.describe()
    assert told["weights"] == "tiny"
    assert told["preset"] == "fast"
    assert (told["backend"], told["precision"]) == ("torch", "f32")
    assert len(str(told["weights_sha256"])) == 64
    other = Detector.load(path, runtime="torch", scale=0.5, min_score=0.0)
    assert (other.scale, other.min_score) == (0.5, 0.0)


@pytest.mark.parametrize(
    ("size", "scale"), [((96, 130), 4), ((140, 128), 3), ((192, 400), 2), ((193, 200), 1), ((400, 500), 1)]
)
def test_small_images_are_enlarged_unless_a_scale_is_asked_for(
    tmp_path: Path, size: tuple[int, int], scale: int
) -> None:
    path, image = save_tiny(tmp_path / "w.safetensors"), photo(*size)
    auto, told = (Detector.load(path, runtime="torch", scale=s, min_score=0.0) for s in (None, scale))
    ours, theirs = (detector.detect([image])[0].segments for detector in (auto, told))
    np.testing.assert_array_equal(ours.endpoints, theirs.endpoints)
    assert ours.image_size == size
    assert (auto.describe()["scale"], told.describe()["scale"]) == ("auto", scale)


@pytest.mark.parametrize(
    "options",
    [{"scale": 0.0}, {"scale": 4.1}, {"scale": float("nan")}, {"min_score": -0.1}, {"min_score": 1.1}],
)
def test_numbers_out_of_range_are_one_line(tmp_path: Path, options: dict[str, float]) -> None:
    path = save_tiny(tmp_path / "w.safetensors")
    with pytest.raises(LSNetError, match="out of range; give"):
        Detector.load(path, runtime="torch", **options)


def test_names_that_are_no_weights_are_one_line() -> None:
    with pytest.raises(LSNetError, match="no such weights"):
        Detector.load("nonesuch")
