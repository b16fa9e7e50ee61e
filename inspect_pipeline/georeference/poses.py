"""Positions and attitudes of a recording at any time.

    track = read_poses(recording)
    pose = track.at(frame.log_time_ns)      # the last known one, with its age

Messages are joined to frames by log time, which all channels share.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from inspect_pipeline.geometry.attitude import Attitude, Position, from_quaternions, to_turns, wrapped_deg
from inspect_pipeline.georeference.samples import PoseSample, PoseSamples, SampleRows, longest
from inspect_pipeline.georeference.transforms import Chain, TransformTree
from inspect_pipeline.messages.errors import MALFORMED
from inspect_pipeline.messages.pose import Transform, parser_for
from inspect_pipeline.recording.frames import iter_channel_messages

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from inspect_pipeline.georeference.calibration import LensReader
    from inspect_pipeline.messages.pose import Parser
    from inspect_pipeline.recording.merge import Message
    from inspect_pipeline.recording.reader import Recording


@dataclass(frozen=True, slots=True)
class Pose:
    """The last known position and attitude at a time; what is not known is None.

    Positions are WGS 84. altitude_m is above the datum of the source, mostly the ellipsoid (GNSS) or the sea
    level (EXIF, PX4). Yaw is clockwise from north and pitch positive upwards, so a camera that looks straight
    down has -90; both are those of `attitude_of`. age_ms is the age of the oldest part. heading_deg is the
    yaw of the vehicle. height_m is above the origin of the coordinate frame of the attitude, by convention on
    the ground.
    """

    latitude_deg: float | None
    longitude_deg: float | None
    altitude_m: float | None
    yaw_deg: float | None
    pitch_deg: float | None
    roll_deg: float | None
    attitude_of: Literal["camera", "vehicle"] | None
    age_ms: float
    heading_deg: float | None = None
    height_m: float | None = None


@dataclass(frozen=True, slots=True)
class PoseTrack:
    """The poses of a flight; each quantity is read from the channel with the most samples.

    losses: what could not be read of the recording.
    positions: latitude_deg, longitude_deg, altitude_m (NaN where unknown). vehicle: yaw_deg, pitch_deg,
    roll_deg. camera: the same, and 1 where the yaw counts from that of the vehicle. heights: height_m.
    """

    positions: PoseSamples
    vehicle: PoseSamples
    camera: PoseSamples
    heights: PoseSamples = field(default_factory=PoseSamples)
    losses: tuple[str, ...] = ()

    def at(self, time_ns: int) -> Pose | None:
        """Return the pose at a log time; None before the first message."""
        position = self.positions.last_at(time_ns)
        attitude, attitude_of = self._attitude_at(time_ns)
        vehicle, height = self.vehicle.last_at(time_ns), self.heights.last_at(time_ns)
        ages_ms = [sample.age_ms for sample in (position, attitude) if sample]
        if not ages_ms:
            return None
        latitude_deg, longitude_deg, altitude_m = position.values if position else (None, None, None)
        yaw_deg, pitch_deg, roll_deg = attitude.values if attitude else (None, None, None)
        return Pose(
            latitude_deg=latitude_deg,
            longitude_deg=longitude_deg,
            altitude_m=None if altitude_m is None or np.isnan(altitude_m) else altitude_m,
            yaw_deg=yaw_deg,
            pitch_deg=pitch_deg,
            roll_deg=roll_deg,
            attitude_of=attitude_of,
            age_ms=max(ages_ms),
            heading_deg=vehicle.values[0] if vehicle else None,
            height_m=height.values[0] if height else None,
        )

    def _attitude_at(self, time_ns: int) -> tuple[PoseSample | None, Literal["camera", "vehicle"] | None]:
        """Return the attitude of the camera relative to north, else that of the vehicle."""
        vehicle, camera = self.vehicle.last_at(time_ns), self.camera.last_at(time_ns)
        if camera:
            yaw_deg, pitch_deg, roll_deg, is_yaw_relative = camera.values
            if not is_yaw_relative:
                return PoseSample([yaw_deg, pitch_deg, roll_deg], camera.age_ms), "camera"
            if vehicle:
                yaw_deg = float(wrapped_deg(vehicle.values[0] + yaw_deg))
                age_ms = max(camera.age_ms, vehicle.age_ms)
                return PoseSample([yaw_deg, pitch_deg, roll_deg], age_ms), "camera"
        return vehicle, "vehicle" if vehicle else None


def read_poses(recording: Recording, lenses: LensReader | None = None) -> PoseTrack:
    """Return the poses of a recording; an empty track when it has none.

    Messages that cannot be parsed are skipped. Raises RecordingError when chunks cannot be read of a `strict`
    recording; otherwise they are in the track's losses. The messages of `lenses` are read on the same way.
    """
    parsers = _parsers(recording)
    lens_ids = lenses.channel_ids if lenses else frozenset()
    messages = iter_channel_messages(recording, parsers.keys() | lens_ids)
    found = _read_kinds(_pass_on(messages, lenses) if lenses else messages, parsers)
    return PoseTrack(
        positions=longest(found["position"]),
        vehicle=_to_turns(longest(found["vehicle"] or found["fallback"])),
        camera=_to_turns(longest(found["camera"]), with_yaw_frame=True),
        heights=longest(found["height"]),
        losses=messages.losses,
    )


def _pass_on(messages: Iterable[Message], lenses: LensReader) -> Iterator[Message]:
    """Yield all messages except calibrations, which are added to `lenses`."""
    for message in messages:
        if message.channel_id in lenses.channel_ids:
            lenses.add(message)
        else:
            yield message


def _parsers(recording: Recording) -> dict[int, Parser]:
    """Return the parser of each channel of positions or attitudes, by channel id."""
    found = {}
    for channel in recording.channels:
        parser = parser_for(
            channel.topic,
            channel.schema_name,
            recording.schema_data(channel.channel_id),
            channel.message_encoding,
        )
        if parser:
            found[channel.channel_id] = parser
    return found


def _read_kinds(messages: Iterable[Message], parsers: dict[int, Parser]) -> dict[str, list[PoseSamples]]:
    """Return the samples of each kind, one element per channel or chain of transforms."""
    kinds: dict[str, dict[int, SampleRows]] = defaultdict(lambda: defaultdict(SampleRows))
    tree = TransformTree()
    for message in messages:
        channel_id, time_ns = message.channel_id, message.log_time_ns
        try:
            items = parsers[channel_id](message.data)
        except MALFORMED:
            continue
        for item in items:
            if isinstance(item, Transform):
                tree.add(channel_id, time_ns, item)
            elif isinstance(item, Position):
                kinds["position"][channel_id].append(time_ns, *item)
            else:
                _add_attitude(kinds, channel_id, time_ns, item)
    samples = defaultdict(
        list, {kind: [rows.to_samples() for rows in channels.values()] for kind, channels in kinds.items()}
    )
    for chain in tree.chains():
        _add_chain(samples, chain)
    return samples


def _add_attitude(
    kinds: dict[str, dict[int, SampleRows]], channel_id: int, time_ns: int, attitude: Attitude
) -> None:
    kind = "camera" if attitude.is_camera else "fallback" if attitude.is_fallback else "vehicle"
    own = attitude.is_ned, attitude.is_yaw_relative
    kinds[kind][channel_id].append(time_ns, *attitude.rotation, *own)
    if attitude.height_m is not None:
        kinds["height"][channel_id].append(time_ns, attitude.height_m)


def _add_chain(samples: dict[str, list[PoseSamples]], chain: Chain) -> None:
    """Add the attitude and height of a chain; a frame at the origin all the time says nothing of height."""
    times_ns, places = chain.places.times_ns, chain.places.values
    has_height = np.ones(len(times_ns), bool) if chain.role == "position" else places.any(axis=1)
    samples["height"].append(PoseSamples(times_ns[has_height], places[has_height, 2:]))
    if chain.role != "position":
        kind = "vehicle" if chain.role == "vehicle" else "camera"
        in_enu = np.zeros((len(times_ns), 2))  # neither NED nor relative
        samples[kind].append(PoseSamples(times_ns, np.hstack((chain.rotations.values, in_enu))))


def _to_turns(quaternions: PoseSamples, *, with_yaw_frame: bool = False) -> PoseSamples:
    """Turn the columns w, x, y, z, is_ned, is_yaw_relative into yaw_deg, pitch_deg, roll_deg.

    with_yaw_frame: keep is_yaw_relative as the fourth column.
    """
    if not len(quaternions.times_ns):
        return quaternions
    is_ned, is_yaw_relative = quaternions.values[:, 4] > 0, quaternions.values[:, 5:]
    turns = np.empty((len(is_ned), 3))
    for convention in (False, True):
        chosen = is_ned == convention
        if chosen.any():
            turns[chosen] = to_turns(from_quaternions(quaternions.values[chosen, :4], is_ned=convention))
    return PoseSamples(quaternions.times_ns, np.hstack((turns, is_yaw_relative)) if with_yaw_frame else turns)
