from __future__ import annotations

import resource
import struct
import zlib
from contextlib import suppress
from io import BytesIO
from typing import Any

import cv2
import factories
import numpy as np
import pytest
from factories import ENCODINGS, RAW_ENCODINGS, RawPixels, encoded_picture, make_recording, number_of, picture
from PIL import Image

from inspect_pipeline.images.decode import ImageDecoder, refusal
from inspect_pipeline.messages.image import ImageError, ImageMessage, parse
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording

STAMP_NS = 1_700_000_000_123_456_789


def decode(image: ImageMessage) -> np.ndarray:
    return ImageDecoder().decode(image).image


def message(data: bytes, image_format: str = "jpeg") -> ImageMessage:
    return ImageMessage(0, "", image_format, data)


@pytest.mark.parametrize("name", ENCODINGS)
def test_every_truncation_of_a_message_is_an_image_error(name: str) -> None:
    how = ENCODINGS[name]
    payload = how.encode(STAMP_NS, "cam", encoded_picture(7))
    for length in range(len(payload)):
        try:
            parsed = parse(how.schema_name, how.message_encoding, memoryview(payload)[:length])
            decode(parsed)
        except ImageError:
            continue
        assert name in {"protobuf", "flatbuffer"}  # whose fields may be absent or come in any order
        assert length >= len(encoded_picture(7))


@pytest.mark.parametrize("suffix", [".png", ".webp", ".bmp", ".tiff"])
def test_the_first_bytes_decide_the_format_and_colours_are_rgb(suffix: str) -> None:
    options = [cv2.IMWRITE_WEBP_QUALITY, 101] if suffix == ".webp" else []
    data = cv2.imencode(suffix, cv2.cvtColor(picture(9), cv2.COLOR_RGB2BGR), options)[1].tobytes()
    np.testing.assert_array_equal(decode(message(data, "nonsense")), picture(9))


@pytest.mark.parametrize(
    ("mode", "options"), [("RGB", {}), ("RGB", {"subsampling": 0, "progressive": True}), ("L", {})]
)
def test_jpegs_are_what_pillow_decodes(mode: str, options: dict[str, Any]) -> None:
    x, y = np.meshgrid(np.linspace(0, 1, 96), np.linspace(0, 1, 64))
    scene = np.stack([255 * x, 255 * y, 128 + 100 * np.sin(9 * (x + y))], -1).astype(np.uint8)
    file = BytesIO()
    Image.fromarray(scene).convert(mode).save(file, "JPEG", quality=85, **options)
    expected = np.asarray(Image.open(BytesIO(file.getvalue())).convert("RGB"), np.int16)
    assert np.abs(decode(message(file.getvalue())) - expected).max() <= 3


def test_grey_and_16_bit_images_become_rgb() -> None:
    grey = picture(9)[..., 2]
    data = cv2.imencode(".png", grey.astype(np.uint16) * 257)[1].tobytes()
    np.testing.assert_array_equal(decode(message(data)), np.repeat(grey[..., np.newaxis], 3, 2))


def test_exif_orientation_is_ignored() -> None:
    jpeg = cv2.imencode(".jpg", np.zeros((12, 16, 3), np.uint8))[1].tobytes()
    rotate_90 = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    segment = b"\xff\xe1" + (len(rotate_90) + 2).to_bytes(2, "big") + rotate_90
    assert decode(message(jpeg[:2] + segment + jpeg[2:])).shape == (12, 16, 3)


@pytest.mark.parametrize("data", [b"", b"\0", b"\xff\xd8\xff", b"no image", encoded_picture(1)[:40]])
def test_what_cannot_be_decoded_is_an_image_error(data: bytes) -> None:
    with pytest.raises(ImageError, match="the image"):
        decode(message(data))


def raw(encoding: str, pixels: np.ndarray, *, padding: int = 0, is_big_endian: bool = False) -> RawPixels:
    """Rows of pixels as a raw image with so many bytes of padding a row."""
    dtype = pixels.dtype.newbyteorder(">" if is_big_endian else "<")
    rows = pixels.astype(dtype).reshape(len(pixels), -1).view(np.uint8)
    data = np.pad(rows, ((0, 0), (0, padding)), constant_values=77)
    height = len(pixels) * 2 // 3 if encoding == "nv12" else len(pixels)
    return RawPixels(encoding, height, pixels.shape[1], data.shape[1], data.tobytes(), is_big_endian)


def decode_raw(image: RawPixels) -> np.ndarray:
    payload = factories.ros2_cdr(0, "", image)
    return decode(parse("sensor_msgs/msg/Image", "cdr", memoryview(payload)))


