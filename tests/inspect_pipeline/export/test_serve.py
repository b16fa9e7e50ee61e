"""The server of `view`: ranges as a browser asks for them, from any origin, and no other file."""

from __future__ import annotations

import http.client
import threading
from typing import TYPE_CHECKING
from urllib.parse import parse_qs, urlsplit

import flights
import pytest

from inspect_pipeline.export.serve import FileServer, viewer_files

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from inspect_pipeline.store.store import Store


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("served") / "annotated.mcap"
    path.write_bytes(bytes(range(256)) * 10)
    path.with_name("secret.txt").write_text("no")
    return path


@pytest.fixture(scope="module")
def server(file: Path) -> Iterator[FileServer]:
    server = FileServer({"annotated.mcap": file, "gone.mcap": file.with_name("gone.mcap")})
    thread = threading.Thread(target=server.run)
    thread.start()
    yield server
    server.close()
    thread.join()


def ask(
    server: FileServer, path: str | None = None, method: str = "GET", **headers: str
) -> tuple[int, dict[str, str], bytes]:
    url = urlsplit(server.url_of("annotated.mcap"))
    assert url.hostname == "127.0.0.1"
    connection = http.client.HTTPConnection(url.hostname, url.port or 0, timeout=5)
    try:
        connection.request(method, path or url.path, headers=headers)
        answer = connection.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()
    finally:
        connection.close()


def test_a_file_and_its_ranges(server: FileServer, file: Path) -> None:
    content = file.read_bytes()
    status, headers, body = ask(server)
    assert (status, body) == (200, content)
    assert (headers["Accept-Ranges"], headers["Access-Control-Allow-Origin"]) == ("bytes", "*")
    for asked, start, end in (
        ("5-9", 5, 10),
        ("2550-", 2550, 2560),
        ("-7", 2553, 2560),
        ("0-99999", 0, 2560),
    ):
        status, headers, body = ask(server, Range=f"bytes={asked}")
        assert (status, body) == (206, content[start:end])
        assert headers["Content-Range"] == f"bytes {start}-{end - 1}/2560"
    for asked in ("2560-", "9-5", "-", "x"):
        status, headers, body = ask(server, Range=f"bytes={asked}")
        assert (status, headers["Content-Range"]) == (416, "bytes */2560")


def test_a_browser_may_ask(server: FileServer) -> None:
    status, headers, body = ask(server, method="OPTIONS", Origin="https://app.foxglove.dev")
    assert (status, body) == (204, b"")
    assert "Range" in headers["Access-Control-Allow-Headers"]
    assert headers["Access-Control-Allow-Private-Network"] == "true"
    status, headers, body = ask(server, method="HEAD")
    assert (status, headers["Content-Length"], body) == (200, "2560", b"")
    assert "Content-Range" in headers["Access-Control-Expose-Headers"]


def test_no_other_file_is_served(server: FileServer, file: Path) -> None:
    token = urlsplit(server.url_of("annotated.mcap")).path.split("/")[1]
    others = ("/", "/annotated.mcap", f"/{token}/", f"/{token}/secret.txt", f"/{token}/../secret.txt")
    encoded = (f"/{token}/%2e%2e/secret.txt", f"/{token}/..%2fsecret.txt", str(file.with_name("secret.txt")))
    for path in (*others, *encoded, f"/{token}/gone.mcap", f"/{token}/annotated.mcap%00.txt"):
        assert ask(server, path)[0] == 404, path
    assert ask(server, method="POST")[0] == 501


def test_links_name_all_recordings_layout_and_time(store: Store) -> None:
    files = viewer_files(store, flights.flight_id_of("broken"))
    assert list(files) == ["annotated.mcap", "review.mcap", "layout.json"]
    server = FileServer(files)
    links = server.links("http://localhost:8080", 1_777_887_006_500_000_001)
    for link in links[:2]:
        query = parse_qs(urlsplit(link).query)
        assert query["ds"] == ["remote-file"]
        assert query["ds.url"] == [server.url_of("annotated.mcap"), server.url_of("review.mcap")]
        assert query["time"] == ["2026-05-04T09:30:06.500000001Z"]
    assert parse_qs(urlsplit(links.lichtblick).query)["layoutUrl"] == [links.layout]
    server._server.server_close()
