"""Choice of the runtime by name, and OpenVINO's entry point; without torch, whose import takes seconds."""

from __future__ import annotations

import re
import sys
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from lsnet.errors import LSNetError

OPENVINO_MISSING = "OpenVINO is not installed; pip install 'lsnet-pipe[openvino]', or use the runtime torch"
RUNTIMES = ("auto", "torch", "torch-bf16", "torch-f16", "openvino", "openvino-bf16", "openvino-int8")


def choose_backend(runtime: str, *, has_gpu: bool) -> tuple[str, str]:
    """Return backend and precision of a runtime.

    `auto` is torch in f16 on a GPU, else OpenVINO if installed, else torch; both in bf16 where the CPU
    multiplies it.

    Raises:
        LSNetError: The name is unknown, or the runtime is not installed.
    """
    if runtime not in RUNTIMES:
        raise LSNetError(f"no runtime {runtime!r}; choose one of {', '.join(RUNTIMES)}")
    has_openvino = find_spec("openvino") is not None
    if runtime.startswith("openvino") and not has_openvino:
        raise LSNetError(OPENVINO_MISSING)
    if runtime == "auto" and has_gpu:
        return "torch", "f16"
    if runtime == "auto":
        return "openvino" if has_openvino else "torch", "bf16" if _has_bf16() else "f32"
    name, _, precision = runtime.partition("-")
    return name, precision or "f32"


def _has_bf16() -> bool:
    """Whether the CPU multiplies bf16: by AVX-512 or AMX, or on ARM."""
    try:
        text = Path("/proc/cpuinfo").read_text(errors="replace")
    except OSError:
        return False
    flags = re.search(r"^(?:flags|Features)\s*:(.*)", text, re.MULTILINE)
    return bool(flags and {"avx512_bf16", "amx_bf16", "bf16"} & set(flags[1].split()))


def choose_device(device: str | None) -> str:
    """Return the device of torch: cpu, or cuda:N. None is the first GPU if there is one.

    Raises:
        LSNetError: The name is unknown, or there is no such GPU.
    """
    if device not in (None, "cpu") and not re.fullmatch(r"cuda(:\d+)?", device):
        raise LSNetError(f"no device {device!r}; give cpu, cuda or cuda:N")
    if device == "cpu" or (device is None and not may_have_gpu()):
        return "cpu"
    import torch  # noqa: PLC0415 - takes seconds

    number = int((device or "").partition(":")[2] or 0)
    if number < torch.cuda.device_count():
        return f"cuda:{number}"
    if device is None:
        return "cpu"
    raise LSNetError(f"torch finds no GPU {device}; use the device cpu, or install torch for CUDA")


def may_have_gpu() -> bool:
    """Whether torch is not the build for CPUs, and the machine has a device for it."""
    try:
        is_cpu_build = version("torch").endswith("+cpu")
    except PackageNotFoundError:
        return False
    devices = ("/dev/nvidiactl", "/dev/kfd", "/dev/dxg")  # NVIDIA, AMD, and either in WSL
    return not is_cpu_build and any(Path(device).exists() for device in devices)


def import_openvino() -> Any:
    """Import openvino without openvino_telemetry, which reports imports and conversions to its makers.

    Raises:
        LSNetError: OpenVINO is not installed.
    """
    sys.modules.setdefault("openvino_telemetry", None)  # type: ignore[arg-type] # as if not installed
    try:
        import openvino  # noqa: PLC0415 - an extra
    except ImportError as err:
        raise LSNetError(OPENVINO_MISSING) from err
    return openvino


@lru_cache(maxsize=1)
def openvino_core() -> Any:
    """Return the only `openvino.Core` of the process, with its CPU plugin loaded.

    The plugin of each Core replaces the thread's alternate signal stack, and unmaps its own when it ends. If
    two of them end in the order in which they began, the thread is left with a stack that is not mapped, and
    the next signal that Python handles (a child that ends, SIGTERM) crashes the process. This one never ends;
    NNCF makes others, which begin and end above it.

    Raises:
        LSNetError: OpenVINO is not installed.
    """
    core = import_openvino().Core()
    core.get_versions("CPU")  # loads the plugin
    return core
