"""`lsnet-pipe info`."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from inspect_pipeline.errors import printable

if TYPE_CHECKING:
    from collections.abc import Iterator

    from inspect_pipeline.georeference.poses import PoseTrack
    from inspect_pipeline.recording.reader import Recording


def info(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="A recording (MCAP), or the folder of a split one.")
    ],
) -> None:
    """Show the content of a recording.

    The last line says which cameras `process` would use.

    \b
    Examples:
      lsnet-pipe info flight.mcap
    """
    from inspect_pipeline.recording.reader import open_recording

    for line in _describe(open_recording(file)):
        typer.echo(printable(line))


def _describe(recording: Recording) -> Iterator[str]:
    counts = recording.message_counts()
    if len(recording.parts) == 1:
        yield f"file      {recording.path} ({recording.size_bytes:,} bytes)"
    else:
        parts = f"{len(recording.parts)} parts, {recording.size_bytes:,} bytes"
        yield f"{'folder' if recording.path.is_dir() else 'file':<9} {recording.path} ({parts})"
        for part in recording.parts:
            where = f" from byte {part.start:,}" if part.start else ""
            yield f"  {part.path.name}{where}: {part.size_bytes:,} bytes"
    yield f"flight    {recording.flight_id}"
    usual = recording.usual_times(recording.camera_channels)
    start_ns, end_ns = max(recording.start_ns, usual.first_ns), min(recording.end_ns, usual.last_ns)
    if counts:
        yield f"time      {_to_utc(start_ns)} to {_to_utc(end_ns)} UTC"
        yield f"duration  {(end_ns - start_ns) / 1e9:.1f} s"
    yield f"profile   {recording.profile or 'none'}"
    yield f"channels  {len(recording.channels)}"
    for channel in recording.channels:
        schema = f"{channel.schema_name or 'no schema'}, {channel.message_encoding or 'no encoding'}"
        yield f"  {channel.topic}: {counts[channel.channel_id]:,} messages ({schema})"
    yield from _describe_poses(recording)
    for topic, reason in recording.refusals.items():
        yield f"no camera {topic}: {reason}"
    for warning in recording.warnings:
        yield f"odd       {warning}"
    if (start_ns, end_ns) != (recording.start_ns, recording.end_ns):
        yield "odd       a few log times are far from all others: such images are set aside"
    for loss in (*recording.losses, *recording.identity.losses):
        yield f"damaged   {loss}"
    yield f"process   {_intention(recording)}"


def _describe_poses(recording: Recording) -> Iterator[str]:
    from inspect_pipeline.georeference.calibration import LensReader
    from inspect_pipeline.georeference.poses import read_poses
    from inspect_pipeline.georeference.unread import explain_unread_poses

    reader = LensReader(recording)
    track = read_poses(recording, reader)
    lenses = reader.lenses()
    counts = {
        "positions": len(track.positions.times_ns),
        "attitudes of the camera": len(track.camera.times_ns),
        "attitudes of the vehicle": len(track.vehicle.times_ns),
    }
    if any(counts.values()):
        yield f"poses     {', '.join(f'{count:,} {what}' for what, count in counts.items() if count)}"
    for topic, reason in explain_unread_poses(recording).items():
        yield f"no pose   {topic}: {reason}"
    missing = list(_missing_of(track))
    for camera in recording.camera_channels:
        if camera.channel_id not in lenses:
            missing.append(f"lens of {camera.topic} unknown (--view)")
        else:
            lens = lenses[camera.channel_id].lenses[0]
            height, width = lens.image_size
            fx, fy = lens.focal_px
            yield f"lens      {camera.topic}: {width}x{height}, focal length {fx:.1f} x {fy:.1f} px"
    if missing:
        yield f"spans     cannot be judged: {', '.join(dict.fromkeys(missing))}"


def _missing_of(track: PoseTrack) -> Iterator[str]:
    """Yield what coverage and rules about spans need and the poses lack, with the option that gives it."""
    if not len(track.positions.times_ns):
        yield "position unknown"
    elif not len(track.heights.times_ns):
        yield "height above ground unknown (--ground-alt)"
    if not len(track.camera.times_ns):
        yield "camera attitude unknown"


def _intention(recording: Recording) -> str:
    if recording.is_annotated_copy:
        return "nothing: this is an annotated copy"
    if not recording.camera_channels:
        return "nothing: there is no camera topic"
    return ", ".join(dict.fromkeys(camera.topic for camera in recording.camera_channels))


def _to_utc(time_ns: int) -> str:
    return f"{datetime.fromtimestamp(time_ns // 10**9, UTC):%Y-%m-%d %H:%M:%S}"
