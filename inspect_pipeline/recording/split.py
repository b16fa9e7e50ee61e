"""Split recordings: the parts of one flight in a folder.

Parts are the files that a rosbag2's metadata.yaml lists, or else those whose names differ only by the number
at their end (flight_0.mcap, flight_1.mcap, ...).
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from inspect_pipeline.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

# Items of relative_file_paths, one a line or [a, b]; those of `files`, which name the same parts since
# version 5, begin with a key.
_ITEM = re.compile(r"^\s*-\s*(?!\s|\w+:\s)[\"']?(.+?\.mcap)[\"']?\s*$", re.MULTILINE)
_FLOW = re.compile(r"^\s*relative_file_paths:\s*\[(.*?)\]", re.MULTILINE | re.DOTALL)
_FLOW_ITEM = re.compile(r"\s*[\"']?([^,\"']+?\.mcap)[\"']?\s*(?:,|$)")
_MAX_NUMBERS = 10_000
_NUMBERED = re.compile(r"(.*?)_?(\d+)")


def is_recording_name(name: str) -> bool:
    """Whether a file of this name may be a recording; "._x.mcap" is what macOS notes about "x.mcap"."""
    return name.lower().endswith(".mcap") and not name.startswith("._")


def find_parts(folder: Path) -> list[Path]:
    """Return the parts of a split recording in order; empty when the folder has no recording.

    Raises RecordingError when its files are not parts of one recording, or a part that is listed is missing.
    """
    if listed := listed_parts(folder):
        for part in listed:
            if not part.is_file():
                remedy = "copy the folder again, or remove metadata.yaml to use the other parts"
                raise RecordingError(part, "metadata.yaml lists it but it is absent", remedy)
        return listed
    paths = [path for path in folder.iterdir() if is_recording_name(path.name)]
    matches = {path: _NUMBERED.fullmatch(path.stem) for path in paths}
    names = {match[1] if match else path.stem for path, match in matches.items()}
    if len(names) > 1 or (len(matches) > 1 and None in matches.values()):
        raise RecordingError(
            folder, "its recordings are not parts of one", "name them one by one, or run lsnet-pipe batch"
        )
    return sorted(matches, key=lambda path: (int(match[2]) if (match := matches[path]) else 0, path))


def missing_numbers(paths: Sequence[Path]) -> list[str]:
    """Return the numbers that are missing between those of the parts, whose names differ only by a number."""
    matches = [_NUMBERED.fullmatch(path.stem) for path in paths]
    if len({match[1] if match else None for match in matches}) != 1 or None in matches:
        return []
    numbers = {int(match[2]) for match in matches if match}
    if max(numbers) - min(numbers) > _MAX_NUMBERS:  # numbers of another kind, such as dates
        return []
    return [str(number) for number in range(min(numbers), max(numbers)) if number not in numbers]


def listed_parts(folder: Path) -> list[Path]:
    """Return the files that a rosbag2's metadata.yaml lists, whether they exist or not."""
    index = folder / "metadata.yaml"
    text = index.read_text("utf-8", "replace") if index.is_file() else ""
    flow = _FLOW.search(text)
    names = _FLOW_ITEM.findall(flow[1]) if flow else _ITEM.findall(text)
    # Paths in old bags begin with the name of the bag.
    return [folder / name.rsplit("/", 1)[-1] for name in names]


def whole_of(path: Path) -> Path:
    """Return the folder of the split rosbag2 that a file is a part of, else the file itself."""
    try:
        listed = listed_parts(path.parent)
    except OSError:
        return path
    return path.parent if len(listed) > 1 and path in listed else path
