"""Networks converted for OpenVINO, and the file NAME.openvino.zip beside the weights that keeps them.

It holds OpenVINO's intermediate representation of the network, in f32 (which serves bf16) and in int8, and
the sha256 of the weights it was made of. It counts only for exactly these weights.
"""

from __future__ import annotations

import json
import tempfile
import warnings
import zipfile
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lsnet.errors import LSNetError
from lsnet.runtime.choice import import_openvino, openvino_core

if TYPE_CHECKING:
    from lsnet.model import LSNet
    from lsnet.weights_file import WeightsFile

PRECISIONS = ("f32", "int8")
SUFFIX = ".openvino.zip"
_INDEX = "weights.json"
_MAX_BYTES = 1 << 30  # of a network
_DAMAGE = (
    OSError,
    EOFError,
    zipfile.BadZipFile,
    zlib.error,
    ValueError,
    LookupError,
    TypeError,
    RuntimeError,
)


def convert_network(net: LSNet, precision: str) -> Any:
    """Convert a network to OpenVINO, from the form in which it would be kept.

    A quantized network that stays in memory converts layouts twice where its kept form does not.

    Raises:
        LSNetError: OpenVINO is not installed, or NNCF for int8.
    """
    ov = import_openvino()
    import torch  # noqa: PLC0415 - takes seconds

    from lsnet.runtime.quantization import quantize_int8  # noqa: PLC0415
    from lsnet.runtime.torch import InferenceModule  # noqa: PLC0415

    example = torch.zeros(1, 64, 64, 3, dtype=torch.uint8)
    with warnings.catch_warnings():
        # The converter calls torch.jit.trace, which torch deprecates. torch.export gives the same network bit
        # for bit, but takes three times as long and warns too.
        warnings.simplefilter("ignore", DeprecationWarning)
        model = ov.convert_model(InferenceModule(net).eval(), example_input=example)
    return _decode(*_encode(quantize_int8(model) if precision == "int8" else model))


def write_networks(weights: WeightsFile) -> Path:
    """Convert the network of weights in all precisions, and keep it beside them.

    Raises:
        LSNetError: The weights cannot be used, OpenVINO or NNCF is not installed, or the file cannot be
            written.
    """
    from lsnet.weights import load_network  # noqa: PLC0415 - imports torch

    net, path = load_network(weights), path_beside(weights.path)
    models = {precision: convert_network(net, precision) for precision in PRECISIONS}
    try:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
            file.writestr(_INDEX, json.dumps({"weights_sha256": weights.sha256}))
            for precision, model in models.items():
                topology, constants = _encode(model)
                file.writestr(f"{precision}.xml", topology)
                file.writestr(f"{precision}.bin", constants)
    except OSError as err:
        raise LSNetError(f"{path}: cannot be written ({err.strerror}); copy the weights elsewhere") from err
    return path


def read_network(weights: WeightsFile, precision: str) -> Any | None:
    """Return the network kept beside weights; None if there is none of exactly these weights.

    Raises:
        LSNetError: The file is damaged, or OpenVINO is not installed.
    """
    path, name = path_beside(weights.path), "int8" if precision == "int8" else "f32"
    if not path.is_file():
        return None
    try:
        with zipfile.ZipFile(path) as file:
            if json.loads(file.read(_INDEX))["weights_sha256"] != weights.sha256:
                return None
            if f"{name}.xml" not in file.namelist():
                return None
            topology, constants = (_read(file, f"{name}.{part}") for part in ("xml", "bin"))
        return _decode(topology, constants)
    except _DAMAGE as err:
        raise LSNetError(f"{path}: damaged; delete it, or convert the weights again") from err


def _read(file: zipfile.ZipFile, name: str) -> bytes:
    """Read a file of bounded size. Raises ValueError, or LookupError where it is missing."""
    if file.getinfo(name).file_size > _MAX_BYTES:
        raise ValueError(f"{name} is too large")
    return file.read(name)


def path_beside(weights: Path) -> Path:
    """Return the file that keeps the networks of a weights file."""
    return weights.with_name(weights.stem + SUFFIX)


def _encode(model: Any) -> tuple[bytes, bytes]:
    """Return topology and constants of an OpenVINO network."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "network.xml"
        import_openvino().save_model(model, path, compress_to_fp16=False)
        return path.read_bytes(), path.with_suffix(".bin").read_bytes()


def _decode(topology: bytes, constants: bytes) -> Any:
    return openvino_core().read_model(topology, constants)
