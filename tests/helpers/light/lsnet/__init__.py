"""The package of this name without its own __init__, which takes seconds to load what no stub uses."""

from pathlib import Path

__path__ = [str(Path(__file__).parents[4] / "lsnet")]
