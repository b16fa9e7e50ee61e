"""Published stores, which these tests only read."""

from __future__ import annotations

import documented
import numpy as np
import pytest
from fakes import FakeDetector

from inspect_pipeline.pipeline import process
from inspect_pipeline.publishing import publish
from inspect_pipeline.simulation import write
from inspect_pipeline.simulation.ground import TILE_TEXELS
from inspect_pipeline.simulation.options import SimulationOptions
from inspect_pipeline.store.store import Store
from lsnet.segments import Detections, Lines, Segments

ALWAYS_DARK = "[frames]\ndark_below_luma = 250.0\noverexposed_above_luma = 255.0\n"


class TwoLines(FakeDetector):
    """Finds the same two lines in some of the images, by their content."""

    def _detect(self, image: np.ndarray) -> Detections:
        size = image.shape[:2]
        if int(image.sum()) % 2:
            return Detections(Segments.empty(size), Lines.empty(size))
        lines = ([[2, 3], [60, 40.5], [150, 90]], [[10, 110], [12.25, 20]])
        points = [np.array(line, np.float32) for line in lines]
        ends = np.array([(*p[0], *p[-1]) for p in points], np.float32)
        scores = np.array([0.9, 0.8], np.float32)
        return Detections(Segments(ends, scores, size), Lines(tuple(points), scores, size))


@pytest.fixture(scope="session")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Three flights without images, with spans, anomalies and reviews."""
    store = documented.make_store(tmp_path_factory.mktemp("exported"))
    publish(store)
    return store


@pytest.fixture(scope="session")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Ten seconds, every frame of which counts as dark."""
    folder = tmp_path_factory.mktemp("flown")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(write, "draw_ground", lambda rng: np.full((*TILE_TEXELS, 3), 90, np.uint8))
        write.simulate_flight(folder / "a.mcap", SimulationOptions(seconds=10, fps=1, image_size=(120, 160)))
    store = Store(folder / "store")
    process(folder / "a.mcap", store, TwoLines())
    (store.root / "rules.toml").write_text(ALWAYS_DARK)
    publish(store)
    return store
