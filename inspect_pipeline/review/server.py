"""The pages of reports on 127.0.0.1, where a person decides: for one user of this machine alone.

    /TOKEN/                                    the page of the flight, or of all flights
    /TOKEN/flight/FLIGHT                       the page of a flight
    /TOKEN/mark                        POST    anomaly_id, verdict, note
    /TOKEN/frame/FLIGHT/CHANNEL/FRAME          the page on which lines are corrected; POST lines
    /TOKEN/picture/FLIGHT/CHANNEL/FRAME.jpg    the frame

The token is random, so no other page or user can know an address; the Host and Origin of a request must be
those of the server, so no other site can reach it through the browser.
"""

from __future__ import annotations

import json
import re
import secrets
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Any, cast, get_args
from urllib.parse import parse_qs, urlsplit

from inspect_pipeline.errors import InspectError
from inspect_pipeline.index.flights import find_flight
from inspect_pipeline.index.reading import select
from inspect_pipeline.report.flight_page import render_flight
from inspect_pipeline.report.page import Serving
from inspect_pipeline.report.store_page import render_store
from inspect_pipeline.review.decisions import Publisher, decide, user_name
from inspect_pipeline.review.frame_page import encode_frame, find_frame, render_frame, save_lines
from inspect_pipeline.store.feedback import Verdict

if TYPE_CHECKING:
    from collections.abc import Callable

    from inspect_pipeline.store.store import Store

ADDRESS = "127.0.0.1"
_MAX_BYTES = 1 << 20  # of a request's body
_MAX_NOTE = 2000  # characters
_FRAME = r"([0-9a-f]{1,64})/(\d{1,9})/(\d{1,9})"
_HTML, _JPEG, _JSON = "text/html; charset=utf-8", "image/jpeg", "application/json"


class ReviewServer(ThreadingHTTPServer):
    """Serves the reports of a store until it is closed.

    Args:
        store: the store.
        flight_id: the flight whose page comes first, None for that of the store.
        publisher: brings the index up to date after decisions.
        port: of this machine, 0 for a free one.

    Raises:
        OSError: the port is taken.
    """

    daemon_threads = True

    def __init__(self, store: Store, flight_id: str | None, publisher: Publisher, port: int = 0) -> None:
        super().__init__((ADDRESS, port), _ReviewHandler)
        self.store, self.flight_id, self.publisher = store, flight_id, publisher
        self.token = secrets.token_urlsafe(16)
        self.hosts = {f"{name}:{self.server_address[1]}" for name in (ADDRESS, "localhost")}

    @property
    def url(self) -> str:
        """The address of the first page."""
        return f"http://{ADDRESS}:{self.server_address[1]}/{self.token}/"


class _RequestError(Exception):
    """A request that is answered with an error."""

    def __init__(self, status: HTTPStatus, reason: str) -> None:
        super().__init__(reason)
        self.status, self.reason = status, reason