@pytest.mark.parametrize("name", RAW_ENCODINGS)
def test_raw_recordings_are_read(name: str, tmp_path) -> None:
    shots = [shot._replace(data=raw("rgb8", picture(shot.number), padding=5)) for shot in factories.shots(4)]
    path = make_recording(tmp_path / "a.mcap", shots, encoding=RAW_ENCODINGS[name])
    frames = list(iter_frames(open_recording(path)))
    assert [(number_of(f.image), f.frame_id, f.stamp_ns - f.log_time_ns) for f in frames] == [
        (i, "cam", -factories.STAMP_LAG_NS) for i in range(4)
    ]


@pytest.mark.parametrize("padding", [0, 3])
@pytest.mark.parametrize("is_big_endian", [False, True])
def test_pixel_encodings_without_loss(padding: int, is_big_endian: bool) -> None:
    rgb = picture(77)
    alpha = np.full((*rgb.shape[:2], 1), 9, np.uint8)
    grey = rgb[..., 2]
    cases = {
        "rgb8": (rgb, rgb),
        "bgr8": (rgb[..., ::-1], rgb),
        "8UC3": (rgb[..., ::-1], rgb),
        "rgba8": (np.concatenate([rgb, alpha], -1), rgb),
        "bgra8": (np.concatenate([rgb[..., ::-1], alpha], -1), rgb),
        "8UC4": (np.concatenate([rgb[..., ::-1], alpha], -1), rgb),
        "mono8": (grey, np.dstack([grey] * 3)),
        "8UC1": (grey, np.dstack([grey] * 3)),
        "mono16": (grey.astype(np.uint16) * 256 + 200, np.dstack([grey] * 3)),
        "16UC1": (grey.astype(np.uint16) * 256 + 200, np.dstack([grey] * 3)),
    }
    for encoding, (pixels, expected) in cases.items():
        image = raw(encoding, pixels, padding=padding * pixels.itemsize, is_big_endian=is_big_endian)
        np.testing.assert_array_equal(decode_raw(image), expected, err_msg=encoding)


def test_spellings_of_pixel_encodings() -> None:
    rgb = picture(77)
    for encoding in ("BGR8", "bgr8 ", "8uc3"):
        np.testing.assert_array_equal(decode_raw(raw(encoding, rgb[..., ::-1])), rgb, err_msg=encoding)


@pytest.mark.parametrize("is_big_endian", [False, True])
def test_16_bit_colours(is_big_endian: bool) -> None:
    rgb = picture(77)
    deep, alpha = rgb.astype(np.uint16) * 257, np.full((*rgb.shape[:2], 1), 9, np.uint16)
    bgra = np.concatenate([deep[..., ::-1], alpha], -1)
    cases = {"rgb16": deep, "bgr16": deep[..., ::-1], "16UC3": deep[..., ::-1], "bgra16": bgra, "16UC4": bgra}
    for encoding, pixels in cases.items():
        image = raw(encoding, pixels, is_big_endian=is_big_endian)
        np.testing.assert_array_equal(decode_raw(image), rgb, err_msg=encoding)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize("bits", [8, 16])
def test_bayer_patterns_of_one_colour(pattern: str, bits: int) -> None:
    colour = {"r": 200, "g": 120, "b": 40}
    block = np.array([colour[c] for c in pattern]).reshape(2, 2)
    pixels = np.tile(block, (8, 8))
    pixels = (pixels * 257).astype(np.uint16) if bits == 16 else pixels.astype(np.uint8)
    decoded = decode_raw(raw(f"bayer_{pattern}{bits}", pixels))
    assert np.abs(decoded[2:-2, 2:-2].astype(int) - [200, 120, 40]).max() <= 1


YUV_422 = {"yuv422": "uyvy", "uyvy": "uyvy", "yuv422_yuy2": "yuyv", "yuyv": "yuyv", "YUY2": "yuyv"}
YUV_420 = ("nv12", "nv21", "i420", "yuv420", "yv12")
HALVES = ((120, 90, 180), (150, 140, 110))  # y, u, v of the upper and the lower half


def rgb_of(y: int, u: int, v: int) -> list[float]:
    """BT.601 in limited range."""
    luma = 1.164 * (y - 16)
    return [luma + 1.596 * (v - 128), luma - 0.813 * (v - 128) - 0.391 * (u - 128), luma + 2.018 * (u - 128)]


