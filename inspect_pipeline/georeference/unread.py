"""Why topics that seem to hold positions or attitudes are not used."""

from __future__ import annotations

import re
from itertools import islice
from typing import TYPE_CHECKING

from inspect_pipeline.messages.errors import MALFORMED
from inspect_pipeline.messages.pose import is_setpoint, parser_for
from inspect_pipeline.recording.frames import iter_channel_messages

if TYPE_CHECKING:
    from collections.abc import Mapping

    from inspect_pipeline.recording.reader import Recording
    from inspect_pipeline.recording.types import ChannelSummary

_N_MESSAGES = 200  # of a topic are looked at
_ALIKE = re.compile(
    r"navsat|locationfix|pose|odom|tfmessage|transform|imu$|attitude|position|gps", re.IGNORECASE
)
_OTHERS = re.compile(r"setpoint|command|status|control|limits|array|list", re.IGNORECASE)
_FIX = re.compile(r"fix|gps|position", re.IGNORECASE)


def explain_unread_poses(recording: Recording) -> Mapping[str, str]:
    """Return a reason by topic for each that by its schema has poses, of which none can be used.

    Raises RecordingError when chunks cannot be read of a `strict` recording.
    """
    reasons = {}
    for channel in recording.channels:
        if channel.message_count != 0 and (reason := _reason(recording, channel)):
            reasons[channel.topic] = reason
    return reasons


def _reason(recording: Recording, channel: ChannelSummary) -> str | None:
    """Say why no pose comes out of a channel; None when one does, or when it does not seem to have any."""
    schema_data = recording.schema_data(channel.channel_id)
    parse = parser_for(channel.topic, channel.schema_name, schema_data, channel.message_encoding)
    if parse is None:
        name = re.split(r"[/.:]", channel.schema_name)[-1]
        is_alike = _ALIKE.search(name) and not _OTHERS.search(name)
        if is_alike and is_setpoint(channel.topic):
            return "by its topic it is not where the vehicle is"
        return f"{channel.schema_name} in {channel.message_encoding} is not read" if is_alike else None
    n_malformed = n_messages = 0
    for message in islice(iter_channel_messages(recording, {channel.channel_id}), _N_MESSAGES):
        n_messages += 1
        try:
            if parse(message.data):
                return None
        except MALFORMED:
            n_malformed += 1
    if n_malformed == n_messages:
        return f"its messages are not {channel.schema_name}" if n_messages else None
    if _FIX.search(channel.schema_name):
        return "none of its first messages has a valid position"
    return "its frames are not among those that are read"
