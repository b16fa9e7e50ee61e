"""Thresholds of coverage and anomalies: schemas/rules.toml, with single values replaced by a file."""

from __future__ import annotations

import hashlib
import json
import sys
import tomllib
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any, Literal, get_args

from inspect_pipeline.errors import RulesError
from inspect_pipeline.resources import read_schema

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

Priority = Literal["high", "medium", "low"]

PRIORITIES: tuple[Priority, ...] = get_args(Priority)
_LEAST = {"coverage.bin_m": 0.01}  # of all other numbers 0
_UNLIMITED = sys.float_info.max
_MOST_BY_SUFFIX = {"_share": 1.0, "_agreement": 1.0, "_angle_deg": 90.0, "_jump_deg": 180.0, "_luma": 255.0}


@dataclass(frozen=True, slots=True)
class Rules:
    """Values by section and name. schemas/rules.toml documents each of them."""

    frames: Mapping[str, float]
    tracks: Mapping[str, float]
    coverage: Mapping[str, float]
    anomalies: Mapping[str, Any]
    check: Mapping[str, Any]

    def of(self, kind: str) -> Mapping[str, float]:
        """Return the thresholds of a kind of anomaly."""
        section: Mapping[str, float] = self.anomalies[kind]
        return section

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of anomalies."""
        return tuple(name for name, value in self.anomalies.items() if isinstance(value, dict))

    def priority(self, kind: str) -> Priority:
        """Return the priority of a kind of anomaly."""
        priority: Priority = self.anomalies[kind]["priority"]
        return priority

    def failing_from(self, least: Priority) -> Rules:
        """Return rules whose check fails for all kinds of this priority and higher."""
        counting = PRIORITIES[: PRIORITIES.index(least) + 1]
        kinds = [kind for kind in self.kinds if self.priority(kind) in counting]
        return replace(self, check={**self.check, "fail_on": kinds})

    @property
    def sha256(self) -> str:
        """Hash of all values. Files with the same values have the same hash."""
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def load_rules(path: Path | None = None) -> Rules:
    """Return the shipped rules, with the values of a TOML file in place of theirs.

    Raises RulesError for a file that cannot be read, an unknown name, or a value of the wrong type or out of
    range.
    """
    values = deepcopy(_shipped())
    if path is not None:
        try:
            own = tomllib.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise RulesError(path, f"cannot be read ({error.strerror})", "check the name") from error
        except (ValueError, RecursionError) as error:  # TOML, UTF-8, very long numbers, deep nesting
            reason = str(error).partition(";")[0]
            raise RulesError(path, f"is not valid TOML ({reason})", "correct it") from error
        _replace(values, own, path, ())
        _check_kinds(Rules(**values), path)
    return Rules(**values)


@cache
def _shipped() -> dict[str, Any]:
    return tomllib.loads(read_schema("rules.toml"))


def _check_kinds(rules: Rules, path: Path) -> None:
    for kind in rules.check["fail_on"]:
        if kind not in rules.kinds:
            known = ", ".join(rules.kinds)
            raise RulesError(path, f"check.fail_on has the unknown kind {kind!r}", f"known here: {known}")
    for kind in rules.kinds:
        if rules.priority(kind) not in PRIORITIES:
            problem = f"anomalies.{kind}.priority is {rules.priority(kind)!r}"
            raise RulesError(path, problem, f"give {', '.join(PRIORITIES[:-1])} or {PRIORITIES[-1]}")


def _replace(values: dict[str, Any], own: Mapping[str, Any], path: Path, section: tuple[str, ...]) -> None:
    """Replace `values` by those of `own`, which must have known names, the same types and valid ranges."""
    for name, value in own.items():
        full = ".".join((*section, name))
        if name not in values:
            raise RulesError(path, f"unknown name {full}", f"known here: {', '.join(values)}")
        known = values[name]
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if isinstance(known, dict) and isinstance(value, dict):
            _replace(known, value, path, (*section, name))
        elif is_number and not _LEAST.get(full, 0.0) <= value <= _most(name):
            least, most = _LEAST.get(full, 0.0), _most(name)
            limits = f"from {least:g} to {most:g}" if most < _UNLIMITED else f"of at least {least:g}"
            raise RulesError(path, f"{full} is {value}", f"give a number {limits}, such as {known!r}")
        elif type(known) is type(value) or (isinstance(known, int | float) and is_number):
            values[name] = value
        else:
            raise RulesError(path, f"{full} has a value of the wrong type", f"give one like {known!r}")


def _most(name: str) -> float:
    """Return the greatest valid value of a number."""
    return next((most for suffix, most in _MOST_BY_SUFFIX.items() if name.endswith(suffix)), _UNLIMITED)
