"""The command line of `view`: links, the command of the desktop application, a port that is taken."""

from __future__ import annotations

import shlex
import socket
from typing import TYPE_CHECKING
from urllib.parse import parse_qs, urlsplit

import flights
import typer
from typer.testing import CliRunner

from inspect_pipeline.commands.view import view
from inspect_pipeline.errors import OutputError
from inspect_pipeline.export.serve import FileServer
from inspect_pipeline.index import publish as index
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from pathlib import Path

    import pytest


def test_links_and_command_of_a_flight(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its store was published by a version that made no files for viewers."""
    store = Store(tmp_path / "a store")
    folder = store.flight_dir(flights.write_flight(store, "a"))
    index.publish(store)
    assert not (folder / "layout.json").exists()
    monkeypatch.setattr(FileServer, "run", lambda self: self._server.server_close())
    app = typer.Typer()
    app.command()(view)
    options = ["--store", str(store.root), "--lichtblick", "https://l.example/"]
    done = CliRunner().invoke(app, ["a.mcap", *options])
    lichtblick, foxglove, layout, desktop, drop = done.stdout.splitlines()
    query = parse_qs(urlsplit(lichtblick.split()[1]).query)
    assert lichtblick.split()[1].startswith("https://l.example/?ds=remote-file&")
    assert [url.rsplit("/", 1)[1] for url in query["ds.url"]] == ["annotated.mcap", "review.mcap"]
    assert query["layoutUrl"][0] in layout
    assert "app.foxglove.dev" in foxglove
    copied = [str(folder / "layout.json"), f"~/.lichtblick-suite/layouts/{folder.name[:8]}.json"]
    assert shlex.split(desktop)[6:8] == copied
    recordings = [str(folder / name) for name in ("annotated.mcap", "review.mcap")]
    assert shlex.split(desktop)[9:] == ["lichtblick", *recordings, f"--defaultLayout={folder.name[:8]}"]
    assert shlex.split(drop)[-1] == str(folder / "layout.json")


def test_a_port_that_is_taken(tmp_path: Path) -> None:
    store = Store(tmp_path)
    flights.write_flight(store, "a")
    index.publish(store)
    app = typer.Typer()
    app.command()(view)
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        done = CliRunner().invoke(app, ["last", "--store", str(tmp_path), "--port", str(port)])
    assert isinstance(done.exception, OutputError)
    assert "choose another port" in str(done.exception)
