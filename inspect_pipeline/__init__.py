"""Process recordings of inspection flights, and query what was found.

    result = inspect_pipeline.process("flight.mcap", "inspections")
    inspect_pipeline.publish("inspections")
    frames = inspect_pipeline.query("inspections", "SELECT * FROM frames").fetchall()

The names below are loaded on first use, so that importing the package costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from inspect_pipeline.config import PlacingOptions, ProcessOptions
    from inspect_pipeline.errors import InspectError
    from inspect_pipeline.index.query import query
    from inspect_pipeline.pipeline import process
    from inspect_pipeline.publishing import publish
    from inspect_pipeline.recording.frames import iter_frames
    from inspect_pipeline.recording.reader import open_recording
    from inspect_pipeline.simulation.options import SimulationOptions
    from inspect_pipeline.simulation.write import simulate_flight as simulate
    from inspect_pipeline.store.store import Store

__all__ = [
    "InspectError",
    "PlacingOptions",
    "ProcessOptions",
    "SimulationOptions",
    "Store",
    "iter_frames",
    "open_recording",
    "process",
    "publish",
    "query",
    "simulate",
]

_PLACES = {
    "InspectError": "errors.InspectError",
    "PlacingOptions": "config.PlacingOptions",
    "ProcessOptions": "config.ProcessOptions",
    "SimulationOptions": "simulation.options.SimulationOptions",
    "Store": "store.store.Store",
    "iter_frames": "recording.frames.iter_frames",
    "open_recording": "recording.reader.open_recording",
    "process": "pipeline.process",
    "publish": "publishing.publish",
    "query": "index.query.query",
    "simulate": "simulation.write.simulate_flight",
}


def __getattr__(name: str) -> object:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, attribute = _PLACES[name].rpartition(".")
    globals()[name] = value = getattr(import_module(f"{__name__}.{module}"), attribute)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
