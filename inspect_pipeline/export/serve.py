"""Serve the files of a flight to viewers in a browser on this machine: byte ranges, CORS, no other files.

A viewer's page comes from elsewhere, so any origin may read; the token in the address keeps other pages out.
"""

from __future__ import annotations

import json
import re
import secrets
from datetime import UTC, datetime
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, NamedTuple
from urllib.parse import quote, unquote, urlencode

from inspect_pipeline.errors import RecordingError, StoreError
from inspect_pipeline.export.viewer_files import LAYOUT, REVIEW
from inspect_pipeline.recording.reader import open_recording
from inspect_pipeline.store.images import source_path
from inspect_pipeline.store.records import ANNOTATED

if TYPE_CHECKING:
    from collections.abc import Mapping
    from io import BufferedIOBase
    from pathlib import Path
    from typing import BinaryIO

    from inspect_pipeline.store.store import Store

ADDRESS = "127.0.0.1"
_RANGE = re.compile(r"bytes=(\d*)-(\d*)")
_BLOCK_BYTES = 1 << 18
_TYPES = {".json": "application/json"}


def viewer_files(store: Store, flight_id: str) -> dict[str, Path]:
    """Return the files with which viewers show a flight; the keys are the names they are served under.

    Raises RecordingError when neither the annotated copy nor the recording is there, StoreError.
    """
    stored = store.find_flight(flight_id)
    if stored is None:
        raise StoreError(store.flight_dir(flight_id), "the flight is damaged", "process its recording again")
    folder, record = stored.folder, stored.record
    names = [name for name in (record.annotations, REVIEW, LAYOUT) if name]
    files = {name: folder / name for name in names if (folder / name).exists()}
    if record.annotations == ANNOTATED:
        return files
    path = source_path(record.source_uri)
    if not path.exists():
        raise RecordingError(path, "the recording of the flight is gone", "process it again where it is now")
    return {**{part.name: part for part in open_recording(path).files}, **files}


class Links(NamedTuple):
    """Addresses: of the viewers with the flight, and of its layout."""

    lichtblick: str
    foxglove: str
    layout: str


class FileServer:
    """Serves some files on a free or given port of this machine until it is closed.

    Raises OSError when the port is taken.
    """

    def __init__(self, files: Mapping[str, Path], port: int = 0) -> None:
        self._files = dict(files)
        self._token = secrets.token_urlsafe(12)
        found = {f"/{self._token}/{name}": path for name, path in files.items()}
        handler = type("FlightHandler", (_ServeHandler,), {"files": found})
        self._server = ThreadingHTTPServer((ADDRESS, port), handler)
        self._server.daemon_threads = True

    def links(self, lichtblick: str, time_ns: int | None = None) -> Links:
        """Return the addresses; lichtblick is that of a Lichtblick, time_ns is where viewers start."""
        recordings = [("ds.url", self.url_of(name)) for name in self._files if name.endswith(".mcap")]
        query = [("ds", "remote-file"), *recordings, *_start(time_ns)]
        layout = self.url_of(LAYOUT)
        return Links(
            f"{lichtblick.rstrip('/')}/?{urlencode([*query, ('layoutUrl', layout)])}",
            f"https://app.foxglove.dev/~/view?{urlencode(query)}",
            layout,
        )

    def url_of(self, name: str) -> str:
        """Return the address of a file."""
        return f"http://{ADDRESS}:{self._server.server_address[1]}/{self._token}/{quote(name)}"

    def run(self) -> None:
        """Answer requests until another thread calls `close`, or an exception ends it."""
        self._server.serve_forever(poll_interval=0.2)

    def close(self) -> None:
        """Stop and free the port."""
        self._server.shutdown()
        self._server.server_close()


def _start(time_ns: int | None) -> list[tuple[str, str]]:
    if time_ns is None:
        return []
    seconds, fraction = divmod(time_ns, 10**9)
    return [("time", f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{fraction:09d}Z")]


class _ServeHandler(BaseHTTPRequestHandler):
    """Answers for the files of one server, whole or a range of bytes."""

    files: Mapping[str, Path] = {}
    protocol_version = "HTTP/1.1"

    def do_OPTIONS(self) -> None:
        """Answer the question of a browser whether it may ask."""
        self.send_response(HTTPStatus.NO_CONTENT)
        self.send_header("Access-Control-Allow-Methods", "GET, HEAD, OPTIONS")
        self.send_header("Access-Control-Allow-Headers", "Range")
        self.send_header("Access-Control-Allow-Private-Network", "true")
        self.send_header("Content-Length", "0")
        self.end_headers()

    def do_HEAD(self) -> None:
        """Send the headers of a file."""
        self._send(with_content=False)

    def do_GET(self) -> None:
        """Send a file, or a range of it."""
        self._send(with_content=True)

    def end_headers(self) -> None:
        """Let pages of any origin read what they know the address of."""
        self.send_header("Access-Control-Allow-Origin", "*")
        self.send_header("Access-Control-Expose-Headers", "Accept-Ranges, Content-Length, Content-Range")
        self.send_header("Cache-Control", "no-cache")
        super().end_headers()

    def log_message(self, *_: object) -> None:
        """Log nothing: a viewer asks hundreds of times."""

    def _send(self, *, with_content: bool) -> None:
        path = self.files.get(unquote(self.path.partition("?")[0]))
        if path is None:
            self._refuse(HTTPStatus.NOT_FOUND)
            return
        try:
            kind = _TYPES.get(path.suffix, "application/octet-stream")
            with path.open("rb") as file:
                self._send_file(file, path.stat().st_size, kind, with_content=with_content)
        except (BrokenPipeError, ConnectionResetError):  # a viewer that has seen enough
            self.close_connection = True
        except OSError:
            self._refuse(HTTPStatus.NOT_FOUND)

    def _send_file(self, file: BinaryIO, size: int, kind: str, *, with_content: bool) -> None:
        wanted = self._range(size)
        if wanted is None:
            self._refuse(HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE, ("Content-Range", f"bytes */{size}"))
            return
        start, end = wanted
        is_part = "Range" in self.headers
        self.send_response(HTTPStatus.PARTIAL_CONTENT if is_part else HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(end - start))
        self.send_header("Accept-Ranges", "bytes")
        if is_part:
            self.send_header("Content-Range", f"bytes {start}-{end - 1}/{size}")
        self.end_headers()
        if with_content:
            file.seek(start)
            _copy(file, self.wfile, end - start)

    def _range(self, size: int) -> tuple[int, int] | None:
        """Return the bytes that are asked for, the end excluded; None where the file has none of them."""
        match = _RANGE.fullmatch(self.headers.get("Range", "bytes=0-").strip())
        if match is None or match.groups() == ("", ""):
            return None
        first, last = match.groups()
        if not first:  # the last so many
            return max(0, size - int(last)), size
        start, end = int(first), min(size, int(last) + 1) if last else size
        return (start, end) if start < end else (0, 0) if size == 0 and start == 0 else None

    def _refuse(self, status: HTTPStatus, *headers: tuple[str, str]) -> None:
        body = json.dumps({"error": status.phrase}).encode()
        self.send_response(status)
        for header in headers:
            self.send_header(*header)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)


def _copy(source: BinaryIO, target: BufferedIOBase, n_bytes: int) -> None:
    while n_bytes > 0 and (block := source.read(min(n_bytes, _BLOCK_BYTES))):
        target.write(block)
        n_bytes -= len(block)
