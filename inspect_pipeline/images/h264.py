"""Find missing pictures of H.264 streams from the headers of their packets.

FFmpeg decodes a picture whose reference is missing without an error, and returns it smeared. The numbers of
reference pictures (frame_num, ITU-T H.264 7.4.3) show the gap.
"""

from __future__ import annotations

import re
from typing import NamedTuple

_UNIT = re.compile(rb"\x00\x00\x01([\s\S])(?=([\s\S]{0,64}))")  # no header is longer
_STUFFED = re.compile(rb"\x00\x00\x03")
_SLICE, _KEY_SLICE, _SEQUENCE = 1, 5, 7
_MAX_FRAME_NUM_BITS = 16
_PROFILES_WITH_CHROMA = frozenset({100, 110, 122, 244, 44, 83, 86, 118, 128, 138, 139, 134, 135})


class _Sequence(NamedTuple):
    """What a sequence parameter set says about frame_num; `is_gap_allowed` where gaps are intended."""

    frame_num_bits: int
    has_colour_planes: bool
    is_gap_allowed: bool


class GapFinder:
    """Compares the packets of a stream, which must all be passed in order."""

    def __init__(self) -> None:
        self._sequence: _Sequence | None = None
        self._last_frame_num: int | None = None  # of the last reference picture

    def is_after_gap(self, packet: bytes) -> bool:
        """Whether a reference picture is missing between a packet of Annex B and those before."""
        for unit in _UNIT.finditer(packet):
            head, bits = unit[1][0], _Bits(_STUFFED.sub(b"\0\0", unit[2]))
            try:
                if head & 31 == _SEQUENCE:
                    self._sequence = _parse_sequence(bits)
                elif head & 31 in {_SLICE, _KEY_SLICE} and self._sequence:
                    return self._note(head, _parse_frame_num(bits, self._sequence), self._sequence)
            except IndexError:  # damaged, as the decoder will report
                return False
        return False

    def _note(self, head: int, frame_num: int, sequence: _Sequence) -> bool:
        last, is_key = self._last_frame_num, head & 31 == _KEY_SLICE
        if head >> 5 & 3:
            self._last_frame_num = frame_num
        if is_key or last is None or sequence.is_gap_allowed:
            return False
        return frame_num not in {last, (last + 1) % (1 << sequence.frame_num_bits)}


class _Bits:
    """Reads bits, the highest of a byte first. Raises IndexError at the end."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def take(self, count: int) -> int:
        value = 0
        for _ in range(count):
            value = value << 1 | self._data[self._at >> 3] >> (7 - (self._at & 7)) & 1
            self._at += 1
        return value

    def take_ue(self) -> int:
        """Read an unsigned Exp-Golomb number."""
        n_zeros = 0
        while not self.take(1):
            n_zeros += 1
        return (1 << n_zeros) - 1 + self.take(n_zeros)

    def take_se(self) -> int:
        """Read a signed Exp-Golomb number."""
        value = self.take_ue()
        return (value + 1) // 2 if value & 1 else -(value // 2)


def _parse_frame_num(bits: _Bits, sequence: _Sequence) -> int:
    for _ in ("first macroblock", "type", "picture parameter set"):
        bits.take_ue()
    if sequence.has_colour_planes:
        bits.take(2)
    return bits.take(sequence.frame_num_bits)


def _parse_sequence(bits: _Bits) -> _Sequence:
    profile = bits.take(8)
    bits.take(16)  # constraints, level
    bits.take_ue()  # its own number
    has_colour_planes = _skip_chroma(bits) if profile in _PROFILES_WITH_CHROMA else False
    frame_num_bits = bits.take_ue() + 4
    if frame_num_bits > _MAX_FRAME_NUM_BITS:
        raise IndexError("damaged")
    _skip_order(bits)
    bits.take_ue()  # number of reference pictures
    return _Sequence(frame_num_bits, has_colour_planes, bool(bits.take(1)))


def _skip_chroma(bits: _Bits) -> bool:
    """Skip chroma format, bit depths and scaling lists; return whether colours are coded separately."""
    chroma_format = bits.take_ue()
    has_colour_planes = bool(bits.take(1)) if chroma_format == 3 else False
    bits.take_ue(), bits.take_ue()  # bit depths
    bits.take(1)
    if bits.take(1):
        for i in range(12 if chroma_format == 3 else 8):
            if bits.take(1):
                _skip_scaling_list(bits, 16 if i < 6 else 64)
    return has_colour_planes


def _skip_scaling_list(bits: _Bits, size: int) -> None:
    last = following = 8
    for _ in range(size):
        if following:
            following = (last + bits.take_se()) % 256
        last = following or last


def _skip_order(bits: _Bits) -> None:
    """Skip the picture order count."""
    kind = bits.take_ue()
    if kind == 0:
        bits.take_ue()
    elif kind == 1:
        bits.take(1)
        bits.take_se(), bits.take_se()
        for _ in range(bits.take_ue()):
            bits.take_se()
