"""Why topics that seem to hold positions or attitudes are not used."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from inspect_pipeline.messages.errors import MALFORMED
from inspect_pipeline.messages.pose import is_setpoint, parser_for
from inspect_pipeline.recording.frames import iter_channel_messages

if TYPE_CHECKING:
    from collections.abc import Mapping

    from inspect_pipeline.messages.pose import Parser
    from inspect_pipeline.recording.reader import Recording
    from inspect_pipeline.recording.types import ChannelSummary

_N_MESSAGES = 200  # number of messages examined per topic
_ALIKE = re.compile(
    r"navsat|locationfix|pose|odom|tfmessage|transform|imu$|attitude|position|gps", re.IGNORECASE
)
_OTHERS = re.compile(r"setpoint|command|status|control|limits|array|list", re.IGNORECASE)
_FIX = re.compile(r"fix|gps|position", re.IGNORECASE)


def explain_unread_poses(recording: Recording) -> Mapping[str, str]:
    """Return a reason by topic for each that by its schema has poses, of which none can be used.

    Raises RecordingError when chunks cannot be read of a `strict` recording.
    """
    reasons, parsers = {}, {}
    for channel in recording.channels:
        schema_data = recording.schema_data(channel.channel_id)
        parser = parser_for(channel.topic, channel.schema_name, schema_data, channel.message_encoding)
        if parser:
            parsers[channel.channel_id] = parser
        elif channel.message_count != 0 and (reason := _explain_unknown(channel)):
            reasons[channel.topic] = reason
    tried = _try_parsers(recording, parsers)
    for channel in recording.channels:
        if (counts := tried.get(channel.channel_id)) and counts.n_messages:
            reasons[channel.topic] = _explain_unused(channel, counts)
    return dict(sorted(reasons.items()))


def _explain_unknown(channel: ChannelSummary) -> str | None:
    """Return why there is no parser for a channel; None when it does not seem to have poses."""
    name = re.split(r"[/.:]", channel.schema_name)[-1]
    if not _ALIKE.search(name) or _OTHERS.search(name):
        return None
    if is_setpoint(channel.topic):
        return "by its topic it is not where the vehicle is"
    return f"{channel.schema_name} in {channel.message_encoding} is not read"


def _explain_unused(channel: ChannelSummary, counts: _Counts) -> str:
    """Return why the messages of a channel give no pose."""
    if counts.n_malformed == counts.n_messages:
        return f"its messages are not {channel.schema_name}"
    if _FIX.search(channel.schema_name):
        return "none of its first messages has a valid position"
    return "its frames are not among those that are read"


@dataclass(slots=True)
class _Counts:
    """Messages of a channel without a pose, and those of them that cannot be parsed."""

    n_messages: int = 0
    n_malformed: int = 0


def _try_parsers(recording: Recording, parsers: Mapping[int, Parser]) -> Mapping[int, _Counts]:
    """Parse the first messages of channels in one pass, and return the counts of those that give no pose."""
    counts = {channel_id: _Counts() for channel_id in parsers}
    undecided = set(parsers)
    for message in iter_channel_messages(recording, parsers.keys()):
        channel_id = message.channel_id
        if channel_id not in undecided:
            continue
        counts[channel_id].n_messages += 1
        try:
            has_pose = bool(parsers[channel_id](message.data))
        except MALFORMED:
            has_pose = False
            counts[channel_id].n_malformed += 1
        if has_pose:
            del counts[channel_id]
        if has_pose or counts[channel_id].n_messages == _N_MESSAGES:
            undecided.remove(channel_id)
        if not undecided:
            break
    return counts