def yuv_image(encoding: str, height: int, width: int, padding: int = 0) -> RawPixels:
    """An image whose upper and lower half have one colour each, packed by hand; height is a multiple of 4."""
    halves = [HALVES[0]] * (height // 2) + [HALVES[1]] * (height - height // 2)
    shared = [halves[row] for row in range(0, height, 2)]  # colours of the rows of 4:2:0 chroma
    n_pairs = (width + 1) // 2
    if encoding in YUV_422:
        order = [YUV_422[encoding][i] for i in range(4)]
        of = [dict(zip("yuv", row, strict=True)) for row in halves]
        rows = [bytes([one[c] for c in order] * n_pairs)[: 2 * width] for one in of]
    elif encoding == "nv24":
        rows = [bytes([y]) * width for y, _, _ in halves]
        pairs = [bytes([u, v] * width) for _, u, v in halves]
        rows += [half for row in pairs for half in (row[:width], row[width:])]
    elif encoding in {"nv12", "nv21"}:
        rows = [bytes([y]) * width for y, _, _ in halves]
        rows += [bytes([u, v] if encoding == "nv12" else [v, u]) * n_pairs for _, u, v in shared]
    else:
        planes = [[u for _, u, _ in shared], [v for _, _, v in shared]]
        planes = planes[::-1] if encoding == "yv12" else planes
        chroma = b"".join(bytes([value]) * n_pairs for plane in planes for value in plane)
        rows = [bytes([y]) * width for y, _, _ in halves]
        rows += [chroma[at : at + width] for at in range(0, len(chroma), width)]
    step = max(len(row) for row in rows) + padding
    return RawPixels(encoding, height, width, step, b"".join(row.ljust(step, b"M") for row in rows))


@pytest.mark.parametrize("padding", [0, 4])
@pytest.mark.parametrize("encoding", [*YUV_422, "nv12", "nv21", "nv24"])
def test_yuv(encoding: str, padding: int) -> None:
    check_halves(decode_raw(yuv_image(encoding, 8, 16, padding)))


@pytest.mark.parametrize("encoding", YUV_420)
def test_yuv_without_padding(encoding: str) -> None:
    check_halves(decode_raw(yuv_image(encoding, 8, 16)))


@pytest.mark.parametrize(("encoding", "size"), [("yuyv", (8, 15)), ("nv24", (8, 15))])
def test_yuv_of_odd_width(encoding: str, size: tuple[int, int]) -> None:
    image = decode_raw(yuv_image(encoding, *size))
    assert image.shape == (*size, 3)
    check_halves(image)


@pytest.mark.parametrize("size", [(7, 16), (8, 15), (7, 15)])
def test_nv12_of_odd_size(size: tuple[int, int]) -> None:
    even = yuv_image("nv12", 8, 16)
    rows = [even.data[i : i + 16] for i in range(0, len(even.data), 16)]
    luma, chroma = rows[: size[0]], rows[8:]
    image = decode_raw(even._replace(height=size[0], width=size[1], data=b"".join(luma + chroma)))
    np.testing.assert_array_equal(image, decode_raw(even)[: size[0], : size[1]])


def check_halves(image: np.ndarray) -> None:
    half = len(image) // 2
    assert np.abs(image[:half].astype(float) - rgb_of(*HALVES[0])).max() <= 3
    assert np.abs(image[half:].astype(float) - rgb_of(*HALVES[1])).max() <= 3


def test_a_raw_image_smaller_than_it_says_is_an_image_error() -> None:
    image = raw("rgb8", picture(1))
    for wrong in (
        image._replace(height=1000),
        image._replace(step_bytes=3, data=image.data + b"?"),
        image._replace(width=0),
        image._replace(data=image.data[:-1]),
        image._replace(height=2**32 - 1, width=2**32 - 1),
    ):
        with pytest.raises(ImageError):
            decode_raw(wrong)
    np.testing.assert_array_equal(decode_raw(image._replace(step_bytes=0)), picture(1))


def test_reasons_to_refuse_a_topic() -> None:
    def ros_image(encoding: str) -> ImageMessage:
        payload = factories.ros2_cdr(0, "", RawPixels(encoding, 1, 1, 4, b"1234"))
        return parse("sensor_msgs/msg/Image", "cdr", memoryview(payload))

    assert refusal(ros_image("16UC1"), "/thermal/image_raw") is None
    assert refusal(ros_image("bgr8"), "/camera/depth/color") is None
    assert refusal(ros_image("16UC1"), "/camera/depth/image_rect") == "it holds distances"
    assert refusal(ros_image("32FC1"), "/camera/image") == "it holds distances"
    assert refusal(ros_image("invented"), "/camera/image") == "its pixel encoding 'invented' is not known"
    assert refusal(message(b"", "16UC1; compressedDepth png"), "/camera/image") == "it holds distances"
    assert refusal(message(encoded_picture(1)), "/camera/image") is None
    with pytest.raises(ImageError, match="'invented' is not known"):
        decode(ros_image("invented"))


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".webp", ".bmp", ".tiff"])
@pytest.mark.parametrize(("size", "words"), [(0x3FF0, "megapixels"), (0x1FF0, "more pixels than its bytes")])
def test_an_image_that_claims_absurd_size_takes_no_memory(suffix: str, size: int, words: str) -> None:
    options = [cv2.IMWRITE_WEBP_QUALITY, 80] if suffix == ".webp" else []
    data = bytearray(cv2.imencode(suffix, picture(1), options)[1].tobytes())
    big, little = size.to_bytes(4, "big"), size.to_bytes(4, "little")
    at = {
        ".png": 16,
        ".jpg": data.find(b"\xff\xc0") + 5,
        ".webp": data.find(b"\x9d\x01\x2a") + 3,
        ".bmp": 18,
    }.get(suffix, 0)
    if suffix == ".tiff":
        for tag in (256, 257):  # width and height, one value each, of 16 bits or of 32
            entry = next(i for kind in (3, 4) if (i := data.find(struct.pack("<HHI", tag, kind, 1))) > 0)
            data[entry + 8 : entry + 12] = little
    else:
        claim = {".jpg": big[2:], ".webp": little[:2], ".bmp": little}.get(suffix, big) * 2
        data[at : at + len(claim)] = claim
    if suffix == ".png":
        data[29:33] = zlib.crc32(data[12:29]).to_bytes(4, "big")
    memory_before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ImageError, match=words):
        decode(message(bytes(data)))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory_before_kb < 50 << 10


