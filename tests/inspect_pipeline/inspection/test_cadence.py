"""Frame periods from log times that are regular, coarse, tied, or those of photographs."""

from __future__ import annotations

import numpy as np
import pytest

from inspect_pipeline.inspection.cadence import measure_cadence
from inspect_pipeline.inspection.rules import load_rules

RULES = load_rules()


@pytest.mark.parametrize("fps", [1.0, 2.7, 4.0, 10.0, 29.97])
def test_period_survives_log_times_in_whole_seconds(fps: float) -> None:
    exact = np.arange(200) / fps
    for times_s in (exact, np.floor(exact)):
        cadence = measure_cadence(times_s, RULES)
        assert cadence.period_s == pytest.approx(1 / fps, rel=0.1)
        assert not len(cadence.find_pauses(times_s))
        assert cadence.expected_frames(times_s) == pytest.approx(200, abs=max(1.0, fps))


def test_pause_is_found_in_whole_seconds() -> None:
    times_s = np.floor(np.delete(np.arange(400) / 4, slice(100, 140)))
    cadence = measure_cadence(times_s, RULES)
    (row,) = cadence.find_pauses(times_s).tolist()
    assert row == 99
    assert cadence.missing_frames(times_s[row + 1] - times_s[row]) == pytest.approx(40, abs=5)


@pytest.mark.parametrize(
    "times_s",
    [
        np.repeat(np.arange(20) * 4.0, 3),  # three photographs of a second
        (np.arange(20)[:, np.newaxis] * 4.0 + (0, 0.001, 0.002)).ravel(),  # the same with made-up times
        np.concatenate((np.arange(10) * 2.0, 40 + np.arange(10) * 2.0)),  # a turn between two strips
        np.zeros(8),
        np.zeros(1),
        np.zeros(0),
    ],
)
def test_photographs_have_no_dropouts(times_s: np.ndarray) -> None:
    cadence = measure_cadence(times_s, RULES)
    assert not cadence.is_video
    assert not len(cadence.find_pauses(times_s))
    assert cadence.expected_frames(times_s) == len(times_s)


def test_long_pause_of_a_video_is_a_dropout() -> None:
    times_s = np.concatenate((np.arange(80), 4000 + np.arange(80))) / 4
    assert measure_cadence(times_s, RULES).find_pauses(times_s).tolist() == [79]


def test_stills_are_no_video_at_any_rate() -> None:
    assert not measure_cadence(np.arange(40) / 4, RULES, is_stills=True).is_video
