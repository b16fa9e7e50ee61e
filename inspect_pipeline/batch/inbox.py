"""What lies in the inbox: recordings in folders, by glob or by name, and whether they are written to the end.

The folder of a split rosbag2 is one recording.

Nothing here opens a recording further than its last bytes, and nothing follows a link out of the inbox.
"""

from __future__ import annotations

import glob
import os
import stat
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from inspect_pipeline.errors import InboxError
from inspect_pipeline.recording.split import is_recording_name, listed_parts, whole_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

_MAGIC = b"\x89MCAP0\r\n"  # the first and the last bytes of a whole recording
_CUT_OFF_AFTER_S = 3600.0  # a recorder that is silent for so long has died


@dataclass(frozen=True, slots=True)
class Candidate:
    """A recording of the inbox as it was found: path absolute, size in bytes, mtime in ns since 1970.

    Of a split one, path is its folder, size that of all parts there are, and mtime that of the last.
    """

    path: Path
    size_bytes: int
    mtime_ns: int
    seen_at: float = field(compare=False)  # by time.monotonic, s

    @classmethod
    def at(cls, path: Path) -> Candidate | None:
        """Return the recording at a path, None where there is no file (any more)."""
        found = []
        try:
            for part in _files_of(path):
                with suppress(FileNotFoundError):
                    found.append(part.stat())
        except OSError:
            return None
        if not found or not all(stat.S_ISREG(each.st_mode) for each in found):
            return None
        size_bytes, mtime_ns = sum(each.st_size for each in found), max(each.st_mtime_ns for each in found)
        return cls(path, size_bytes, mtime_ns, time.monotonic())

    def is_written(self, settle_s: float) -> bool:
        """Whether nobody writes it any more: it has rested for `settle_s`, and ends as a recording does.

        Rest counts from the mtime or, for clocks that disagree, from when it was found. One without an end,
        or with a part missing, is given an hour; after that the reader says what it lacks.
        """
        if Candidate.at(self.path) != self:
            return False
        age_s = time.time() - self.mtime_ns / 1e9
        has_rested = age_s >= settle_s or time.monotonic() - self.seen_at >= settle_s
        return has_rested and (age_s >= _CUT_OFF_AFTER_S or all(map(_has_end, _files_of(self.path))))


@dataclass(frozen=True, slots=True)
class Discovery:
    """What was found: recordings, oldest first, and what is left alone.

    links_out: links that lead out of the inbox; unreadable: folders within it that may not be read.
    """

    candidates: tuple[Candidate, ...]
    links_out: tuple[Path, ...]
    unreadable: tuple[Path, ...]


def discover(inboxes: Iterable[str], *, since_ns: int = 0, without: Path | None = None) -> Discovery:
    """Find the recordings in folders, files and glob patterns, each once, changed at or after `since_ns`.

    Nothing below the folder `without` is looked at. Raises InboxError for a folder or file that is not there,
    and for a folder that cannot be read.
    """
    candidates: dict[Path, Candidate] = {}
    links_out: dict[Path, None] = {}
    unreadable: dict[Path, None] = {}
    for inbox in inboxes:
        for path, root in _paths_of(inbox, without, unreadable):
            if root is not None and _leads_out(path, root):
                links_out[path] = None
            elif (candidate := Candidate.at(path)) and candidate.mtime_ns >= since_ns:
                candidates[path] = candidate
    ordered = sorted(candidates.values(), key=lambda found: (found.mtime_ns, os.fsencode(found.path)))
    return Discovery(tuple(ordered), tuple(links_out), tuple(unreadable))


def _paths_of(
    inbox: str, without: Path | None, unreadable: dict[Path, None]
) -> Iterator[tuple[Path, str | None]]:
    """Yield paths, each with the real path of the folder it must not leave; None for a file named by hand."""
    path = Path(inbox).absolute()
    if path.is_dir():
        root = os.path.realpath(path)
        _check_readable(path)
        yield from ((whole_of(found), root) for found in _walk(path, without, unreadable))
    elif path.exists():
        yield path, None
    elif glob.has_magic(inbox):
        root = os.path.realpath(_fixed_part(path))
        for match in sorted(glob.glob(str(path), recursive=True)):  # noqa: PTH207 - absolute
            found = Path(match)
            is_folder = found.is_dir() and not found.is_symlink()
            below = _walk(found, without, unreadable) if is_folder else [found]
            yield from ((whole_of(each), root) for each in below if is_recording_name(each.name))
    else:
        raise InboxError(
            path, "there is no such folder or file", "check the name, and that its disk is mounted"
        )


def _check_readable(folder: Path) -> None:
    """One that may not be looked into must not pass for an empty one."""
    try:
        next(folder.iterdir(), None)
    except OSError as error:
        raise InboxError(folder, f"it cannot be read ({error.strerror})", "check its rights") from error


def _walk(folder: Path, without: Path | None, unreadable: dict[Path, None]) -> Iterator[Path]:
    """Yield the recordings below a folder; linked and hidden folders (.Trash-1000) are not entered.

    Folders that may not be read are added to `unreadable`.
    """

    def note(error: OSError) -> None:
        if not isinstance(error, FileNotFoundError):  # it is gone meanwhile
            unreadable[Path(error.filename)] = None

    for parent, names, files in os.walk(folder, onerror=note):
        names[:] = sorted(name for name in names if Path(parent, name) != without and not _is_hidden(name))
        yield from (Path(parent, name) for name in files if is_recording_name(name))


def _files_of(path: Path) -> list[Path]:
    """Return the files of a recording: itself, or its parts, which may be missing. Raises OSError."""
    return listed_parts(path) if path.is_dir() and (path / "metadata.yaml").is_file() else [path]


def _leads_out(path: Path, root: str) -> bool:
    """Whether a recording, or a part of it, is a link to somewhere that is not below `root`, a real path."""
    try:
        files = {path, *_files_of(path)}
    except OSError:
        files = {path}
    return not all(Path(os.path.realpath(file)).is_relative_to(root) for file in files)


def _is_hidden(folder_name: str) -> bool:
    return folder_name.startswith(".") or folder_name == "$RECYCLE.BIN"


def _fixed_part(pattern: Path) -> Path:
    """Return the folder in front of the first wildcard."""
    return next(parent for parent in pattern.parents if not glob.has_magic(str(parent)))


def _has_end(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            file.seek(-len(_MAGIC), os.SEEK_END)
            return file.read() == _MAGIC
    except OSError:  # gone, too short or forbidden
        return False
