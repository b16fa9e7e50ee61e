"""Packets of video: which codec they are of, and where decoding can begin.

H.264 and H.265 are sequences of NAL units (ITU-T H.264 and H.265, Annex B), AV1 of open bitstream units.
Recorders name codecs in many ways, and wrongly, so the units decide.
"""

from __future__ import annotations

import re
from typing import Literal

from inspect_pipeline.messages.image import codec_named

KeyKind = Literal["none", "open", "closed"]

_START_CODE = b"\0\0\0\1"
_NAL_UNIT = re.compile(rb"\x00\x00\x01(?=([\s\S])([\s\S]?))")  # the first two bytes after a start code
_H264_SEQUENCE, _H264_KEY, _H264_TYPES = 7, 5, range(1, 13)
_H264_PROFILES = frozenset({66, 77, 88, 100, 110, 118, 122, 128, 138, 139, 134, 135, 144, 244, 44, 83, 86})
_H265_PARAMETERS = range(32, 35)  # VPS, SPS and PPS
_H265_KEYS, _H265_CLOSED_KEYS = range(16, 24), range(16, 21)  # IRAP; of them BLA and IDR
_AV1_SEQUENCE, _AV1_DELIMITER, _MAX_AV1_SIZE_BYTES = 1, b"\x12\0", 8
_VP8_START, _VP9_START = b"\x9d\x01\x2a", b"\x49\x83\x42"
_VP9_MARKER = 2


def codec_of(data: bytes, encoding: str, known: str | None = None) -> str | None:
    """Return the codec of a packet: h264, hevc, vp8, vp9, av1; None when it is not one of these.

    Args:
        data: the packet.
        encoding: what the message calls it.
        known: the codec of the packets before it, which holds for one that does not say by itself.
    """
    return _codec_of_units(data) or known or codec_named(encoding) or _guess_codec(data)


def _codec_of_units(data: bytes) -> str | None:
    """Return the codec of a packet that begins with what only this codec has, as key frames do."""
    annex_b = to_annex_b(data)
    if annex_b.startswith((_START_CODE, _START_CODE[1:])):
        return _codec_of_nal_units(annex_b)
    if data.startswith(_AV1_DELIMITER) and _AV1_SEQUENCE in _av1_units(data):
        return "av1"
    if data[3:6] == _VP8_START and not data[0] & 1:
        return "vp8"
    return "vp9" if _is_vp9_key_frame(data) and _VP9_START in data[1:5] else None


def _codec_of_nal_units(data: bytes) -> str | None:
    for unit in _NAL_UNIT.finditer(data):
        first, second = unit[1][0], unit[2][:1]
        if first >> 1 in _H265_PARAMETERS and not first & 1 and second == b"\1":  # of layer 0, identifier 1
            return "hevc"
        if first & 0x9F == _H264_SEQUENCE and first & 0x60 and second and second[0] in _H264_PROFILES:
            return "h264"
    return None


def _guess_codec(data: bytes) -> str | None:
    """Guess the codec of a packet without parameters or a known name, until a key frame says."""
    unit = _NAL_UNIT.search(to_annex_b(data)[:8])
    is_plausible = unit is not None and unit[1][0] < 0x80 and unit[1][0] & 31 in _H264_TYPES
    return "h264" if is_plausible else None


def to_annex_b(data: bytes) -> bytes:
    """Put start codes before the NAL units of a packet that has them, or lengths of four bytes, there.

    A length of 256 to 511 begins like a start code, so lengths that lead exactly to the end are believed.
    """
    if data.startswith(_START_CODE):
        return data
    units, at = [], 0
    while at < len(data):
        length = int.from_bytes(data[at : at + 4])
        units.append(data[at + 4 : at + 4 + length])
        at += 4 + length
        if not length:
            return data
    return b"".join(_START_CODE + unit for unit in units) if at == len(data) else data


def key_of(data: bytes, codec: str) -> KeyKind:
    """Return whether decoding can begin at a packet; no packet after a closed key depends on one before."""
    if codec == "vp8":
        return "closed" if data and not data[0] & 1 else "none"
    if codec == "vp9":
        return "closed" if _is_vp9_key_frame(data) else "none"
    if codec == "av1":
        return "closed" if _AV1_SEQUENCE in _av1_units(data) else "none"
    heads = [match[1][0] for match in _NAL_UNIT.finditer(data)]
    if codec == "hevc":
        kinds = {head >> 1 & 0x3F for head in heads}
        is_key, is_closed = kinds & set(_H265_KEYS), kinds & set(_H265_CLOSED_KEYS)
    else:
        kinds = {head & 0x1F for head in heads}
        is_key, is_closed = kinds & {_H264_SEQUENCE, _H264_KEY}, kinds & {_H264_KEY}
    return "closed" if is_closed else "open" if is_key else "none"


def _is_vp9_key_frame(data: bytes) -> bool:
    """Read the uncompressed header: marker, profile, show_existing_frame, frame_type (VP9 6.2)."""
    head = data[0] if data else 0
    n_before = 5 if head >> 4 & 3 == 3 else 4
    return head >> 6 == _VP9_MARKER and not head >> (7 - n_before) & 1 and not head >> (6 - n_before) & 1


def _av1_units(data: bytes) -> set[int]:
    """Return the types of the open bitstream units of a packet (AV1 5.3)."""
    types, at = set(), 0
    while at < len(data):
        head = data[at]
        types.add(head >> 3 & 15)
        at += 2 if head & 4 else 1
        if not head & 2:
            break
        size = shift = 0
        for byte in data[at : at + _MAX_AV1_SIZE_BYTES]:
            size |= (byte & 0x7F) << shift
            at, shift = at + 1, shift + 7
            if byte < 0x80:
                break
        at += size
    return types
