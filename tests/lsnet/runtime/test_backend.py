"""Backends on tiny networks with random weights, against plain torch."""

from __future__ import annotations

import ctypes
import gc
import importlib
import os
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch
from nets import TINY, openvino_or_skip, photo, save_tiny, tiny_net

from lsnet import LSNetError, load_weights
from lsnet.network_config import PRESETS
from lsnet.runtime.backend import open_backend
from lsnet.runtime.openvino import OpenVinoBackend
from lsnet.runtime.torch import TorchBackend
from lsnet.synth.backgrounds import BackgroundPool
from lsnet.synth.dataset import SyntheticScenes
from lsnet.weights_file import read_weights

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from lsnet.arrays import Maps
    from lsnet.model import LSNet
    from lsnet.runtime.backend import Backend
    from lsnet.weights_file import WeightsFile

TOLERANCE = 1e-4  # of scores and of cell fractions, against torch in fp32


def plain_torch(net: LSNet, image: NDArray[np.uint8]) -> Maps:
    """The network as it was trained: fp32, norms not folded, one image."""
    with torch.no_grad():
        output = net(torch.from_numpy(image.transpose(2, 0, 1).copy())[None].float() / 255)
    return output.scores[0].numpy(), output.endpoints[0].permute(1, 2, 0).numpy()


def assert_close(found: Iterable[Maps], expected: Sequence[Maps], tolerance: float = TOLERANCE) -> None:
    for ours, theirs in zip(found, expected, strict=True):
        for a, b in zip(ours, theirs, strict=True):
            assert a.dtype == np.float32
            np.testing.assert_allclose(a, b, atol=tolerance, rtol=0)


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> WeightsFile:
    return read_weights(save_tiny(tmp_path_factory.mktemp("weights") / "tiny.safetensors"))


@pytest.fixture(scope="module")
def openvino_backend() -> Backend:
    openvino_or_skip()
    return OpenVinoBackend.convert(tiny_net())


@pytest.fixture(params=["torch", "openvino"])
def backend(request: pytest.FixtureRequest) -> Backend:
    if request.param == "torch":
        return TorchBackend(tiny_net())
    found: Backend = request.getfixturevalue("openvino_backend")
    return found


def test_backends_agree_with_plain_torch_whatever_the_sizes(backend: Backend) -> None:
    """With more sizes in one batch than cached networks."""
    images = [photo(height, 64) for height in (64, 32, 48, 64, 80, 96)]
    assert_close(backend.run(images), [plain_torch(tiny_net(), image) for image in images])


def test_the_grey_beside_images_hardly_matters() -> None:
    """Half a level beside that of training, here of random pixels and weights."""
    net, image = tiny_net(config=replace(TINY, pixel_mean=0.5)), photo(256, 256)
    ((ours, _),), (plain, _) = TorchBackend(net).run([image]), plain_torch(net, image)
    np.testing.assert_allclose(ours, plain, atol=0.03)
    np.testing.assert_allclose(ours[6:-6, 6:-6], plain[6:-6, 6:-6], atol=2e-3)


def test_batch_equals_single_images(backend: Backend) -> None:
    images = [photo(64, 64) for _ in range(5)]
    assert_close(backend.run(images), [next(iter(backend.run([image]))) for image in images], tolerance=1e-6)
    assert list(backend.run([])) == []


def test_a_caller_that_wants_no_more_leaves_the_backend_usable(backend: Backend) -> None:
    images = [photo(64, 64) for _ in range(12)]
    (first, *_) = (maps for maps, _ in zip(backend.run(images), range(1), strict=False))
    assert_close([first], [next(iter(backend.run(images[:1])))], 1e-6)
    assert len(list(backend.run(images))) == 12


def test_threads_may_share_a_backend(backend: Backend) -> None:
    images = [photo(32 + 16 * (i % 3), 64) for i in range(24)]
    with ThreadPoolExecutor(6) as pool:
        found = list(pool.map(lambda i: list(backend.run(images[i : i + 4])), range(0, 24, 4)))
    assert_close(
        [maps for part in found for maps in part], [next(iter(backend.run([i]))) for i in images], 1e-6
    )


def test_devices_by_name(tiny: WeightsFile) -> None:
    assert open_backend(tiny, "torch", "cpu").name == "torch"
    with pytest.raises(LSNetError, match="no device 'tpu'; give cpu, cuda or cuda:N"):
        open_backend(tiny, "torch", "tpu")
    with pytest.raises(LSNetError, match="torch finds no GPU cuda:77; use the device cpu"):
        open_backend(tiny, "torch", "cuda:77")


def test_non_contiguous_windows_are_accepted(backend: Backend) -> None:
    frame = photo(96, 96)
    window = frame[16:80, 32:96]
    assert not window.flags.c_contiguous
    assert_close(backend.run([window]), [plain_torch(tiny_net(), window)])


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["fast", "paper"])
def test_openvino_agrees_with_torch_on_whole_presets(preset: str) -> None:
    openvino_or_skip()
    config = replace(PRESETS[preset], pixel_mean=128 / 255)
    net, images = tiny_net(config=config), [photo(256, 320), photo(512, 512)]
    assert_close(
        OpenVinoBackend.convert(net).run(images), [plain_torch(net, i) for i in images], tolerance=1e-3
    )