def test_a_png_chunk_that_claims_absurd_size_takes_no_memory() -> None:
    data = bytearray(encoded_picture(1))
    at = data.index(b"IDAT") - 4
    data[at : at + 4] = b"\x7f\xff\xff\xf0"
    with pytest.raises(ImageError, match="cut off"):
        decode(message(bytes(data)))


def test_padding_after_a_png_is_ignored() -> None:
    assert number_of(decode(message(encoded_picture(7) + bytes(16), "png"))) == 7


def test_a_damaged_png_is_a_bad_frame_without_output(capfd: pytest.CaptureFixture[str]) -> None:
    """libpng, as OpenCV uses it, prints to stderr."""
    whole = encoded_picture(1)
    for at in range(8, len(whole)):
        damaged = bytearray(whole)
        damaged[at] ^= 0x40
        with pytest.raises(ImageError, match=r"CRC|cut off"):
            decode(message(bytes(damaged)))
    assert capfd.readouterr().err == ""


def test_a_damaged_tiff_is_a_bad_frame_without_output(caplog: pytest.LogCaptureFixture) -> None:
    """Pillow logs, and without a handler logging prints to stderr."""
    damaged = bytearray(encoded_picture(1, ".tiff"))
    at = damaged.index(struct.pack("<HHI", 277, 3, 1))  # samples per pixel
    damaged[at + 8] = 241
    with pytest.raises(ImageError):
        decode(message(bytes(damaged)))
    assert caplog.records == []


def test_video_is_known_by_its_first_bytes_and_is_no_image() -> None:
    payload = factories.ros2_cdr(0, "", b"\0\0\0\1\x67" + b"x" * 50)
    parsed = parse("sensor_msgs/msg/CompressedImage", "cdr", memoryview(payload))
    assert parsed.is_video
    with pytest.raises(ImageError, match="video"):
        decode(parsed)


def scene_jpeg(**options: Any) -> bytes:
    """A JPEG with enough detail that a changed byte of its data is likely to be noticed."""
    rng = np.random.default_rng(3)
    file = BytesIO()
    Image.fromarray(rng.integers(0, 255, (120, 160, 3), np.uint8)).save(file, "JPEG", quality=90, **options)
    return file.getvalue()


@pytest.mark.parametrize("change", ["no end", "zeros behind", "another behind", "zeros before"])
def test_a_jpeg_that_is_whole_but_untidy(change: str) -> None:
    data = scene_jpeg()
    changed = {
        "no end": data[:-2],
        "zeros behind": data + bytes(5000),
        "another behind": data + data,
        "zeros before": b"\0\0" + data,
    }[change]
    decoded = ImageDecoder().decode(message(changed))
    assert decoded.doubt is None
    np.testing.assert_array_equal(decoded.image, decode(message(data)))


