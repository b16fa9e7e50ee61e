"""Log times that are out of order, far off, or beyond what databases hold."""

from __future__ import annotations

from typing import TYPE_CHECKING

import factories
import pytest
from factories import CAMERA, START_NS, STEP_NS, Shot, make_recording, shots
from fakes import FakeDetector
from writers import WRITERS, numbers

from inspect_pipeline.config import ProcessOptions, start_run
from inspect_pipeline.index import publish as index
from inspect_pipeline.pipeline import process
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("name", ["mcap", "unchunked", "unindexed", "one big chunk"])
def test_log_time_order_whatever_the_order_in_the_file(tmp_path: Path, name: str) -> None:
    to_write = shots(60)
    to_write.sort(key=lambda shot: shot.number * 37 % 60)
    path = make_recording(tmp_path / "flight.mcap", to_write, **WRITERS[name])
    assert numbers(path) == [(CAMERA, i, i) for i in range(60)]


@pytest.mark.parametrize(
    ("start_ns", "step_ns", "warnings"),
    [
        (START_NS, STEP_NS, []),
        (0, STEP_NS, []),
        (START_NS // 10**6, 500, ["its log times look like milliseconds instead of nanoseconds"]),
        (START_NS, 400 * 86_400 * 10**9, ["its log times span 2 years"]),
    ],
)
def test_odd_log_times_give_a_warning(
    tmp_path: Path, start_ns: int, step_ns: int, warnings: list[str]
) -> None:
    to_write = shots(3, start_ns=start_ns, step_ns=step_ns)
    path = make_recording(tmp_path / "a.mcap", to_write, n_gps_per_shot=0)
    recording = open_recording(path)
    assert recording.warnings == warnings
    assert len(list(iter_frames(recording))) == 3


@pytest.mark.parametrize("name", ["mcap", "unindexed", "sdk"])
def test_messages_out_of_order_give_a_warning(tmp_path: Path, name: str) -> None:
    in_order = shots(60)
    mixed = in_order[::2] + in_order[1::2]

    def write(to_write: list[Shot]) -> Path:
        if name == "sdk":
            return factories.make_recording_with_sdk(tmp_path / f"{id(to_write)}.mcap", to_write)
        return make_recording(tmp_path / f"{id(to_write)}.mcap", to_write, **WRITERS[name])

    assert open_recording(write(in_order)).warnings == []
    (warning,) = open_recording(write(mixed)).warnings
    assert warning == "its messages are out of order in 1 place"


def test_log_times_beyond_what_databases_hold(tmp_path: Path) -> None:
    to_write = [Shot(1, log_time_ns=2**64 - 2), Shot(0)]
    path = make_recording(tmp_path / "a.mcap", to_write, n_gps_per_shot=0, encoding="json")
    assert [f.log_time_ns for f in iter_frames(open_recording(path))] == [START_NS, 2**63 - 1]


def test_a_flight_with_an_outlier_of_centuries_is_indexed(tmp_path: Path) -> None:
    to_write = [*shots(4), Shot(5, log_time_ns=2**63 - 1)]
    path, store = make_recording(tmp_path / "a.mcap", to_write), Store(tmp_path / "store")
    detector, options = FakeDetector(), ProcessOptions()
    result = process(path, store, detector, options, start_run(detector, options))
    assert index.publish(store).n_flights == 1
    aside = f"{CAMERA}: 1 image set aside: log times far from all others"
    assert (result.n_frames, result.warnings) == (4, ("its log times span 239 years", aside))
