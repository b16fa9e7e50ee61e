"""What `lsnet` exports."""

from __future__ import annotations

import subprocess
import sys

import pytest

import lsnet


def test_every_exported_name_is_there() -> None:
    assert len(lsnet.__all__) == 9
    for name in lsnet.__all__:
        assert getattr(lsnet, name).__name__ == name
        assert getattr(lsnet, name).__doc__
    with pytest.raises(AttributeError, match="no attribute 'shipped'"):
        _ = lsnet.shipped


def test_importing_the_package_loads_nothing_heavy() -> None:
    program = "import sys, lsnet; print(sorted({'torch', 'cv2', 'numpy', 'openvino'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
