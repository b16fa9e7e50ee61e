"""Options given as NAME=VALUE, for the many parameters of networks and losses."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any, TypeVar

from lsnet.errors import LSNetError

if TYPE_CHECKING:
    from collections.abc import Iterable

T = TypeVar("T")


def with_options(values: T, texts: Iterable[str]) -> T:
    """Return a dataclass of plain values with some of them replaced.

    Args:
        values: Gives the names and, by its present values, their types.
        texts: NAME=VALUE each; lists of numbers are separated by commas.

    Raises:
        LSNetError: A name is unknown, or a value is of another type or out of range.
    """
    names = [f.name for f in fields(values)]  # type: ignore[arg-type]
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or name not in names:
            raise LSNetError(f"no option {text!r}; give NAME=VALUE with one of {', '.join(names)}")
        try:
            values = replace(values, **{name: _parse(value, getattr(values, name))})  # type: ignore[type-var]
        except ValueError as err:
            raise LSNetError(f"option {text!r} cannot be used: {err}") from err
    return values


def _parse(text: str, example: object) -> Any:
    """Parse a value of the type of `example`; None stands for a whole number or none."""
    if isinstance(example, bool):
        if text not in {"true", "false"}:
            raise ValueError("give true or false")
        return text == "true"
    if isinstance(example, tuple):
        return tuple(int(part) for part in text.split(","))
    if isinstance(example, float):
        return float(text)
    if isinstance(example, int) or example is None:
        return None if text == "none" else int(text)
    return text
