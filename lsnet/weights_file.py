"""Weights files: safetensors whose header holds the card, one JSON text under the key `lsnet`; without torch.

Shipped weights are in `lsnet/pretrained` and are checked against the sha256 recorded beside them.
"""

from __future__ import annotations

import hashlib
import json
import textwrap
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open

from lsnet.errors import LSNetError
from lsnet.network_config import LSNetConfig
from lsnet.pretrained import path_of, read_checksums

FORMAT = 1
HEADER_KEY = "lsnet"
LINE_SCORE_PREFIX = "line_score."  # of the tensors of the learned line score
MAX_FILE_BYTES, MAX_CARD_CHARS = 512 << 20, 1 << 20


@dataclass(frozen=True, slots=True)
class WeightsCard:
    """Description of a weights file.

    Attributes:
        name: Name of the weights.
        preset: The preset they were trained from.
        network: The network they fit.
        min_score: Score threshold they were chosen with, from 0 to 1.
        scale: Default factor by which images are resized before detection; None for the levels of `scales`.
        recipe: How they were trained.
        metrics: Measured figures, by evaluation set.
        format: Version of this description.
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
        """Return the card as a JSON object."""
        return json.dumps(asdict(self), sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> WeightsCard:
        """Read a card.

        Raises:
            ValueError, LookupError, TypeError, RecursionError: The text is not a card of this format.
        """
        if len(text) > MAX_CARD_CHARS:
            raise ValueError("a card of more than a megabyte")
        values = json.loads(text)
        if values["format"] != FORMAT:
            raise ValueError(f"format {values['format']}")
        network = values.pop("network")
        network["stage_channels"] = tuple(network["stage_channels"])
        if not set(network) <= {f.name for f in fields(LSNetConfig)}:
            raise ValueError("another network description")
        card = cls(network=LSNetConfig(**network), **values)
        card._check()
        return card

    def _check(self) -> None:
        """Raise ValueError for values of another type or out of range."""
        kinds = {"name": str, "preset": str, "recipe": dict, "metrics": dict}
        wrong = [name for name, kind in kinds.items() if not isinstance(getattr(self, name), kind)]
        wrong += ["min_score"] * (not _is_number(self.min_score, 0, 1))
        wrong += ["scale"] * (self.scale is not None and not _is_number(self.scale, 0.05, 4))
        if wrong:
            raise ValueError(f"wrong {', '.join(wrong)} in its card")


def _is_number(value: object, low: float, high: float) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and low <= value <= high


@dataclass(frozen=True, slots=True, eq=False)
class WeightsFile:
    """The bytes of a weights file with the card they hold; the tensors are not looked at."""

    path: Path
    data: bytes
    card: WeightsCard
    sha256: str


def list_weights() -> list[str]:
    """Return the names of the weights in the package."""
    return sorted(read_checksums())


def read_weights(weights: str | Path) -> WeightsFile:
    """Read weights by shipped name or file.

    Raises:
        LSNetError: There are none of that name, or the file is damaged or of another version.
    """
    checksums = read_checksums()
    path = _find(weights, checksums)
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise LSNetError(f"{path}: too large for weights ({path.stat().st_size >> 20} MiB)")
        data = path.read_bytes()
    except OSError as err:
        raise LSNetError(f"{path}: cannot be read ({err.strerror}); give a file you may read") from err
    sha256 = hashlib.sha256(data).hexdigest()
    if checksums.get(str(weights), sha256) != sha256:
        raise LSNetError(f"{path}: damaged (sha256 {sha256[:16]}...); install the package again")
    try:
        with safe_open(path, framework="np") as header:
            card = WeightsCard.from_json(header.metadata()[HEADER_KEY])
    except (SafetensorError, ValueError, LookupError, TypeError, RecursionError) as err:
        raise unusable(path, err) from err
    return WeightsFile(path, data, card, sha256)


def unusable(path: Path, reason: Exception) -> LSNetError:
    """Return the error about a file whose card or tensors this version cannot use."""
    short = textwrap.shorten(str(reason), 200, placeholder=" ...")
    return LSNetError(f"{path}: not weights that this version can use ({short}); train or export them again")


def _find(weights: str | Path, checksums: dict[str, str]) -> Path:
    if str(weights) in checksums:
        return path_of(str(weights))
    path = Path(weights)
    try:
        is_file = path.is_file()
    except (OSError, ValueError):  # too long for a path, or with a null byte
        is_file = False
    if not is_file:
        names = ", ".join(sorted(checksums)) or "none"
        raise LSNetError(f"{weights}: no such weights; give a .safetensors file or a shipped name ({names})")
    return path
