"""Weights with everything needed to use them: network, preprocessing, threshold, recipe, measured figures.

A weights file is safetensors; its header holds one JSON text under the key `lsnet`. Shipped weights lie in
`lsnet/pretrained` and are checked against the sha256 recorded beside them.
"""

from __future__ import annotations

import hashlib
import json
import textwrap
from dataclasses import asdict, dataclass, field, fields
from importlib import resources
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import load as load_tensors
from safetensors.torch import save as save_tensors

from lsnet.errors import LSNetError
from lsnet.model import LSNet, LSNetConfig

FORMAT = 1
HEADER_KEY = "lsnet"


@dataclass(frozen=True, slots=True)
class WeightsCard:
    """What a weights file says of itself.

    min_score: the score threshold the weights were chosen with. scale: the factor by which frames are
    resized before detection when the user does not say, None to enlarge small ones only. recipe: how
    they were trained. metrics: what was measured, by set.
    """

    name: str
    preset: str
    network: LSNetConfig
    min_score: float
    scale: float | None = None
    recipe: dict[str, Any] = field(default_factory=dict)
    metrics: dict[str, Any] = field(default_factory=dict)
    format: int = FORMAT

    def to_json(self) -> str:
        """One JSON object."""
        return json.dumps(asdict(self), sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> WeightsCard:
        """Raises ValueError, KeyError or TypeError on anything but a card of this format."""
        values = json.loads(text)
        if values["format"] != FORMAT:
            raise ValueError(f"format {values['format']}")
        network = values.pop("network")
        network["stage_channels"] = tuple(network["stage_channels"])
        if not set(network) <= {f.name for f in fields(LSNetConfig)}:
            raise ValueError("another network description")
        return cls(network=LSNetConfig(**network), **values)


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """A loaded network with its card and the sha256 of its file."""

    net: LSNet
    card: WeightsCard
    sha256: str


def shipped() -> dict[str, str]:
    """Names of the weights in the package, with their sha256."""
    text = resources.files("lsnet.pretrained").joinpath("sha256.json").read_text()
    names: dict[str, str] = json.loads(text)
    return names


def save_weights(path: Path, net: LSNet, card: WeightsCard) -> str:
    """Write a weights file; its sha256. Raises LSNetError when it cannot be written."""
    tensors = {name: tensor.contiguous() for name, tensor in net.state_dict().items()}
    data = save_tensors(tensors, {HEADER_KEY: card.to_json()})
    try:
        path.write_bytes(data)
    except OSError as err:
        raise LSNetError(f"{path}: cannot be written ({err.strerror}); name another file") from err
    return hashlib.sha256(data).hexdigest()


def load_weights(weights: str | Path) -> Weights:
    """Weights by shipped name or by file; every tensor must be there and fit.

    Raises LSNetError when there are none of that name, or the file is damaged or of another version.
    """
    known = shipped()
    path = _find(weights, known)
    try:
        data = path.read_bytes()
    except OSError as err:
        raise LSNetError(f"{path}: cannot be read ({err.strerror}); give a file you may read") from err
    sha256 = hashlib.sha256(data).hexdigest()
    if str(weights) in known and known[str(weights)] != sha256:
        raise LSNetError(f"{path}: damaged (sha256 {sha256[:16]}...); install the package again")
    try:
        with safe_open(path, framework="pt") as header:
            card = WeightsCard.from_json(header.metadata()[HEADER_KEY])
        net = LSNet(card.network)
        net.load_state_dict(load_tensors(data), strict=True)
    except (SafetensorError, ValueError, LookupError, ArithmeticError, TypeError, RuntimeError) as err:
        reason = textwrap.shorten(str(err), 200, placeholder=" ...")
        raise LSNetError(
            f"{path}: not weights that this version can use ({reason}); train or export them again"
        ) from err
    return Weights(net.eval(), card, sha256)


def _find(weights: str | Path, known: dict[str, str]) -> Path:
    if str(weights) in known:
        return Path(str(resources.files("lsnet.pretrained").joinpath(f"{weights}.safetensors")))
    path = Path(weights)
    if not path.is_file():
        names = ", ".join(sorted(known)) or "none"
        raise LSNetError(f"{weights}: no such weights; give a .safetensors file or a shipped name ({names})")
    return path