@pytest.mark.slow
def test_quantized_network_agrees_with_float(capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("nncf")
    net, image = load_weights("fast").net, SyntheticScenes(BackgroundPool([]), 512, seed=5)[3].image
    (expected,) = TorchBackend(net).run([image])
    found = [next(OpenVinoBackend.convert(net, "int8").run([image])) for _ in range(2)]
    np.testing.assert_array_equal(found[0][0], found[1][0])  # the same network each time
    assert capfd.readouterr().out == ""
    assert np.abs(found[0][0] - expected[0]).mean() < 0.01
    sure = expected[0] > 0.7
    assert sure.sum() > 20
    assert (found[0][0][sure] > 0.5).mean() > 0.97
    assert np.median(np.abs(found[0][1] - expected[1])[sure]) < 0.003  # a tenth of a pixel
    assert (found[0][0] != expected[0]).any()


def test_missing_nncf_is_one_line(tiny: WeightsFile, monkeypatch: pytest.MonkeyPatch) -> None:
    openvino_or_skip()
    monkeypatch.setattr("lsnet.runtime.quantization.find_spec", lambda _name: None)
    with pytest.raises(LSNetError, match=r"NNCF is not installed; pip install 'lsnet-pipe\[int8\]', or use"):
        open_backend(tiny, "openvino-int8")


def test_runtime_names_set_the_precision(tiny: WeightsFile) -> None:
    ov = openvino_or_skip()
    has_bf16 = "BF16" in ov.Core().get_property("CPU", "OPTIMIZATION_CAPABILITIES")
    backends = {name: open_backend(tiny, name) for name in ("openvino", "openvino-bf16", "auto")}
    assert {name: (backend.name, backend.precision) for name, backend in backends.items()} == {
        "openvino": ("openvino", "f32"),
        "openvino-bf16": ("openvino", "bf16"),
        "auto": ("openvino", "bf16" if has_bf16 else "f32"),
    }
    image = photo(64, 64)
    assert_close(
        backends["openvino-bf16"].run([image]),
        [plain_torch(tiny_net(), image)],
        tolerance=0.2,  # of random weights, through many layers of 8 bits of mantissa
    )


def test_openvino_telemetry_is_blocked(openvino_backend: Backend) -> None:
    """Otherwise it reports each import and conversion, from a process of its own."""
    assert sys.modules["openvino_telemetry"] is None
    with pytest.raises(ImportError):
        importlib.import_module("openvino_telemetry")


def test_conversion_to_openvino_does_not_warn(recwarn: pytest.WarningsRecorder) -> None:
    openvino_or_skip()
    OpenVinoBackend.convert(tiny_net())
    assert [str(w.message) for w in recwarn] == []


def test_openvino_that_fails_to_import_is_one_line(
    tiny: WeightsFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "openvino", None)
    monkeypatch.setattr("lsnet.runtime.choice.find_spec", lambda _name: True)
    with pytest.raises(LSNetError, match=r"OpenVINO is not installed; pip install 'lsnet-pipe\[openvino\]'"):
        open_backend(tiny, "openvino")


def test_runtimes_by_name(tiny: WeightsFile) -> None:
    assert open_backend(tiny, "torch").name == "torch"
    with pytest.raises(LSNetError, match="no runtime 'tensorrt'; choose one of auto, torch, torch-bf16"):
        open_backend(tiny, "tensorrt")


def test_missing_openvino_is_one_line(tiny: WeightsFile, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lsnet.runtime.choice.find_spec", lambda _name: None)
    assert open_backend(tiny, "auto").name == "torch"
    for name in ("openvino", "openvino-bf16", "openvino-int8"):
        with pytest.raises(LSNetError, match=r"pip install 'lsnet-pipe\[openvino\]'"):
            open_backend(tiny, name)


def test_threads_are_not_held_to_a_core() -> None:
    """Processes of one thread would share the first one."""
    openvino_or_skip()
    backend = OpenVinoBackend.convert(tiny_net(), threads=1)
    list(backend.run([photo(64, 64)]))
    tasks = [int(task.name) for task in Path("/proc/self/task").iterdir()]
    assert all(os.sched_getaffinity(task) == os.sched_getaffinity(0) for task in tasks)


def test_backends_that_end_leave_a_stack_for_signal_handlers() -> None:
    """Python handles signals on the alternate stack of the thread; one that is not mapped is a crash."""
    openvino_or_skip()
    backends = [OpenVinoBackend.convert(tiny_net()) for _ in range(2)]
    for backend in backends:
        list(backend.run([photo(32, 32)]))
    del backend
    while backends:  # in the order in which they began
        backends.pop(0)
        gc.collect()
    stack = (ctypes.c_size_t * 3)()  # ss_sp, ss_flags, ss_size
    assert ctypes.CDLL(None).sigaltstack(None, stack) == 0
    maps = [line.split()[0].split("-") for line in Path("/proc/self/maps").read_text().splitlines()]
    assert any(int(start, 16) <= stack[0] < int(end, 16) for start, end in maps)
