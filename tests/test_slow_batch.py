"""A night over real recordings with the shipped detector, as it would be run."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import duckdb
import pytest
from mcap.reader import make_reader


def lsnet_pipe(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "cli", *map(str, arguments)], capture_output=True, text=True, check=False
    )


def counts(store: Path) -> dict[str, Any]:
    return json.loads((store / "summary.json").read_text())["counts"]


def messages(path: Path) -> dict[int, int]:
    """The messages of each channel that has any, counted one by one."""
    with path.open("rb") as file:
        return Counter(channel.id for _, channel, _ in make_reader(file).iter_messages())


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_a_night_over_real_recordings(data_dir: Path, tmp_path: Path) -> None:
    inbox, store = data_dir / "mcap", tmp_path / "store"
    recordings = sorted(inbox.glob("*.mcap"))
    before = {path: (path.stat().st_size, path.stat().st_mtime_ns) for path in recordings}
    night = lsnet_pipe("batch", inbox, "--store", store, "--tag", "line=L12")
    assert (night.returncode, counts(store)["n_processed"]) == (0, len(recordings)), night.stderr
    with duckdb.connect(store / "index.duckdb", read_only=True) as connection:
        rows = connection.execute(
            "SELECT source_uri, channel_id, count(*) FROM flights JOIN frames USING (flight_id) GROUP BY ALL"
        ).fetchall()
        found = connection.execute("SELECT sum(n_segments), sum(n_bad_frames) FROM flights").fetchone()
    frames = {(Path(unquote(urlsplit(uri).path)).name, channel): n for uri, channel, n in rows}
    assert frames == {key: messages(inbox / key[0])[key[1]] for key in frames}
    assert {name for name, _ in frames} == {path.name for path in recordings}
    print(f"{len(recordings)} recordings, {sum(frames.values())} frames, {found} segments and bad frames")
    assert found[0] > 0
    again = lsnet_pipe("batch", inbox, "--store", store)
    assert (again.returncode, counts(store)["n_skipped"]) == (0, len(recordings))
    assert lsnet_pipe("index", "verify", "--store", store).returncode == 0
    assert {path: (path.stat().st_size, path.stat().st_mtime_ns) for path in recordings} == before
    assert not list(os.scandir(store / "quarantine")) if (store / "quarantine").exists() else True