@pytest.mark.parametrize("share", [0.3, 0.5, 0.9, 0.99])
@pytest.mark.parametrize("ending", [b"", b"\xff\xd9", bytes(1000)])
def test_a_cut_jpeg_is_an_image_error(share: float, ending: bytes) -> None:
    data = scene_jpeg()
    with pytest.raises(ImageError, match="cut off"):
        decode(message(data[: int(len(data) * share)] + ending))


def test_damaged_jpegs_are_doubtful_or_errors_without_output(capfd: pytest.CaptureFixture[str]) -> None:
    data, rng = scene_jpeg(), np.random.default_rng(1)
    outcomes = []
    for _ in range(20):
        damaged = bytearray(data)
        for at in rng.integers(len(data) // 3, len(data) - 10, 30):
            damaged[at] ^= 0x55
        try:
            outcomes.append(ImageDecoder().decode(message(bytes(damaged))).doubt)
        except ImageError as reason:
            outcomes.append(str(reason))
    assert all(outcomes)
    assert any("damaged: Corrupt JPEG data" in str(outcome) for outcome in outcomes)
    assert capfd.readouterr() == ("", "")


def test_a_jpeg_of_other_colours() -> None:
    """CMYK, as Pillow itself converts it."""
    file = BytesIO()
    Image.fromarray(picture(5)).convert("CMYK").save(file, "JPEG", quality=95)
    expected = np.asarray(Image.open(BytesIO(file.getvalue())).convert("RGB"))
    np.testing.assert_allclose(decode(message(file.getvalue())), expected, atol=1)


def unusual_files() -> dict[str, bytes]:
    """Files of formats and depths that no camera should send."""
    grey, rgb = picture(3)[..., 0], picture(3)
    files = {
        "grey pfm": b"Pf\n4 4\n-1.0\n" + bytes(64),
        "colour pfm": b"PF\n4 4\n-1.0\n" + bytes(192),
        "pgm of 16 bits": b"P5 2 2 65535\n" + bytes(8),
        "pam": b"P7\nWIDTH 14000\nHEIGHT 14000\nDEPTH 3\nMAXVAL 255\nTUPLTYPE RGB\nENDHDR\n" + bytes(100),
        "postscript": b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10 10\nshowpage\n",
        "jxl": b"\xff\x0a" + bytes(40),
        "float tiff": cv2.imencode(".tiff", grey.astype(np.float32))[1].tobytes(),
        "double tiff": cv2.imencode(".tiff", grey.astype(np.float64))[1].tobytes(),
        "tiff of 16-bit colours": cv2.imencode(".tiff", rgb.astype(np.uint16))[1].tobytes(),
        "hdr": cv2.imencode(".hdr", rgb.astype(np.float32))[1].tobytes(),
        "png of 16-bit colours": cv2.imencode(".png", rgb.astype(np.uint16) * 257)[1].tobytes(),
    }
    for mode in ("1", "L", "LA", "P", "RGBA", "I"):
        file = BytesIO()
        Image.fromarray(rgb).convert(mode).save(file, "TIFF")
        files[f"{mode} tiff"] = file.getvalue()
    return files


@pytest.mark.parametrize(("name", "data"), unusual_files().items())
def test_every_format_gives_rgb_or_an_image_error(
    name: str, data: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    with suppress(ImageError):
        image = decode(message(data))
        assert (image.dtype, image.ndim, image.shape[2]) == (np.uint8, 3, 3)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("depth", ["16UC1; png compressed ", "16UC1; jpeg compressed ", "32FC1; png"])
def test_compressed_depth_is_no_camera(depth: str) -> None:
    assert refusal(message(encoded_picture(1), depth), "/depth/image/compressed") == "it holds distances"


def test_pictures_on_a_depth_topic_are_a_camera() -> None:
    assert refusal(message(encoded_picture(1), "bgr8; png compressed "), "/depth/image/compressed") is None


@pytest.mark.parametrize("marker", [b"\xff\xc0", b"\xff\xc4", b"\xff\xda", b"\xff\xdb"])
def test_a_jpeg_with_a_damaged_marker_is_a_bad_frame(marker: bytes) -> None:
    """The decoder skips the segment, and then fails for want of it."""
    damaged = encoded_picture(5, ".jpg").replace(marker, b"\x7f" + marker[1:], 1)
    with pytest.raises(ImageError):
        decode(message(damaged))
