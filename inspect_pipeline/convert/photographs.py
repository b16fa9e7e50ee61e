"""Make a recording of a folder of photographs: one topic a camera, the files as they are."""

from __future__ import annotations

import re
import statistics
from datetime import UTC, timedelta
from typing import TYPE_CHECKING

from inspect_pipeline.convert.exif import CameraKey, PhotographTags, read_tags
from inspect_pipeline.convert.messages import CAMERA_FRAME, PackResult, write_lens, write_pose
from inspect_pipeline.convert.times import to_ns
from inspect_pipeline.errors import RecordingError
from inspect_pipeline.recording.writer import new_recording

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence
    from datetime import tzinfo
    from pathlib import Path

    from inspect_pipeline.recording.writer import RecordingAuthor

_STEP_NS = 1_000  # between photographs of one time: stamps must differ, and SQL keeps microseconds
_OTHER_PICTURES = frozenset(
    {".tif", ".tiff", ".dng", ".heic", ".heif", ".png", ".webp", ".raw", ".arw", ".nef"}
)
_ZONE_STEP = timedelta(minutes=15)


def pack_photographs(folder: Path, target: Path, zone: tzinfo | None = None) -> PackResult:
    """Make a recording of the JPEGs of a folder and the folders below it, in the order of their times.

    The time of a photograph is the camera's clock, moved to UTC by the offset in its EXIF, else by `zone`,
    else by the offset most photographs have, else by their GPS times, else it is taken for UTC.

    Raises:
        RecordingError: there is no JPEG with a time.
        OSError: a file cannot be read, or the target cannot be written.
    """
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in {".jpg", ".jpeg"})
    found = {path: read_tags(path) for path in paths}
    tags_by_path = {path: tags for path, tags in found.items() if tags and tags.clock}
    if not tags_by_path:
        raise RecordingError(folder, *_why_none(folder, len(paths)))
    all_tags = list(tags_by_path.values())
    usual_zone = zone if zone is not None else _usual_zone(all_tags)
    times_ns = {path: _time_ns(tags, usual_zone) for path, tags in tags_by_path.items()}
    prefixes = _topic_prefixes({tags.camera for tags in all_tags})
    before_ns = 0
    with new_recording(target) as author:
        for path in sorted(times_ns, key=lambda path: (times_ns[path], path)):
            before_ns = time_ns = max(times_ns[path], before_ns + _STEP_NS)
            tags = tags_by_path[path]
            _write_photograph(author, prefixes[tags.camera], time_ns, path, tags)
    counts = {
        "images": len(all_tags),
        "cameras": len(prefixes),
        "positions": sum(tags.position is not None for tags in all_tags),
        "attitudes": sum(tags.gimbal is not None for tags in all_tags),
    }
    if len(prefixes) == 1:
        del counts["cameras"]
    return PackResult(counts, (*_left_out(found, tags_by_path), *_bad_xmp(tags_by_path)))


def _why_none(folder: Path, n_jpegs: int) -> tuple[str, str]:
    """Return why there is nothing to pack in a folder, and what to do."""
    if n_jpegs:
        which = "its JPEG does not say" if n_jpegs == 1 else f"none of its {n_jpegs:,} JPEGs says"
        return f"{which} when it was taken", "set the EXIF tag DateTimeOriginal"
    others = {path.suffix.lower() for path in folder.rglob("*")} & _OTHER_PICTURES
    if others:
        kinds = ", ".join(sorted(others))
        return f"it has pictures ({kinds}) but no JPEG", "convert them to JPEG, keeping their EXIF"
    return "it has no MCAP file and no JPEG", "name another folder"


def _left_out(found: Mapping[Path, PhotographTags | None], used: Collection[Path]) -> list[str]:
    return [
        f"{path} {'does not say when it was taken' if tags else 'cannot be read'}, it is left out"
        for path, tags in found.items()
        if path not in used
    ]


def _bad_xmp(tags_by_path: Mapping[Path, PhotographTags]) -> list[str]:
    return [
        f"{path}: its XMP is damaged, gimbal angles and height are missing"
        for path, tags in tags_by_path.items()
        if tags.has_bad_xmp
    ]


def _time_ns(tags: PhotographTags, usual_zone: tzinfo | timedelta) -> int:
    assert tags.clock is not None  # noqa: S101 - those without were left out
    return to_ns(tags.clock, usual_zone if tags.zone is None else tags.zone)


def _usual_zone(photographs: Sequence[PhotographTags]) -> timedelta:
    """How far the cameras' clocks are ahead of UTC: by EXIF, else by GPS to a quarter of an hour, else 0."""
    zones = [tags.zone for tags in photographs if tags.zone is not None]
    if zones:
        return statistics.mode(zones)
    ahead = [
        round((tags.clock.replace(tzinfo=UTC) - tags.gps_clock) / _ZONE_STEP)
        for tags in photographs
        if tags.clock and tags.gps_clock
    ]
    return statistics.mode(ahead) * _ZONE_STEP if ahead else timedelta()


def _topic_prefixes(cameras: Collection[CameraKey]) -> dict[CameraKey, str]:
    """Name the topics of each camera: /camera for the only one, else by as few words as distinguish them."""
    if len(cameras) == 1:
        return dict.fromkeys(cameras, "/camera")
    parts: list[Callable[[CameraKey], str]] = [
        lambda camera: camera.lens,
        lambda camera: camera.model,
        lambda camera: camera.lens_model,
        lambda camera: "{1}x{0}".format(*camera.image_size),
    ]
    names: dict[CameraKey, tuple[str, ...]] = dict.fromkeys(cameras, ())
    for part in parts:
        more = {camera: (*words, part(camera)) for camera, words in names.items()}
        if len(set(more.values())) > len(set(names.values())):
            names = more
        if len(set(names.values())) == len(cameras):
            break
    return {
        camera: "_".join(filter(None, ("/camera", *map(_slug, words)))) for camera, words in names.items()
    }


def _slug(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")


def _write_photograph(
    author: RecordingAuthor, prefix: str, time_ns: int, path: Path, tags: PhotographTags
) -> None:
    """Write the image after its pose and lens, so that readers know them when the image comes."""
    write_pose(author, time_ns, tags.position, tags.gimbal, tags.height_m)
    if tags.focal_px:
        write_lens(author, f"{prefix}/calibration", time_ns, tags.camera.image_size, tags.focal_px)
    topic = f"{prefix}/image/compressed"
    author.write_image(topic, time_ns, CAMERA_FRAME, path.read_bytes(), "jpeg", is_photograph=True)