class _ReviewHandler(BaseHTTPRequestHandler):
    server: ReviewServer

    def do_GET(self) -> None:
        """Answer with a page or a picture."""
        self._answer(
            {
                "": self._show_first,
                r"flight/([0-9a-f]{1,64})": self._show_flight,
                rf"frame/{_FRAME}": self._show_frame,
                rf"picture/{_FRAME}\.jpg": self._show_picture,
            }
        )

    def do_POST(self) -> None:
        """Record a decision or corrected lines."""
        self._answer({"mark": self._mark, rf"frame/{_FRAME}": self._correct})

    def _answer(self, routes: dict[str, Callable[..., None]]) -> None:
        try:
            respond, arguments = self._find(routes)
            respond(*arguments)
        except _RequestError as refused:
            self._send(f"{refused.reason}\n".encode(), "text/plain; charset=utf-8", refused.status)
        except ValueError as error:
            self._send(f"{error}\n".encode(), "text/plain; charset=utf-8", HTTPStatus.BAD_REQUEST)
        except InspectError as error:
            self._send(
                f"{error}\n".encode(errors="replace"), "text/plain; charset=utf-8", HTTPStatus.NOT_FOUND
            )

    def _find(self, routes: dict[str, Callable[..., None]]) -> tuple[Callable[..., None], tuple[str, ...]]:
        """Return what answers the request, with its arguments. Raises _RequestError for any other."""
        host, origin = self.headers.get("Host", ""), self.headers.get("Origin")
        if host not in self.server.hosts or origin not in {None, f"http://{host}"}:
            raise _RequestError(HTTPStatus.FORBIDDEN, "this server answers its own pages only")
        token, _, path = urlsplit(self.path).path.removeprefix("/").partition("/")
        if not secrets.compare_digest(token.encode(), self.server.token.encode()):
            raise _RequestError(HTTPStatus.NOT_FOUND, "there is no such page")
        for pattern, respond in routes.items():
            if match := re.fullmatch(pattern, path):
                return respond, match.groups()
        raise _RequestError(HTTPStatus.NOT_FOUND, "there is no such page")

    def _serving(self) -> Serving:
        return Serving(base=f"/{self.server.token}/", has_store_page=self.server.flight_id is None)

    def _show_first(self) -> None:
        if self.server.flight_id is not None:
            self._show_flight(self.server.flight_id)
            return
        self.server.publisher.wait()
        flights = select(self.server.store, "SELECT flight_id FROM flights")
        links = {row["flight_id"]: f"{self._serving().base}flight/{row['flight_id'][:16]}" for row in flights}
        self._send(render_store(self.server.store, links).encode(errors="replace"), _HTML)

    def _show_flight(self, flight: str) -> None:
        self.server.publisher.wait()
        flight_id = find_flight(self.server.store, flight)
        page = render_flight(self.server.store, flight_id, self._serving())
        self._send(page.encode(errors="replace"), _HTML)

    def _show_frame(self, flight: str, channel_id: str, frame_idx: str) -> None:
        frame = find_frame(self.server.store, flight, int(channel_id), int(frame_idx))
        self._send(render_frame(self.server.store, frame, self._serving()).encode(errors="replace"), _HTML)

    def _show_picture(self, flight: str, channel_id: str, frame_idx: str) -> None:
        frame = find_frame(self.server.store, flight, int(channel_id), int(frame_idx))
        self._send(encode_frame(self.server.store, frame), _JPEG)

    def _mark(self) -> None:
        fields = self._read_form()
        verdict, note = fields.get("verdict", ""), fields.get("note", "")[:_MAX_NOTE]
        if verdict not in get_args(Verdict):
            raise ValueError("the verdict is confirmed, dismissed or open")
        review = decide(self.server.store, fields.get("anomaly_id", ""), cast("Verdict", verdict), note)
        self.server.publisher.request()
        names = ("anomaly_id", "verdict", "note", "reviewed_by", "reviewed_at")
        page = f"flight/{review.flight_id[:16]}#finding-{review.anomaly_id}"
        self._reply({name: getattr(review, name) for name in names}, page)

    def _correct(self, flight: str, channel_id: str, frame_idx: str) -> None:
        fields = self._read_form()
        frame = find_frame(self.server.store, flight, int(channel_id), int(frame_idx))
        n_lines = save_lines(self.server.store, frame, fields.get("lines", ""), user_name())
        self._reply({"n_lines": n_lines}, f"frame/{flight}/{channel_id}/{frame_idx}")

    def _read_form(self) -> dict[str, str]:
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or int(length) > _MAX_BYTES:
            raise _RequestError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "the request is too large")
        text = self.rfile.read(int(length)).decode(errors="replace")
        return {name: values[-1] for name, values in parse_qs(text, keep_blank_values=True).items()}

    def _reply(self, value: dict[str, Any], page: str) -> None:
        """Answer a script with JSON, and a form without a script with its page again."""
        if _JSON in self.headers.get("Accept", ""):
            self._send(json.dumps(value).encode(), _JSON)
        else:
            self._send(b"", _HTML, HTTPStatus.SEE_OTHER, self._serving().base + page)

    def _send(
        self, body: bytes, kind: str, status: HTTPStatus = HTTPStatus.OK, location: str | None = None
    ) -> None:
        self.send_response(status)
        headers = {
            "Content-Type": kind,
            "Content-Length": str(len(body)),
            "Cache-Control": "no-store",
            "Referrer-Policy": "same-origin",  # with none, forms would have no Origin
            "X-Content-Type-Options": "nosniff",
            "X-Frame-Options": "DENY",
            "Cross-Origin-Resource-Policy": "same-origin",
        }
        for name, text in (headers | ({"Location": location} if location else {})).items():
            self.send_header(name, text)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        """Log nothing: addresses hold the token."""
