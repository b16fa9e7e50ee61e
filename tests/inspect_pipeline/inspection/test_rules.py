"""Rules files: whatever they hold, an error is one line."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from inspect_pipeline.errors import RulesError
from inspect_pipeline.inspection.rules import load_rules

if TYPE_CHECKING:
    from pathlib import Path


def test_priorities_are_those_of_the_file_and_checked(tmp_path: Path) -> None:
    path = tmp_path / "rules.toml"
    path.write_text('[anomalies.sag_change]\npriority = "high"\n')
    rules = load_rules(path)
    kinds = ["conductor_count", "conductor_lost", "conductor_gap", "sag_change"]
    assert rules.failing_from("high").check["fail_on"] == kinds
    assert rules.failing_from("low").check["fail_on"] == list(rules.kinds)
    path.write_text('[anomalies.sag_change]\npriority = "urgent"\n')
    with pytest.raises(RulesError, match="priority is 'urgent'; give high, medium or low"):
        load_rules(path)


@pytest.mark.parametrize("text", ["[check]\nmin_coverage=" + "9" * 5000, "a=" + "[" * 20000, "\x00"])
def test_a_hostile_file_is_an_error_in_one_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "rules.toml"
    path.write_text(text)
    with pytest.raises(RulesError, match=r"rules\.toml") as caught:
        load_rules(path)
    assert len(str(caught.value)) < 500
    assert "\n" not in str(caught.value)
