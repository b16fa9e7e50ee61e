"""The documentation: every command and query in it runs, everything the program has is in it."""

from __future__ import annotations

import json
import pkgutil
import re
import shlex
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from command_line import all_commands, runner
from fakes import FakeDetector
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from inline_queries import answer_here
from mcap.reader import make_reader

import lsnet
from inspect_pipeline.simulation.write import SimulationOptions, simulate_flight

if TYPE_CHECKING:
    from collections.abc import Callable

ROOT = Path(__file__).parents[1]
README, CLI, FORMATS = (
    (ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "docs/cli.md", "docs/formats.md")
)
EXPORT = (ROOT / "docs/export.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```\n(.*?)^```", CLI + EXPORT, re.DOTALL | re.MULTILINE)
COMMANDS = [line for block in BLOCKS for line in block.splitlines() if line.startswith("lsnet-pipe ")]
WITH_NETWORK = ("detect", "model")  # these have tests of their own, with shipped weights


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("docs")


@pytest.fixture(scope="module")
def small_flight(folder: Path, flat_ground: None) -> Path:
    path = folder / "small.mcap"
    simulate_flight(path, SimulationOptions(seconds=1, image_size=(120, 160)))
    return path


@pytest.fixture
def run(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], folder: Path
) -> Callable[..., str]:
    """Run a command line of the documentation; all of them share a folder."""
    monkeypatch.chdir(folder)
    monkeypatch.delenv("LSNET_PIPE_STORE", raising=False)
    monkeypatch.setattr(lsnet, "Detector", FakeDetector)
    answer_here(monkeypatch)
    run_any = runner(monkeypatch, capfd)

    def run(*arguments: str) -> str:
        outcome = run_any(*arguments)
        assert outcome.exit_code == 0, outcome.err
        return outcome.out

    return run


def test_every_command_of_cli_md_runs(run: Callable[..., str], folder: Path, flat_ground: None) -> None:
    """In their order, in one folder; a flight that is simulated small, since that takes longest."""
    cv2.imwrite(str(folder / "photo.jpg"), np.zeros((64, 64, 3), np.uint8))
    for command in COMMANDS:
        _, name, *arguments = shlex.split(command)
        if name in WITH_NETWORK:
            continue
        if name == "simulate":
            arguments += ["--seconds", "10", "--fps", "0.5", "--size", "160x120"]
        if name == "overlay":
            (row,) = json.loads(run("query", "SELECT min(flight_id) AS id FROM flights", "--format", "json"))
            arguments = [row["id"] if a == "FLIGHT" else a for a in arguments]
        if "ID" in arguments:
            found = json.loads(
                run("query", "SELECT min(anomaly_id) AS id FROM anomalies", "--format", "json")
            )
            if not found[0]["id"]:
                continue
            arguments = [found[0]["id"] if a == "ID" else a for a in arguments]
        if name == "pack":
            (folder / arguments[0]).mkdir(parents=True)
            shutil.copy(folder / "demo.mcap", folder / arguments[0] / "demo_0.mcap")
        run(name, *arguments)
    assert (folder / "segments.parquet").exists()
    assert (folder / "frame.png").exists()


def test_the_query_of_the_readme(run: Callable[..., str], small_flight: Path) -> None:
    """The columns in the shown output are those the query gives; how many rows and which, the flight says."""
    run("process", str(small_flight))
    sql, shown = re.search(r"```sql\n([^`]*)```\n\n```\n(.*?)```", README, re.DOTALL).groups()
    printed = run("query", sql)
    assert printed.splitlines()[0].split() == shown.splitlines()[0].split()
    assert f'"{sql.strip()}"' in (ROOT / "Makefile").read_text(encoding="utf-8")


def test_every_query_of_the_readme_runs(run: Callable[..., str], small_flight: Path) -> None:
    run("process", str(small_flight))
    queries = re.findall(r"```sql\n([^`]*)```", README)
    assert len(queries) >= 3
    (named,) = re.findall(r"^lsnet-pipe query (.*)", README, re.MULTILINE)
    assert "span_id" in run("query", *shlex.split(named))
    for sql in queries:
        run("query", sql)


def test_every_command_is_documented() -> None:
    for name in filter(None, all_commands()):
        words = name.split()
        assert re.search(rf"`(lsnet-pipe )?{words[0]}\b", README), name
        assert f"lsnet-pipe {name}" in CLI or f"`{name}" in CLI or f"`{words[-1]}`" in CLI, name


def test_every_option_of_process_is_documented() -> None:
    text = " ".join(COMMANDS) + CLI
    for option in ("--store", "--json", "--topic", "--every", "--start", "--end", "--force", "--strict"):
        assert option in text
    for option in ("--weights", "--scale", "--min-score"):
        assert option in text


def test_links_lead_somewhere() -> None:
    for path in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")):
        for target in re.findall(r"\]\(([^)#]+)\)", path.read_text(encoding="utf-8")):
            if not target.startswith("https://"):
                assert (path.parent / target).exists(), f"{path.name}: {target}"


def test_the_modules_and_tests_of_the_paper_exist() -> None:
    """Those of the first table, without the package `lsnet` where it is left out."""
    table = (ROOT / "docs/paper.md").read_text(encoding="utf-8").split("## Choices")[0]
    for name in re.findall(r"`([\w./]+)`", table):
        if name.endswith(".py"):
            assert (ROOT / "tests/lsnet" / name).exists(), name
        elif "." in name:
            assert pkgutil.resolve_name(f"lsnet.{name.removeprefix('lsnet.')}"), name


def test_the_formats_are_those_that_are_written(run: Callable[..., str], small_flight: Path) -> None:
    """The fields of lsnet.Detections and the keys of the metadata, as the files say them."""
    annotated = json.loads(run("process", str(small_flight), "--force", "--json"))["annotated"]
    with Path(annotated).open("rb") as file:
        reader = make_reader(file)
        schemas = {schema.name: schema.data for schema in reader.get_summary().schemas.values()}
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    files = FileDescriptorSet.FromString(schemas["lsnet.Detections"]).file
    (message,) = (m for f in files for m in f.message_type if m.name == "Detections")
    section = FORMATS.split("### lsnet.Detections")[1].split("### Metadata")
    assert all(f"`{field.name}`" in section[0] for field in message.field)
    assert all(f"`{key}`" in section[1] for key in metadata["lsnet_pipe.run"])
