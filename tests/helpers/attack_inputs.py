"""Hostile inputs by area, drawn from a random generator; used by tests/attacks/run.py."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np
from factories import make_recording, shots
from fakes import FakeDetector
from flights import write_flight
from nets import save_tiny

from inspect_pipeline.index.publish import publish
from inspect_pipeline.pipeline import process
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.random import Generator

N_FRAMES = 6
Loss = Callable[[int, str, str], str | None]


class Attack(NamedTuple):
    """A command line; `find_loss` returns what exit code, stdout and stderr keep silent about."""

    arguments: list[str]
    find_loss: Loss | None = None
    real_detector: bool = False


class Templates(NamedTuple):
    """Good inputs that attacks are made from."""

    recording: bytes
    images: dict[str, bytes]
    weights: bytes
    store: Path
    flight_id: str


def make_templates(folder: Path) -> Templates:
    """Make a recording, images, weights and a store."""
    folder.mkdir(parents=True)
    recording = make_recording(folder / "a.mcap", shots(N_FRAMES)).read_bytes()
    picture = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    images = {
        suffix: cv2.imencode(suffix, picture)[1].tobytes()
        for suffix in (".jpg", ".png", ".tiff", ".bmp", ".webp")
    }
    save_tiny(folder / "w.safetensors", min_score=0.4)
    store = Store(folder / "store")
    write_flight(store, "one", 3)
    flight_id = process(folder / "a.mcap", store, FakeDetector()).flight_id
    publish(store)
    return Templates(recording, images, (folder / "w.safetensors").read_bytes(), store.root, flight_id)


def mutate(rng: Generator, data: bytes) -> bytes:
    """Return the bytes with a few changed, cut off, repeated, inserted or blown up."""
    content = bytearray(data)
    for _ in range(int(rng.integers(1, 6))):
        at = int(rng.integers(0, max(len(content), 1)))
        span = int(rng.integers(1, 64))
        kind = int(rng.integers(0, 7))
        if kind == 0 and content:
            content[at % len(content)] ^= 1 << int(rng.integers(0, 8))
        elif kind == 1:
            content[at : at + span] = rng.bytes(span)
        elif kind == 2:
            del content[at:]
        elif kind == 3:
            content[at:at] = content[at : at + span]
        elif kind == 4:
            content[at : at + 8] = b"\xff" * 8  # a length without bounds
        elif kind == 5:
            content += content[:at]
        else:
            content[at : at + span] = bytes(span)
    return bytes(content)


def pick(rng: Generator, values: list[str]) -> str:
    """Return one of the values."""
    return values[int(rng.integers(0, len(values)))]


def attack_recording(rng: Generator, folder: Path, templates: Templates) -> Attack:
    """A damaged recording; a loss is a flight with fewer frames, called ok, without a warning."""
    path = folder / "in" / pick(rng, ["a.mcap", "x\n\x1b[2J.mcap", "-a.mcap", "a b%20.mcap"])
    path.write_bytes(mutate(rng, templates.recording))

    def find_loss(exit_code: int, out: str, err: str) -> str | None:
        rows = [json.loads(line) for line in out.splitlines()]
        if (
            exit_code == 0
            and not err
            and rows
            and rows[0]["status"] == "ok"
            and rows[0]["n_frames"] < N_FRAMES
        ):
            return f"{rows[0]['n_frames']} of {N_FRAMES} frames"
        return None

    write = pick(rng, ["copy", "sidecar", "none"])
    return Attack(["process", str(path), "--json", "--write", write, "--store", "store"], find_loss)


def attack_image(rng: Generator, folder: Path, templates: Templates) -> Attack:
    """A damaged photograph; a loss is success without a row."""
    suffix = pick(rng, list(templates.images))
    path = folder / "in" / f"photo{pick(rng, list(templates.images)) if rng.random() < 0.2 else suffix}"
    path.write_bytes(mutate(rng, templates.images[suffix]))

    def find_loss(exit_code: int, out: str, _err: str) -> str | None:
        return "no row" if exit_code == 0 and not out.strip() else None

    return Attack(["detect", str(path), "--json", "--draw", "drawn"], find_loss)


_SQL = [
    "SELECT * FROM frames",
    "ATTACH 'x.db'; SELECT 1",
    "COPY flights TO 'stolen.csv'",
    "SELECT * FROM read_csv('/etc/passwd')",
    "SELECT * FROM glob('/etc/*')",
    "INSTALL httpfs",
    "SET memory_limit = '1TB'",
    "PRAGMA database_list",
    "DROP TABLE flights",
    "DELETE FROM flights",
    "CALL pragma_version()",
    "WITH RECURSIVE t(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM t) SELECT count(*) FROM t",
    "SELECT repeat('x', 2000000000)",
    "SELECT count(*) FROM range(1000000) a, range(1000000) b, range(1000) c",
    "SELECT list(range) FROM range(300000000)",
    "EXPLAIN ANALYZE DELETE FROM flights",
    "SELECT getenv('HOME')",
    "SELECT '\x1b[2J\x00' AS \"a\nb\"",
    "SELECT " + "(" * 5000 + "1" + ")" * 5000,
    "SELECT " + ", ".join(f"{i} AS c{i}" for i in range(3000)),
    "",
    ";;",
    "SELECT 1; SELECT 2",
    "FROM frames ORDER BY log_time_utc LIMIT 1e9",
]


def attack_sql(rng: Generator, folder: Path, templates: Templates) -> Attack:
    """A hostile statement; the store is the input that must not change."""
    shutil.copytree(templates.store, folder / "in" / "store")
    sql = pick(rng, _SQL)
    if rng.random() < 0.4:
        sql = mutate(rng, sql.encode()).replace(b"\0", b" ").decode(errors="replace")[:100_000]
    form = pick(rng, ["table", "csv", "json"])
    options = ["--format", form, "--timeout", "5", "--store", str(folder / "in" / "store")]
    if rng.random() < 0.5:
        (folder / "in" / "q.sql").write_text(sql, errors="replace")
        return Attack(["query", "-f", str(folder / "in" / "q.sql"), *options])
    return Attack(["query", *options, "--", sql])


def attack_output(rng: Generator, folder: Path, templates: Templates) -> Attack:
    """An output name that is odd; a loss is success without a file. FIFOs lack a reader: that is refused."""
    command = pick(rng, ["query", "overlay"])
    suffix = ".csv" if command == "query" else ".png"
    target = folder / "work" / f"t{suffix}"
    (folder / "in" / "kept.csv").write_text("kept")
    kind = pick(
        rng, ["folder", "fifo", "link", "loop", "empty", "null", "long", "missing", "suffix", "input"]
    )
    name = {
        "empty": "",
        "null": f"odd\x1b\n{suffix}",
        "long": "x" * 300 + suffix,
        "missing": f"no/where{suffix}",
        "suffix": "rows.xlsx",
        "input": "../in/kept.csv/below.csv",
    }.get(kind, str(target))
    if kind == "folder":
        target.mkdir()
    elif kind == "fifo":
        os.mkfifo(target)
    elif kind == "link":
        target.symlink_to(folder / "work" / f"behind{suffix}")
    elif kind == "loop":
        target.symlink_to(target)

    def find_loss(exit_code: int, _out: str, _err: str) -> str | None:
        if kind == "fifo" and not target.is_fifo():
            return "the FIFO was replaced"
        if kind in {"link", "loop"} and not target.is_symlink():
            return "the link was replaced"
        if exit_code == 0 and kind != "fifo":
            written = folder / "work" / name
            has_files = written.is_dir() and any(written.iterdir())  # overlay fills folders
            return None if written.is_file() or has_files else "no file"
        return None

    store = ["--store", str(templates.store)]
    if command == "query":
        return Attack(["query", "FROM frames", "-o", name, *store], find_loss)
    return Attack(["overlay", templates.flight_id[:8], "-o", name, *store], find_loss)


def attack_weights(rng: Generator, folder: Path, templates: Templates) -> Attack:
    """Damaged weights, in the header above all."""
    size = int.from_bytes(templates.weights[:8], "little") + 8
    header = mutate(rng, templates.weights[8:size]) if rng.random() < 0.7 else templates.weights[8:size]
    length = len(header).to_bytes(8, "little") if rng.random() < 0.8 else rng.bytes(8)
    path = folder / "in" / "w.safetensors"
    path.write_bytes(length + header + mutate(rng, templates.weights[size:]))
    (folder / "in" / "a.png").write_bytes(templates.images[".png"])
    words = ["detect", str(folder / "in" / "a.png"), "--weights", str(path), "--runtime", "torch"]
    return Attack(words, real_detector=True)


_TOML = b"""[check]
fail_on = ["dark_frames"]
min_frame_share = 0.5
[frames]
dark_below_luma = 12.0
[anomalies.dark_frames]
min_frames = 3
"""


def attack_toml(rng: Generator, folder: Path, templates: Templates) -> Attack:
    """Rules or options in broken, deep or absurd TOML."""
    path = folder / "in" / "x.toml"
    odd = [
        b"a = " + b"[" * 20_000,
        b"every = 1e400",
        b"x = '" + b"y" * 3_000_000 + b"'",
        b"[" * 9000,
        b"\xff\xfe",
    ]
    content = mutate(rng, _TOML) if rng.random() < 0.7 else odd[int(rng.integers(0, len(odd)))]
    path.write_bytes(content)
    if rng.random() < 0.5:
        shutil.copytree(templates.store, folder / "work" / "store")
        return Attack(["check", "--rules", str(path), "--store", "store"])
    return Attack(["batch", str(folder / "in"), "--config", str(path), "--store", "store", "--dry-run"])


def attack_json(rng: Generator, folder: Path, templates: Templates) -> Attack:
    """Damaged records of a store: reviews, tags, runs, results."""
    store = shutil.copytree(templates.store, folder / "work" / "store")
    review = {"anomaly_id": "a", "verdict": "confirmed", "note": "", "reviewed_at": "x", "flight_id": "b"}
    name = pick(rng, ["reviews.jsonl", "tags.jsonl", "result", "runs/x.json"])
    path = next(iter(sorted(store.glob("flights/*/result.json")))) if name == "result" else store / name
    path.parent.mkdir(exist_ok=True)
    good = path.read_bytes() if path.exists() else json.dumps(review).encode() + b"\n"
    deep = b"[" * 100_000 if rng.random() < 0.5 else b'{"a":' * 50_000
    path.write_bytes(mutate(rng, good) if rng.random() < 0.7 else deep)
    command = pick(rng, ["index verify", "index rebuild", "anomalies list", "runs", "flights list", "doctor"])
    return Attack([*command.split(), "--store", "store"])


_CSV = b"structure_id,latitude,longitude,height_m\n1,47.0,8.0,20\n2,47.001,8.0,20\n3,47.002,8.001,20\n"
_GEOJSON = json.dumps(
    {
        "type": "FeatureCollection",
        "features": [
            {
                "type": "Feature",
                "properties": {"span_id": "a"},
                "geometry": {"type": "LineString", "coordinates": [[8.0, 47.0], [8.0, 47.001]]},
            }
        ],
    }
).encode()


def attack_spans(rng: Generator, folder: Path, templates: Templates) -> Attack:
    """Broken CSV or GeoJSON of spans."""
    shutil.copytree(templates.store, folder / "work" / "store")
    name, good = (("s.csv", _CSV), ("s.geojson", _GEOJSON))[int(rng.integers(0, 2))]
    deep = b'{"features":' * 50_000
    (folder / "in" / name).write_bytes(mutate(rng, good) if rng.random() < 0.85 else deep)
    return Attack(["spans", "import", str(folder / "in" / name), "--store", "store"])


def attack_store(rng: Generator, folder: Path, templates: Templates) -> Attack:
    """A damaged file of a store; a loss is a rebuild that has fewer rows and says nothing."""
    store = shutil.copytree(templates.store, folder / "work" / "store")
    files = sorted(path for path in store.rglob("*") if path.is_file() and path.stat().st_size)
    path = files[int(rng.integers(0, len(files)))]
    path.write_bytes(mutate(rng, path.read_bytes()))

    def find_loss(exit_code: int, out: str, err: str) -> str | None:
        if exit_code == 0 and not err and out.strip() != "2 flights":
            return f"{path.name}: {out.strip()}"
        return None

    if rng.random() < 0.6:
        return Attack(["index", "rebuild", "--store", "store"], find_loss)
    command = pick(
        rng,
        [
            "index verify",
            "flights list",
            "query FROM/**/flight_summary",
            f"overlay {templates.flight_id[:8]} -o o.png",
        ],
    )
    return Attack([*command.split(), "--store", "store"])


AREAS: dict[str, Callable[[Generator, Path, Templates], Attack]] = {
    "recordings": attack_recording,
    "images": attack_image,
    "sql": attack_sql,
    "output": attack_output,
    "weights": attack_weights,
    "toml": attack_toml,
    "json": attack_json,
    "spans": attack_spans,
    "stores": attack_store,
}
