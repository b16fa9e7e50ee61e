"""Focal lengths in pixels, by hand from data sheets."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest
from PIL import ExifTags, Image

from inspect_pipeline.config import PlacingOptions
from inspect_pipeline.convert.exif import read_tags
from inspect_pipeline.convert.lenses import focal_px_of_film, focal_px_of_sensor
from inspect_pipeline.convert.pack import pack
from inspect_pipeline.georeference.frames import Georeferencer
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording

if TYPE_CHECKING:
    from pathlib import Path

CALIBRATED = """<x:xmpmeta xmlns:x='adobe:ns:meta/'><rdf:RDF
 xmlns:rdf='http://www.w3.org/1999/02/22-rdf-syntax-ns#' xmlns:drone-dji='http://www.dji.com/drone-dji/1.0/'>
<rdf:Description drone-dji:CalibratedFocalLength="70.5" drone-dji:CalibratedOpticalCenterX="{x}"
 drone-dji:CalibratedOpticalCenterY="40"/></rdf:RDF></x:xmpmeta>"""


def photograph(path: Path, model: str, tags: dict[int, float], xmp: str = "") -> Path:
    exif = Image.Exif()
    exif[ExifTags.Base.Model] = model
    exif.get_ifd(ExifTags.IFD.Exif).update({ExifTags.Base.DateTimeOriginal: "2025:10:09 10:00:00", **tags})
    Image.new("RGB", (120, 80)).save(path, exif=exif, xmp=xmp.encode())
    return path


@pytest.mark.parametrize(
    ("model", "tags", "xmp", "focal_px"),
    [
        ("FC6310", {ExifTags.Base.FocalLength: 8.8}, "", 120 * 8.8 / 13.2),
        ("FC6310", {ExifTags.Base.FocalLengthIn35mmFilm: 24}, "", 120 * 24 / 36),
        ("XT2", {ExifTags.Base.FocalLength: 19}, "", 120 * 19 / 10.88),
        ("unheard of", {ExifTags.Base.FocalLength: 8.8}, "", None),
        (  # Canon PowerShot SX260 HS, made smaller: 6.2 mm wide
            "Canon PowerShot SX260 HS",
            {
                ExifTags.Base.FocalLength: 4.5,
                ExifTags.Base.FocalPlaneXResolution: 16393.44,
                ExifTags.Base.FocalPlaneResolutionUnit: 2,
                ExifTags.Base.ExifImageWidth: 4000,
            },
            "",
            120 * 4.5 / 6.1976,
        ),
        ("FC6310", {ExifTags.Base.FocalLength: 0}, "", None),
        ("any", {ExifTags.Base.FocalLengthIn35mmFilm: 24}, CALIBRATED.format(x=61), 70.5),
        ("any", {ExifTags.Base.FocalLengthIn35mmFilm: 24}, CALIBRATED.format(x=2736), 80),
    ],
)
def test_the_lens_of_a_photograph(
    tmp_path: Path, model: str, tags: dict[int, float], xmp: str, focal_px: float | None
) -> None:
    found = read_tags(photograph(tmp_path / "a.jpg", model, tags, xmp))
    assert found
    assert found.focal_px == (None if focal_px is None else pytest.approx(focal_px, rel=1e-4))


def test_lenses_of_data_sheets() -> None:
    """Phantom 4 Pro: 8.8 mm, 24 mm for 35 mm film. Mavic 3: 84 degrees across the diagonal of 4:3."""
    assert focal_px_of_sensor(8.8, "FC6310", (3648, 5472)) == pytest.approx(3648)
    focal_px = focal_px_of_film(24, (2160, 3840))
    assert focal_px == focal_px_of_film(24, (2880, 3840))  # the whole sensor
    assert math.degrees(2 * math.atan(3840 * 1.25 / 2 / focal_px)) == pytest.approx(84, abs=0.2)


def test_a_view_counts_before_a_nominal_lens(tmp_path: Path) -> None:
    (tmp_path / "DCIM").mkdir()
    photograph(tmp_path / "DCIM" / "a.jpg", "FC6310", {ExifTags.Base.FocalLength: 8.8})
    pack(tmp_path / "DCIM", tmp_path / "a.mcap")
    recording = open_recording(tmp_path / "a.mcap")
    (frame,) = iter_frames(recording)
    nominal, given = (
        Georeferencer.of(recording, PlacingOptions(view_deg=view_deg)).place(frame).focal_px
        for view_deg in (None, 90.0)
    )
    assert (nominal, given) == (pytest.approx(80), pytest.approx(60))
