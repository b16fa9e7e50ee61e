"""Converted networks beside their weights: used for exactly these, without torch."""

from __future__ import annotations

import shutil
import subprocess
import sys
from typing import TYPE_CHECKING

import numpy as np
import pytest
from nets import openvino_or_skip, photo, save_tiny

from lsnet import Detector, LSNetError
from lsnet.runtime import networks
from lsnet.runtime.networks import path_beside, read_network, write_networks
from lsnet.weights_file import list_weights, read_weights

if TYPE_CHECKING:
    from pathlib import Path


def test_the_shipped_network_is_of_the_shipped_weights() -> None:
    """After a change of the weights: lsnet-pipe model convert fast."""
    openvino_or_skip()
    for name in list_weights():
        assert all(read_network(read_weights(name), precision) for precision in ("bf16", "int8")), name


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    openvino_or_skip()
    path = save_tiny(tmp_path_factory.mktemp("converted") / "w.safetensors")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(networks, "PRECISIONS", ("f32",))  # quantizing takes half a minute
        write_networks(read_weights(path))
    return path


@pytest.fixture
def converted(template: Path, tmp_path: Path) -> Path:
    """Weights with their converted network beside them."""
    shutil.copytree(template.parent, tmp_path, dirs_exist_ok=True)
    return tmp_path / template.name


def test_the_kept_network_gives_the_same_results(converted: Path) -> None:
    images = [photo(70, 90)]
    (kept,) = Detector.load(converted, runtime="openvino", min_score=0.0).detect(images)
    path_beside(converted).unlink()
    (made,) = Detector.load(converted, runtime="openvino", min_score=0.0).detect(images)
    np.testing.assert_array_equal(kept.segments.endpoints, made.segments.endpoints)
    np.testing.assert_array_equal(kept.segments.scores, made.segments.scores)
    assert len(kept.segments)


def test_torch_is_not_imported_for_a_kept_network(converted: Path) -> None:
    program = (
        "import sys, numpy; from lsnet import Detector;"
        f"Detector.load({str(converted)!r}, runtime='openvino').detect(numpy.zeros((64, 64, 3), 'uint8'));"
        "assert not {'torch', 'nncf'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_a_network_of_other_weights_does_not_count(converted: Path) -> None:
    assert read_network(read_weights(converted), "bf16") is not None
    save_tiny(converted, seed=1)
    assert read_network(read_weights(converted), "bf16") is None
    assert len(Detector.load(converted, runtime="openvino", min_score=0.0).detect(photo(64, 64))[0].segments)


def test_a_precision_that_was_not_kept_is_converted(converted: Path) -> None:
    assert read_network(read_weights(converted), "int8") is None


@pytest.mark.parametrize("part", [slice(200, 240), slice(None, -2000), slice(None, 60)])
def test_a_damaged_network_is_one_line(converted: Path, part: slice) -> None:
    path = path_beside(converted)
    data = bytearray(path.read_bytes())
    data[part] = b"x" * len(data[part])
    path.write_bytes(data)
    with pytest.raises(LSNetError) as error:
        read_network(read_weights(converted), "f32")
    assert str(error.value) == f"{path}: damaged; delete it, or convert the weights again"
