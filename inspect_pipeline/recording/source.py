"""What a flight is made from: a recording, or the folder of a split one, whose parts are one flight."""

from __future__ import annotations

import hashlib
import os
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote_to_bytes, urlsplit

from inspect_pipeline.errors import RecordingError
from inspect_pipeline.recording.file import reading
from inspect_pipeline.recording.joining import join_parts
from inspect_pipeline.recording.reader import open_recording
from inspect_pipeline.recording.split import find_parts
from inspect_pipeline.store.records import ANNOTATED

if TYPE_CHECKING:
    from collections.abc import Iterator

    from inspect_pipeline.recording.reader import Recording
    from inspect_pipeline.store.records import FlightRecord


@dataclass(frozen=True, eq=False)
class Source:
    """The recordings of one flight; `path` is what the user named, a file or a folder."""

    path: Path
    parts: tuple[Recording, ...]

    @cached_property
    def flight_id(self) -> str:
        """SHA-256 in hex of the recording, or of the lines with those of its parts. Raises RecordingError."""
        sums = [part.flight_id for part in self.parts]
        lines = "".join(f"{each}\n" for each in sums)
        return sums[0] if len(sums) == 1 else hashlib.sha256(lines.encode()).hexdigest()

    @property
    def size_bytes(self) -> int:
        """Of all parts together."""
        return sum(part.size_bytes for part in self.parts)

    @property
    def is_annotated_copy(self) -> bool:
        """Whether this program wrote annotations into it."""
        return len(self.parts) == 1 and self.parts[0].is_annotated_copy

    @property
    def losses(self) -> list[str]:
        """One phrase per part that cannot be read; those of the parts of a split recording name them."""
        if len(self.parts) == 1:
            return self.parts[0].losses
        return [f"{part.path.name}: {loss}" for part in self.parts for loss in part.losses]

    @contextmanager
    def recording(self, folder: Path) -> Iterator[Recording]:
        """One recording of it all, made in `folder` and gone afterwards where there are several parts.

        A channel may have another number in every part, so nothing less makes one of them. Raises
        RecordingError, OSError when the folder cannot be written.
        """
        if len(self.parts) == 1:
            yield self.parts[0]
            return
        joined = folder / "joined.mcap"
        try:
            join_parts(self.parts, joined)
            yield open_recording(joined, strict=True, made_of=self.flight_id)
        except RecordingError as error:
            path = self.path if error.path == joined else error.path
            raise RecordingError(path, error.problem, error.remedy) from error
        finally:
            joined.unlink(missing_ok=True)


def open_source(path: Path, *, strict: bool = False) -> Source:
    """Look into a recording, or into the folder of a split one.

    Raises RecordingError when it is none, or damaged and `strict`.
    """
    return Source(path, tuple(open_recording(each, strict=strict) for each in _files_of(path)))


def check_source(path: Path) -> None:
    """Raise the RecordingError of `open_source` for what can be told at once, such as a missing file."""
    for each in _files_of(path):
        with reading(each):
            pass


def _files_of(path: Path) -> list[Path]:
    paths = find_parts(path) if path.is_dir() else [path]
    if not paths:
        raise RecordingError(
            path, "the folder has no recording", f"make one of photographs: lsnet-pipe pack {path} FILE"
        )
    return paths


def open_images(flight: FlightRecord, folder: Path) -> Source:
    """Where the images of a flight in the store's `folder` are: its annotated copy, else its source.

    Raises RecordingError, also when the source is no longer the file it was.
    """
    if flight.annotations == ANNOTATED:
        return open_source(folder / ANNOTATED)
    source = open_source(Path(os.fsdecode(unquote_to_bytes(urlsplit(flight.source_uri).path))))
    if source.size_bytes != flight.source_bytes:
        raise RecordingError(source.path, "it is no longer what the flight was made from", "process it again")
    return source
