"""Tiles cover each position of the map once, with few more pixels, and equal the whole image."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from nets import TINY, photo, tiny_net

from lsnet.network_config import PRESETS, LSNetConfig
from lsnet.runtime.torch import InferenceModule
from lsnet.tiles import join, tiles_of

FAST_PIXELS = PRESETS["fast"].pixels_at_once


@settings(max_examples=60, deadline=None)
@given(st.integers(2, 400), st.integers(2, 160), st.integers(400, 2000))
def test_every_map_position_comes_from_one_tile_far_from_its_border(
    rows: int, columns: int, side: int
) -> None:
    height, width = rows * 16, columns * 16
    taken = np.zeros((rows - 1, columns - 1), int)
    cut = tiles_of(height, width, side**2)
    assert (
        len({(t.window[0].stop - t.window[0].start, t.window[1].stop - t.window[1].start) for t in cut}) == 1
    )
    for tile in cut:
        taken[tile.taken] += 1
        for window, own, inner, side_px in zip(
            tile.window, tile.taken, tile.inner(), (height, width), strict=True
        ):
            assert 0 <= window.start < window.stop <= side_px
            assert window.start % 16 == window.stop % 16 == 0
            assert inner.start * 16 + window.start == own.start * 16
            assert inner.stop - inner.start == own.stop - own.start
            first_px, last_px = own.start * 16, (own.stop - 1) * 16 + 32
            assert window.start == 0 or first_px - window.start >= 144
            assert window.stop == side_px or window.stop - last_px >= 128
    assert (taken == 1).all()


@settings(max_examples=100, deadline=None)
@given(st.integers(20, 3125), st.floats(0.0, 1.0))
@example(5773 // 16, 0.9)
@example(348, 0.875)
def test_tiles_have_at_most_a_tenth_more_pixels_than_frames_of_up_to_50_megapixels(
    rows: int, share: float
) -> None:
    height = rows * 16
    width = round(20 * (50e6 / (320 * height)) ** share) * 16
    cut = tiles_of(height, width, FAST_PIXELS)
    pixels = [(t.window[0].stop - t.window[0].start) * (t.window[1].stop - t.window[1].start) for t in cut]
    assert max(pixels) <= FAST_PIXELS
    assert sum(pixels) <= 1.1 * height * width
    assert len(cut) == 1 or height * width > FAST_PIXELS


def test_two_4k_frames_of_fast_run_at_once_and_a_megapixel_of_paper() -> None:
    assert 2 * 2160 * 3840 <= FAST_PIXELS < 20e6
    assert 1 << 20 <= PRESETS["paper"].pixels_at_once < 1.2e6


@pytest.mark.parametrize("config", [TINY, PRESETS["fast"]], ids=["tiny", "fast"])
@pytest.mark.parametrize("size", [(32, 1600), (880, 880)])
def test_tiles_equal_the_whole_frame(config: LSNetConfig, size: tuple[int, int]) -> None:
    run = InferenceModule(tiny_net(config=config)).eval()
    frame = torch.from_numpy(photo(*size))[None]
    cut = tiles_of(*size, 600 * min(*size, 600))
    assert len(cut) == 4
    with torch.inference_mode():
        whole = [part[0].numpy() for part in run(frame)]
        parts = [tuple(part[0].numpy() for part in run(frame[:, t.window[0], t.window[1]])) for t in cut]
    scores, endpoints = join(*size, cut, parts)
    np.testing.assert_allclose(scores, whole[0], atol=1e-4)
    np.testing.assert_allclose(endpoints, whole[1], atol=1e-4)
