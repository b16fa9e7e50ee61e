"""Where a network is trained, and whether bfloat16 helps there."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import torch

from lsnet.errors import LSNetError


def choose_device(name: str) -> torch.device:
    """Return the device of a name: auto, cuda or cpu. Raises LSNetError when torch cannot use it."""
    has_gpu = torch.cuda.is_available()
    if name not in {"auto", "cuda", "cpu"}:
        raise LSNetError(f"no device {name!r}; choose one of auto, cuda, cpu")
    if name == "cuda" and not has_gpu:
        raise LSNetError("no GPU that this build of torch can use; give --device cpu")
    return torch.device("cuda" if has_gpu and name != "cpu" else "cpu")


def autocast(device: torch.device) -> Any:
    """Return a context that computes in bfloat16 where the device multiplies it, and in float32 elsewhere."""
    helps = torch.cuda.is_bf16_supported() if device.type == "cuda" else _cpu_multiplies_bf16()
    return torch.autocast(device.type, dtype=torch.bfloat16, enabled=helps)


@cache
def _cpu_multiplies_bf16() -> bool:
    try:
        flags = Path("/proc/cpuinfo").read_text()
    except OSError:  # not Linux
        return False
    return "avx512_bf16" in flags or "amx_bf16" in flags
