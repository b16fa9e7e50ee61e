"""Choice of the runtime by name, and OpenVINO's entry point; without torch, whose import takes seconds."""

from __future__ import annotations

import sys
from functools import lru_cache
from importlib.util import find_spec
from typing import Any

from lsnet.errors import LSNetError

OPENVINO_MISSING = "OpenVINO is not installed; pip install 'lsnet-pipe[openvino]', or use the runtime torch"
RUNTIMES = ("auto", "torch", "openvino", "openvino-bf16", "openvino-int8")


def choose_backend(runtime: str, *, has_gpu: bool) -> tuple[str, str]:
    """Return backend and precision of a runtime.

    `auto` is torch if there is a GPU, else OpenVINO if installed (in bf16 where the CPU supports it), else
    torch.

    Raises:
        LSNetError: The name is unknown, or the runtime is not installed.
    """
    if runtime not in RUNTIMES:
        raise LSNetError(f"no runtime {runtime!r}; choose one of {', '.join(RUNTIMES)}")
    has_openvino = find_spec("openvino") is not None
    if runtime.startswith("openvino") and not has_openvino:
        raise LSNetError(OPENVINO_MISSING)
    if runtime == "torch" or (runtime == "auto" and (has_gpu or not has_openvino)):
        return "torch", "f32"
    if runtime == "auto":
        has_bf16 = "BF16" in openvino_core().get_property("CPU", "OPTIMIZATION_CAPABILITIES")
        return "openvino", "bf16" if has_bf16 else "f32"
    return "openvino", runtime.partition("-")[2] or "f32"


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
