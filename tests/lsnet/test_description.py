"""The description without loading is that of the loaded detector."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING, Any

import pytest
from nets import save_tiny

from lsnet import Detector
from lsnet.description import describe_detector

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize(
    "options",
    [{}, {"runtime": "torch"}, {"runtime": "openvino"}, {"scale": 0.5, "min_score": 0.25}],
    ids=str,
)
def test_a_description_is_that_of_the_detector(tmp_path: Path, options: dict[str, Any]) -> None:
    if options.get("runtime") == "openvino":
        pytest.importorskip("openvino")
    save_tiny(tmp_path / "w.safetensors", min_score=0.4)
    described = describe_detector(tmp_path / "w.safetensors", **options)
    assert described == Detector.load(tmp_path / "w.safetensors", **options).describe()


def test_what_only_loading_can_say(tmp_path: Path) -> None:
    (tmp_path / "bad.safetensors").write_bytes(b"\xff" * 100)
    assert describe_detector(tmp_path / "bad.safetensors") is None
    assert describe_detector(tmp_path / "none.safetensors") is None
    assert describe_detector(runtime="abacus") is None


def test_torch_is_not_imported() -> None:
    program = (
        "import sys; from lsnet.description import describe_detector;"
        "assert describe_detector() is None or 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
