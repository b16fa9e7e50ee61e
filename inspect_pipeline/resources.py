"""The package's version, and access to schemas/, which is installed as `inspect_pipeline.schemas`."""

from __future__ import annotations

from functools import cache
from importlib.metadata import version
from importlib.resources import files

# Of the index, in order. The statements of a released file never change.
MIGRATIONS = (
    "0001_initial.sql",
    "0002_runs.sql",
    "0003_inspection.sql",
    "0004_stills.sql",
    "0005_reviewers.sql",
    "0006_judgements.sql",
    "0007_priorities.sql",
    "0008_signals.sql",
    "0009_conductors.sql",
    "0010_track_scores.sql",
    "0011_terrain.sql",
)


@cache  # every call parses the package metadata
def app_version() -> str:
    """Return the version of lsnet-pipe."""
    return version("lsnet-pipe")


def read_schema(name: str) -> str:
    """Return the text of schemas/`name`; raises FileNotFoundError when the package lacks it."""
    return files("inspect_pipeline.schemas").joinpath(name).read_text(encoding="utf-8")
