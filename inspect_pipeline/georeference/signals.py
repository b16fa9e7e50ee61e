"""Numbers of other topics at the times of frames, such as the charge of the battery.

A path names a topic and a field of its messages: /battery.percentage, /imu.angular_velocity.z, /esc.rpm[2].
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from numbers import Real
from typing import TYPE_CHECKING, NamedTuple

from inspect_pipeline.georeference.samples import PoseSamples, SampleRows
from inspect_pipeline.messages.errors import MALFORMED
from inspect_pipeline.messages.fields import decoder_for, value_at
from inspect_pipeline.recording.frames import iter_channel_messages

if TYPE_CHECKING:
    from collections.abc import Mapping

    from inspect_pipeline.messages.fields import Decoder
    from inspect_pipeline.recording.reader import Recording

_MAX_AGE_MS = 10_000.0  # of a value; older ones are not used for a frame
_STEPS = re.compile(r"(\.[^.\[\]]+|\[\d+\])+")
_STEP = re.compile(r"\.([^.\[\]]+)|\[(\d+)\]")


@dataclass(frozen=True, slots=True)
class Signals:
    """Values over time of each signal; warnings and losses are a phrase each."""

    samples: Mapping[str, PoseSamples] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    losses: tuple[str, ...] = ()

    def at(self, time_ns: int) -> dict[str, float | None]:
        """Return the last value of each signal at a log time, None where it is missing or too old."""
        found = {name: samples.last_at(time_ns) for name, samples in self.samples.items()}
        return {
            name: sample.values[0] if sample and sample.age_ms <= _MAX_AGE_MS else None
            for name, sample in found.items()
        }


class _Place(NamedTuple):
    """A field of the messages of a topic."""

    topic: str
    steps: tuple[str | int, ...]


def read_signals(recording: Recording, paths: Mapping[str, str]) -> Signals:
    """Read the values of signals, given by name and path.

    Raises RecordingError when chunks cannot be read of a `strict` recording.
    """
    if not paths:
        return Signals()
    topics = sorted({channel.topic for channel in recording.channels}, key=len, reverse=True)
    places = {name: _find_place(path, topics) for name, path in paths.items()}
    rows = {name: SampleRows() for name in paths}
    decoders = _decoders(recording, {place.topic for place in places.values() if place})
    messages = iter_channel_messages(recording, decoders.keys())
    for message in messages:
        topic, decode = decoders[message.channel_id]
        try:
            fields = decode(message.data)
        except MALFORMED:
            continue
        for name, place in places.items():
            if place and place.topic == topic and (value := _number_at(fields, place)) is not None:
                rows[name].append(message.log_time_ns, value)
    samples = {name: row.to_samples() for name, row in rows.items()}
    read = {topic for topic, _ in decoders.values()}
    empty = [name for name in paths if not len(samples[name])]
    warnings = [f"signal {name}: {_why_empty(paths[name], places[name], read)}" for name in empty]
    return Signals(samples, tuple(warnings), messages.losses)


def _find_place(path: str, topics: list[str]) -> _Place | None:
    """Split a path at the longest topic it begins with."""
    for topic in topics:
        rest = path.removeprefix(topic)
        if rest != path and _STEPS.fullmatch(rest):
            steps = tuple(int(index) if index else name for name, index in _STEP.findall(rest))
            return _Place(topic, steps)
    return None


def _decoders(recording: Recording, topics: set[str]) -> dict[int, tuple[str, Decoder]]:
    """Return topic and decoder of the channels of some topics, by channel id."""
    found = {}
    for channel in recording.channels:
        if channel.topic in topics:
            schema = recording.schema_data(channel.channel_id)
            if decode := decoder_for(channel.schema_name, schema, channel.message_encoding):
                found[channel.channel_id] = channel.topic, decode
    return found


def _number_at(fields: object, place: _Place) -> float | None:
    try:
        value = value_at(fields, place.steps)
    except MALFORMED:
        return None
    return float(value) if isinstance(value, Real) and math.isfinite(value) else None


def _why_empty(path: str, place: _Place | None, read: set[str]) -> str:
    if place is None:
        return f"no topic of the recording is at the beginning of {path}"
    if place.topic not in read:
        return f"the messages of {place.topic} are in an encoding that is not read"
    return f"no message of {place.topic} has a number at {path.removeprefix(place.topic)}"
