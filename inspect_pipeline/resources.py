"""The one reader of the files in schemas/, which are installed as `inspect_pipeline.schemas`."""

from __future__ import annotations

from importlib.resources import files

# Of the index, in order; a file that was released never changes.
MIGRATIONS = ("0001_initial.sql", "0002_runs.sql", "0003_inspection.sql")


def read_schema(name: str) -> str:
    """The text of schemas/`name`; raises FileNotFoundError when the package lacks it."""
    return files("inspect_pipeline.schemas").joinpath(name).read_text(encoding="utf-8")
