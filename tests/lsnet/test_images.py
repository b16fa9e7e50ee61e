"""Images read from files."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from lsnet.images import load_rgb

if TYPE_CHECKING:
    from pathlib import Path


def exif_turned_jpeg() -> bytes:
    """A JPEG of 40 x 20 with an EXIF orientation of a quarter turn."""
    data = cv2.imencode(".jpg", np.full((20, 40, 3), 90, np.uint8))[1].tobytes()
    tiff = b"MM\0*\0\0\0\x08" + b"\0\x01" + b"\x01\x12\0\x03\0\0\0\x01\0\x06\0\0" + b"\0\0\0\0"
    segment = b"Exif\0\0" + tiff
    return data[:2] + b"\xff\xe1" + (len(segment) + 2).to_bytes(2) + segment + data[2:]


def test_images_are_read_as_stored(tmp_path: Path) -> None:
    path = tmp_path / "turned.jpg"
    path.write_bytes(exif_turned_jpeg())
    assert cv2.imread(str(path)).shape == (40, 20, 3)  # so the orientation is there
    assert load_rgb(path).shape == (20, 40, 3)
    red = np.zeros((4, 5, 3), np.uint8)
    red[..., 2] = 200  # BGR
    cv2.imwrite(str(tmp_path / "red.png"), red)
    assert load_rgb(tmp_path / "red.png")[0, 0].tolist() == [200, 0, 0]
    cv2.imwrite(str(tmp_path / "grey.png"), red[..., 2])
    assert load_rgb(tmp_path / "grey.png")[0, 0].tolist() == [200, 200, 200]


def test_radiance_maps_are_tone_mapped(tmp_path: Path) -> None:
    radiance = np.full((16, 32, 3), 0.5, np.float32)
    radiance[:, 16:] = (0.1, 1, 20)  # BGR
    cv2.imwrite(str(tmp_path / "sky.hdr"), radiance)
    image = load_rgb(tmp_path / "sky.hdr")
    assert (image.shape, image.dtype) == ((16, 32, 3), np.uint8)
    assert image[0, 31, 0] > image[0, 31, 1] > image[0, 31, 2]
    assert 0 < image[0, 0, 0] < 255
    cv2.imwrite(str(tmp_path / "grey.png"), np.full((16, 32), 90, np.uint8))
    (tmp_path / "grey.png").rename(tmp_path / "misnamed.hdr")
    assert load_rgb(tmp_path / "misnamed.hdr").shape == (16, 32, 3)
