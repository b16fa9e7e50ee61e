"""Split recordings: the parts of one flight in a folder.

Parts are the files that a rosbag2's metadata.yaml lists, or that differ by the number at the end of their
names only (flight_0.mcap, flight_1.mcap, ...).
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from inspect_pipeline.errors import RecordingError

if TYPE_CHECKING:
    from pathlib import Path

# Items of relative_file_paths; those of `files`, which say the same since version 5, begin with a key.
_LISTED = re.compile(r"^\s*-\s*(?!\s|\w+:\s)[\"']?(.+?\.mcap)[\"']?\s*$", re.MULTILINE)
_NUMBERED = re.compile(r"(.*?)_?(\d+)")


def find_parts(folder: Path) -> list[Path]:
    """The parts of a split recording in order; empty when the folder holds none.

    Raises RecordingError when its files are not parts of one recording, or one of those listed is absent.
    """
    if listed := _listed(folder):
        for part in listed:
            if not part.is_file():
                raise RecordingError(part, "metadata.yaml lists it but it is absent", "copy the folder again")
        return listed
    matches = {path: _NUMBERED.fullmatch(path.stem) for path in folder.glob("*.mcap")}
    names = {match[1] if match else path.stem for path, match in matches.items()}
    if len(names) > 1 or (len(matches) > 1 and None in matches.values()):
        raise RecordingError(folder, "its recordings are not parts of one", "name one of them")
    return sorted(matches, key=lambda path: (int(match[2]) if (match := matches[path]) else 0, path))


def whole_of(path: Path) -> Path:
    """The folder of the split rosbag2 that a file is a part of, else the file itself."""
    try:
        listed = _listed(path.parent)
    except OSError:
        return path
    return path.parent if len(listed) > 1 and path in listed else path


def _listed(folder: Path) -> list[Path]:
    """The files that a rosbag2's metadata.yaml lists; paths in old bags begin with the name of the bag."""
    index = folder / "metadata.yaml"
    names = _LISTED.findall(index.read_text("utf-8", "replace")) if index.is_file() else []
    return [folder / name.rsplit("/", 1)[-1] for name in names]
