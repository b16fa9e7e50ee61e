"""Codecs are recognized by the units of a packet."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from inspect_pipeline.images.codec import codec_of, key_of
from inspect_pipeline.images.decode import refusal
from inspect_pipeline.images.video import VideoDecoder
from inspect_pipeline.messages.image import ImageMessage

av = pytest.importorskip("av")
ENCODERS = {
    "h264": ("libx264", {"tune": "zerolatency", "preset": "ultrafast"}),
    "hevc": ("libx265", {"x265-params": "bframes=0:repeat-headers=1:log-level=none"}),
    "vp8": ("libvpx", {"deadline": "realtime", "lag-in-frames": "0"}),
    "vp9": ("libvpx-vp9", {"deadline": "realtime", "lag-in-frames": "0"}),
    "mpeg4": ("mpeg4", {}),
    "mpeg2": ("mpeg2video", {"bf": "0"}),
}


def packets(codec: str, count: int = 4) -> list[bytes]:
    name, options = ENCODERS[codec]
    encoder = av.CodecContext.create(name, "w")
    encoder.width, encoder.height, encoder.pix_fmt = 128, 96, "yuv420p"
    encoder.time_base, encoder.framerate, encoder.options = Fraction(1, 25), Fraction(25), options
    found = []
    for i in range(count):
        frame = av.VideoFrame.from_ndarray(np.full((96, 128, 3), 60 + 20 * i, np.uint8), format="rgb24")
        frame.pts = i
        found += [bytes(packet) for packet in encoder.encode(frame)]
    return found + [bytes(packet) for packet in encoder.encode(None)]


@pytest.mark.parametrize("codec", ["h264", "hevc", "vp8", "vp9"])
@pytest.mark.parametrize("name", ["h264", "h265", "", "mp4v", "video"])
def test_the_units_outrank_the_name(codec: str, name: str) -> None:
    decoder, data = VideoDecoder(), packets(codec)
    assert codec_of(data[0], name) == codec
    assert key_of(data[0], codec) != "none"
    for number, packet in enumerate(data):
        decoder.add(number, ImageMessage(0, "", name, packet, is_video=True), is_wanted=True)
    decoder.finish()
    means = [decoder.take(number).to_rgb().mean() for number in range(4)]
    assert means == pytest.approx([60, 80, 100, 120], abs=6)


@pytest.mark.parametrize("codec", ["mpeg4", "mpeg2"])
def test_a_codec_that_is_not_known_is_refused(codec: str) -> None:
    message = ImageMessage(0, "", codec, packets(codec)[0], is_video=True)
    assert refusal(message, "/camera") == f"its video codec {codec!r} is not known"
