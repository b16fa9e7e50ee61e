"""Geometry of conductors, places of rendered ones, and rendered scenes as training data."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from lsnet.errors import LSNetError
from lsnet.synth.backgrounds import BackgroundPool
from lsnet.synth.pbr.conductors import LAYERS, Camera, Hang, strands
from lsnet.synth.pbr.pictures import render_many
from lsnet.synth.pbr.render import lay_out, render
from lsnet.synth.pbr.scenes import RenderedScenes, rendered_pictures

if TYPE_CHECKING:
    from pathlib import Path

STRAIGHT = Hang((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.0)


def test_strands_fill_the_conductor_and_do_not_overlap() -> None:
    found, strand_m = strands(STRAIGHT, 0.01, 0.3)
    assert len(found) == sum(LAYERS) == 19
    assert strand_m == pytest.approx(0.002)
    radii = [np.hypot(strand[:, 1], strand[:, 2]) for strand in found]
    assert max(r.max() for r in radii) + strand_m == pytest.approx(0.01)
    for layer in (found[1:7], found[7:]):
        gaps = [np.linalg.norm(a - b, axis=1).min() for i, a in enumerate(layer) for b in layer[:i]]
        assert min(gaps) >= 2 * strand_m * 0.999


def test_layers_twist_opposite_ways() -> None:
    found, _ = strands(STRAIGHT, 0.01, 0.02)
    turns = []
    for strand in (found[1], found[7]):
        angle = np.unwrap(np.arctan2(strand[:, 2], strand[:, 1]))
        turns.append(angle[-1] - angle[0])
    assert turns[0] * turns[1] < 0


def test_a_hanging_cable_is_a_parabola_with_frames_across_it() -> None:
    hang = Hang((1.0, 2.0, 30.0), (0.8, 0.6, 0.0), 0.02)
    s = np.linspace(-5, 5, 11)
    points = hang.points(s)
    np.testing.assert_allclose(points[:, 2], 30 + 0.01 * s**2)
    side, up = hang.frame(s)
    steps = np.gradient(points, s, axis=0)
    for across in (side, up):
        np.testing.assert_allclose(np.linalg.norm(across, axis=1), 1)
        np.testing.assert_allclose((across * steps).sum(1)[1:-1], 0, atol=1e-9)


def test_a_camera_puts_its_target_in_the_middle_and_the_sky_above() -> None:
    camera = Camera((0.0, -4.0, 3.0), (0.0, 0.0, 0.0), 60.0, 200)
    middle, above, right = camera.project(np.array([[0.0, 0, 0], [0, 0, 0.5], [0.5, 0, 0]]))
    np.testing.assert_allclose(middle, [100, 100])
    assert above[1] < 99
    assert above[0] == pytest.approx(100)
    np.testing.assert_allclose(right, [100 + 0.5 / 5 * 100 / np.tan(np.pi / 6), 100])
    assert len(camera.project(np.array([[0.0, -9, 5]]))) == 0


@pytest.mark.parametrize("index", [0, 3])
def test_rendered_cables_lie_on_their_centrelines(index: int) -> None:
    pytest.importorskip("mitsuba")
    layout = lay_out(np.random.default_rng([1, index]), 96)
    image = render(layout, None, np.random.default_rng(0), samples=4)
    assert image.shape == (96, 96, 4)
    on_line = np.zeros((96, 96), np.uint8)
    for line in layout.lines():
        cv2.polylines(on_line, [np.floor(line).astype(np.int32)[:, None]], isClosed=False, color=1)
    assert (image[..., 3] > 60)[on_line > 0].mean() > 0.9
    assert image[..., 3].mean() < 0.5 * 255


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_pictures_are_made_once_and_the_same(tmp_path: Path, workers: int) -> None:
    pytest.importorskip("mitsuba")
    done: list[int] = []
    for _ in range(2):
        render_many(
            tmp_path / "a", 2, lights=None, size=64, seed=5, workers=workers, on_image=lambda: done.append(1)
        )
    assert len(done) == 4
    assert sorted(f.name for f in (tmp_path / "a").iterdir()) == [
        f"{i:06d}.{kind}" for i in (0, 1) for kind in ("json", "png")
    ]
    first = (tmp_path / "a/000001.png").read_bytes()
    (tmp_path / "a/000001.json").unlink()
    render_many(tmp_path / "a", 2, lights=None, size=64, seed=5, workers=1)
    assert (tmp_path / "a/000001.png").read_bytes() == first
    with pytest.raises(LSNetError, match=r"000000\.json: of another size or seed"):
        render_many(tmp_path / "a", 1, lights=None, size=64, seed=6, workers=1)


def test_no_lights_are_one_line(tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    with pytest.raises(LSNetError, match=r"no \.hdr files in this folder"):
        render_many(tmp_path / "a", 1, lights=tmp_path, size=64, seed=0, workers=1)


def test_a_damaged_light_is_one_line(tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    (tmp_path / "sky.hdr").write_text("no radiance")
    with pytest.raises(LSNetError, match=r"sky\.hdr: cannot be used as a light; remove it"):
        render_many(tmp_path / "a", 1, lights=tmp_path, size=64, seed=0, workers=1)


def write_picture(folder: Path) -> Path:
    """A white cable along row 60.5 of 128, drawn, as `model synth` would write it."""
    pixels = np.zeros((128, 128, 4), np.uint8)
    pixels[59:62] = 255
    cv2.imwrite(str(folder / "000000.png"), pixels)
    truth = {"size": [128, 128], "seed": 0, "lines": [[[-20, 60.5], [150, 60.5]]]}
    (folder / "000000.json").write_text(json.dumps(truth))
    return folder


def test_rendered_scenes_have_the_cable_where_the_line_is(tmp_path: Path) -> None:
    pictures = rendered_pictures(write_picture(tmp_path))
    scenes = RenderedScenes(pictures, BackgroundPool([]), size=96)
    differences = []
    for i in range(20):
        sample, again = scenes[i], scenes[i]
        np.testing.assert_array_equal(sample.image, again.image)
        assert sample.image.shape == (96, 96, 3)
        start, end = sample.lines[0][0], sample.lines[0][-1]
        normal = np.array([start[1] - end[1], end[0] - start[0]]) / np.hypot(*(end - start))
        points = start + np.linspace(0, 1, 400)[:, None] * (end - start)
        points = points[((points > 16) & (points < 80)).all(axis=1)]
        if not len(points):
            continue
        image = cv2.GaussianBlur(sample.image.astype(np.float32), (0, 0), 1).mean(axis=2)

        def at(p: np.ndarray, image: np.ndarray = image) -> float:
            return float(np.median(image[p[:, 1].astype(int), p[:, 0].astype(int)]))

        beside = (at(points + 12 * normal) + at(points - 12 * normal)) / 2
        differences.append(abs(at(points) - beside))
    assert len(differences) > 10
    assert np.median(differences) > 25


def test_a_folder_without_pictures_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(LSNetError, match="make some with lsnet-pipe model synth"):
        rendered_pictures(tmp_path)
    (tmp_path / "000000.json").write_text("{}")
    with pytest.raises(LSNetError, match=r"000000\.json: not the truth of a rendered picture"):
        RenderedScenes(rendered_pictures(tmp_path), BackgroundPool([]))[0]


def test_without_mitsuba_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    with pytest.raises(LSNetError, match=r"pip install 'lsnet-pipe\[synth\]'"):
        render_many(tmp_path / "a", 1, lights=None, size=64, seed=0, workers=1)
    assert not (tmp_path / "a").exists()
