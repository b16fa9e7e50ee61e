"""Tiles cover each position of the map once, and equal the whole image."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from nets import TINY, photo, tiny_net

from lsnet import tiles
from lsnet.model import PRESETS
from lsnet.runtime import InferenceModule


@settings(max_examples=60, deadline=None)
@given(st.integers(2, 400), st.integers(2, 160))
def test_every_map_position_comes_from_one_tile_far_from_its_border(rows: int, columns: int) -> None:
    height, width = rows * 16, columns * 16
    taken = np.zeros((rows - 1, columns - 1), int)
    for tile in tiles.tiles_of(height, width):
        taken[tile.taken] += 1
        for window, own, inner, side in zip(
            tile.window, tile.taken, tile.inner(), (height, width), strict=True
        ):
            assert 0 <= window.start < window.stop <= side
            assert window.stop - window.start == min(side, tiles.TILE_PX)
            assert window.start % 16 == 0
            assert inner.start * 16 + window.start == own.start * 16
            assert inner.stop - inner.start == own.stop - own.start
            first_px, last_px = own.start * 16, (own.stop - 1) * 16 + 32
            assert window.start == 0 or first_px - window.start >= 128
            assert window.stop == side or window.stop - last_px >= 128
    assert (taken == 1).all()


@pytest.mark.parametrize("config", [TINY, PRESETS["fast"]], ids=["tiny", "fast"])
def test_tiles_equal_the_whole_frame(config: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiles, "TILE_PX", 448)
    run = InferenceModule(tiny_net(config=config)).eval()
    frame = torch.from_numpy(photo(32, 1008))[None]
    cut = tiles.tiles_of(32, 1008)
    assert len(cut) > 3
    with torch.inference_mode():
        whole = [part[0].numpy() for part in run(frame)]
        parts = [tuple(part[0].numpy() for part in run(frame[:, t.window[0], t.window[1]])) for t in cut]
    scores, endpoints = tiles.join(32, 1008, cut, parts)
    np.testing.assert_allclose(scores, whole[0], atol=1e-4)
    np.testing.assert_allclose(endpoints, whole[1], atol=1e-4)
