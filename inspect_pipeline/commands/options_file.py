"""`--config FILE`: defaults of a command's options in TOML, under their long names."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any

import typer

_MAX_BYTES = 1 << 20


def _load(context: typer.Context, path: Path | None) -> Path | None:
    """Make the values of the file the defaults of the command; options on the command line win."""
    if path is None:
        return None
    values = _read(path)
    parameters = {_key(parameter): parameter for parameter in context.command.params}
    known = sorted(parameters.keys() - {"config"})
    unknown = sorted(values.keys() - set(known))
    if unknown:
        raise typer.BadParameter(f"{path}: unknown option {unknown[0]!r}; known are {', '.join(known)}")
    context.default_map = {parameters[key].name: _plain(value) for key, value in values.items()}
    return path


def _read(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as file:
            content = file.read(_MAX_BYTES + 1)
        if len(content) > _MAX_BYTES:
            raise typer.BadParameter(f"{path}: larger than 1 MiB; give a file of options")
        return tomllib.loads(content.decode("utf-8"))
    except OSError as error:
        raise typer.BadParameter(f"{path}: {error.strerror or error}; check the name") from error
    except (ValueError, RecursionError) as error:
        raise typer.BadParameter(f"{path}: not TOML ({str(error).partition(';')[0][:200]})") from error


def _key(parameter: Any) -> str:
    """Return the long name of an option without its dashes, or the name of an argument."""
    name = next((name for name in parameter.opts if name.startswith("--")), parameter.name)
    return str(name).removeprefix("--")


def _plain(value: Any) -> Any:
    """Return a TOML value as the command line would give it."""
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if isinstance(value, dict):  # a table, such as [tag] or [signals]
        return [f"{key}={_plain(item)}" for key, item in value.items()]
    return value if isinstance(value, bool) else str(value)


ConfigOption = Annotated[
    Path | None,
    typer.Option(
        "--config", metavar="FILE", callback=_load, is_eager=True, help="Read options from this TOML file."
    ),
]
