"""`--config FILE`: every option of a command in a TOML file, under its long name; the command line wins."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any

import typer


def _load(context: typer.Context, path: Path | None) -> Path | None:
    """Make the values of the file the defaults of the command."""
    if path is None:
        return None
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise typer.BadParameter(f"{path}: {error}") from error
    parameters = {_key(parameter): parameter for parameter in context.command.params}
    unknown = sorted(values.keys() - (parameters.keys() - {"config"}))
    if unknown:
        known = ", ".join(sorted(parameters.keys() - {"config"}))
        raise typer.BadParameter(f"{path}: there is no option {unknown[0]!r}; there are: {known}")
    context.default_map = {parameters[key].name: _plain(value) for key, value in values.items()}
    return path


def _key(parameter: Any) -> str:
    """The long name of an option without its dashes, or the name of an argument."""
    name = next((name for name in parameter.opts if name.startswith("--")), parameter.name)
    return str(name).removeprefix("--")


def _plain(value: Any) -> Any:
    """What the command line would say for a value of TOML."""
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return value if isinstance(value, bool) else str(value)


ConfigOption = Annotated[
    Path | None,
    typer.Option(
        "--config", metavar="FILE", callback=_load, is_eager=True, help="Read options from this TOML file."
    ),
]
