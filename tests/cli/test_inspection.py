"""From flights to a verdict on the command line: spans, anomalies, check, flights, named queries."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import flights as made
import inspected
import numpy as np
import pytest
from inline_queries import answer_here
from typer.testing import CliRunner

import cli
from inspect_pipeline.errors import QueryError, StoreError
from inspect_pipeline.index import publish as index
from inspect_pipeline.index.named_queries import named_queries
from inspect_pipeline.index.reading import select
from inspect_pipeline.index.verify import verify
from inspect_pipeline.inspection.spans import import_spans
from inspect_pipeline.simulation.options import FaultKind, SimulationOptions
from inspect_pipeline.simulation.truth import simulate_truth
from inspect_pipeline.store.feedback import load_reviews, load_tags
from inspect_pipeline.store.store import Store

pytestmark = pytest.mark.usefixtures("bare_flights")
FAULTS = (FaultKind.MISSING_CONDUCTOR, FaultKind.DARK)
TRUTH = simulate_truth(SimulationOptions(16, 2, seed=11, faults=FAULTS))


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Store:
    store = Store(tmp_path_factory.mktemp("template"))
    inspected.write_truth(store, "faulty", TRUTH)
    inspected.write_truth(store, "disturbed", TRUTH, np.random.default_rng(1))
    made.write_flight(store, "old", 3)
    index.publish(store)
    return store


@pytest.fixture
def store(tmp_path: Path, template: Store, monkeypatch: pytest.MonkeyPatch) -> Store:
    store = Store(shutil.copytree(template.root, tmp_path / "inspections"))
    monkeypatch.setenv("LSNET_PIPE_STORE", str(store.root))
    return store


def run(*arguments: str, code: int = 0) -> str:
    done = CliRunner().invoke(cli.app, list(arguments))
    assert done.exit_code == code, done.output + repr(done.exception)
    return done.output


def rows(*arguments: str, code: int = 0) -> list[dict[str, Any]]:
    done = CliRunner().invoke(cli.app, [*arguments, "--json"])
    assert done.exit_code == code, done.output + repr(done.exception)
    return [json.loads(line) for line in done.stdout.splitlines()]


def import_towers(store: Store, folder: Path) -> None:
    """As people do, from a table."""
    lines = [f"{s.structure_id},{s.lat_deg!r},{s.lon_deg!r},11.7" for s in TRUTH.structures]
    (folder / "towers.csv").write_text("\n".join(["structure_id,latitude,longitude,height_m", *lines]))
    lines = run("spans", "import", str(folder / "towers.csv"), "--conductors", "4").splitlines()
    assert lines[0] == f"{len(TRUTH.spans)} spans imported; the store has {len(TRUTH.spans)}"
    assert lines[1].startswith("0.28 km, latitude 52.08995 to 52.09020, longitude 5.11681 to")
    assert lines[2] == "4 of 5 within near_m of a flight"


def test_importing_spans_measures_all_flights_again(store: Store, tmp_path: Path) -> None:
    """The spans' coverage is that of the truth, within the metre of a bin; the missing conductor is found."""
    assert not select(store, "SELECT * FROM span_coverage")
    assert {row["kind"] for row in rows("anomalies", "list")} == {"dark_frames"}
    import_towers(store, tmp_path)
    assert [row["span_id"] for row in rows("spans", "list")] == [span.span_id for span in TRUTH.spans]
    found = select(store, "SELECT span_id, share FROM span_coverage WHERE flight_id = ?", [FAULTY])
    assert len(found) >= 3
    for row in found:
        assert row["share"] == pytest.approx(TRUTH.span_coverage[row["span_id"]], abs=0.03)
    odd = [row for row in rows("anomalies", "list", "--flight", FAULTY[:10]) if row["kind"] != "dark_frames"]
    planted = next(fault for fault in TRUTH.faults if fault.span_id)
    assert [(row["kind"], row["span_id"], row["value"]) for row in odd] == [
        ("conductor_count", planted.span_id, 3)
    ]


FAULTY = made.flight_id_of("faulty")


def test_import_warns_of_swapped_coordinates(store: Store, tmp_path: Path) -> None:
    lines = [f"{s.structure_id},{s.lon_deg!r},{s.lat_deg!r}" for s in TRUTH.structures]
    (tmp_path / "towers.csv").write_text("\n".join(["structure_id,latitude,longitude", *lines]))
    done = CliRunner().invoke(cli.app, ["spans", "import", str(tmp_path / "towers.csv")])
    assert done.exit_code == 0
    assert "0 of 5 within near_m of a flight" in done.stdout
    assert "are latitude and longitude swapped" in done.stderr


def test_flights_by_name(store: Store) -> None:
    """Wherever a flight is given: the last one processed, the name of its recording, the start of its id."""
    stored = select(store, "SELECT flight_id, source_uri FROM flights ORDER BY ingested_at DESC, flight_id")
    assert {row["flight_id"] for row in rows("anomalies", "list", "--flight", "faulty.mcap")} == {FAULTY}
    for command in (["check", "--flight"], ["anomalies", "list", "--flight"], ["flights", "show"]):
        by_id = CliRunner().invoke(cli.app, [*command, stored[0]["flight_id"]])
        for name in ("last", Path(stored[0]["source_uri"]).stem):
            done = CliRunner().invoke(cli.app, [*command, name])
            assert (done.exit_code, done.output) == (by_id.exit_code, by_id.output)
        done = CliRunner().invoke(cli.app, [*command, ""])  # as of a variable that is not set
        assert (done.exit_code, done.stdout) == (1, "")


def test_a_review_lasts_and_settles_the_check(store: Store) -> None:
    import_spans(store, inspected.spans_of(TRUTH))
    index.publish(store)
    failures = rows("check", "--flight", FAULTY[:8], code=4)
    assert {row["rule"] for row in failures} == {"conductor_count", "min_frame_share"}
    odd = next(row["anomaly_id"] for row in failures if row["anomaly_id"])
    assert (
        run("anomalies", "mark", odd, "dismissed", "--note", "it ends here", "--by", "kim")
        == f"{odd} dismissed\n"
    )
    assert {row["rule"] for row in rows("check", "--flight", FAULTY[:8], code=4)} == {"min_frame_share"}
    assert odd not in {row["anomaly_id"] for row in rows("anomalies", "list")}
    assert "dismissed by kim: it ends here" in run("anomalies", "list", "--all")
    inspected.write_truth(store, "faulty", TRUTH, np.random.default_rng(5))  # by another model, as it were
    index.publish(store)
    reviewed = "SELECT verdict, note FROM reviewed_anomalies WHERE anomaly_id = ?"
    assert select(store, reviewed, [odd]) == [{"verdict": "dismissed", "note": "it ends here"}]
    index.rebuild(store)
    assert select(store, reviewed, [odd]) == [{"verdict": "dismissed", "note": "it ends here"}]
    run("anomalies", "mark", odd, "confirmed")
    assert [(one.anomaly_id, one.verdict) for one in load_reviews(store)] == [(odd, "confirmed")]
    assert "conductor_count" in {row["rule"] for row in rows("check", code=4)}
    run("anomalies", "mark", "none", "confirmed", code=1)


def test_a_review_is_taken_back_by_an_abbreviated_id(store: Store) -> None:
    odd = rows("anomalies", "list")[0]["anomaly_id"]
    others = [row["anomaly_id"] for row in rows("anomalies", "list")[1:]]
    short = next(odd[:n] for n in range(1, 13) if not any(each.startswith(odd[:n]) for each in others))
    run("anomalies", "mark", short, "confirmed", "--by", "kim")
    reviewed = next(row for row in rows("anomalies", "list", "--all") if row["anomaly_id"] == odd)
    assert (reviewed["verdict"], reviewed["reviewed_by"]) == ("confirmed", "kim")
    assert reviewed["reviewed_at"].endswith("Z")
    assert run("anomalies", "mark", short, "open", "--by", "lee") == f"{odd} open\n"
    assert odd in {row["anomaly_id"] for row in rows("anomalies", "list")}
    assert load_reviews(store) == []
    log = [json.loads(line) for line in (store.root / "reviews.jsonl").read_text().splitlines()]
    assert [(line["verdict"], line["reviewed_by"]) for line in log] == [("confirmed", "kim"), ("open", "lee")]


def test_reviews_of_older_versions_are_read(store: Store) -> None:
    odd = rows("anomalies", "list")[0]["anomaly_id"]
    run("anomalies", "mark", odd, "dismissed", "--by", "kim")
    log = store.root / "reviews.jsonl"
    line = json.loads(log.read_text())
    del line["reviewed_by"]
    log.write_text(json.dumps(line) + "\n")
    assert [(one.verdict, one.reviewed_by) for one in load_reviews(store)] == [("dismissed", "")]


def test_check_by_other_rules(store: Store, tmp_path: Path) -> None:
    lenient, strict = tmp_path / "lenient.toml", tmp_path / "strict.toml"
    lenient.write_text("[check]\nfail_on = []\nmin_frame_share = 0.1\n")
    assert run("check", "--rules", str(lenient)) == "3 flights pass\n"
    strict.write_text("[check]\nfail_on = ['dark_frames']\n[anomalies.dark_frames]\nmin_frames = 1\n")
    assert {row["rule"] for row in rows("check", "--rules", str(strict), code=4)} >= {"dark_frames"}
    (store.root / "rules.toml").write_text("[check]\nfail_on = []\nmin_frame_share = 0.1\n")
    index.publish(store)
    assert rows("check") == []


def test_priorities_choose_what_is_listed_and_what_fails(store: Store) -> None:
    assert {row["priority"] for row in rows("anomalies", "list")} == {"low"}
    assert rows("anomalies", "list", "--priority", "medium") == []
    (store.root / "rules.toml").write_text("[check]\nmin_frame_share = 0.1\n")
    index.publish(store)
    assert run("check", "--fail-on-priority", "medium") == "3 flights pass\n"
    assert {row["rule"] for row in rows("check", "--fail-on-priority", "low", code=4)} == {"dark_frames"}
    (store.root / "rules.toml").write_text('[anomalies.dark_frames]\npriority = "high"\n')
    index.publish(store)
    assert {row["kind"] for row in rows("anomalies", "list", "--priority", "high")} == {"dark_frames"}


def test_check_reports_rules_that_could_not_judge(store: Store) -> None:
    """Without the height above ground, spans are flown by and nothing can be said of them."""
    truth = replace(TRUTH, frames=[replace(frame, height_m=None) for frame in TRUTH.frames])
    inspected.write_truth(store, "blind", truth)
    import_spans(store, inspected.spans_of(TRUTH))
    (store.root / "rules.toml").write_text("[check]\nfail_on = ['conductor_gap']\nmin_frame_share = 0\n")
    index.publish(store)
    blind = made.flight_id_of("blind")
    done = CliRunner().invoke(cli.app, ["check", "--flight", blind[:8]])
    assert (done.exit_code, done.stdout) == (0, "1 flight passes\n")
    assert "conductor_gap: not judged on 3 of 3 spans: height above ground unknown" in done.stderr
    (shown,) = rows("flights", "show", blind[:8])
    assert shown["not_judged"] == ["conductor_gap: not judged on 3 of 3 spans: height above ground unknown"]
    assert shown["not_judged"][0] in run("flights", "show", blind[:8])
    shares = (
        "SELECT share, covered_m AS covered, unknown_m = length_m AS is_unknown"
        " FROM span_coverage WHERE flight_id = ?"
    )
    for row in select(store, shares, [blind]):
        assert (row["share"], row["covered"], row["is_unknown"]) == (None, None, True)
    with (store.root / "rules.toml").open("a") as file:
        file.write("fail_on_not_judged = true\n")
    index.publish(store)
    assert {row["rule"] for row in rows("check", "--flight", blind[:8], code=4)} == {"conductor_gap"}


def test_rules_of_the_store_are_those_of_the_index(store: Store) -> None:
    before = select(store, "SELECT * FROM anomalies WHERE kind = 'dark_frames'")
    (store.root / "rules.toml").write_text("[frames]\ndark_below_luma = 1.0\n")
    assert any("rules" in problem for problem in verify(store))
    index.publish(store)
    assert before
    assert not select(store, "SELECT * FROM anomalies WHERE kind = 'dark_frames'")
    assert verify(store) == ()


def test_flights_are_listed_shown_tagged_and_removed(store: Store) -> None:
    assert len(rows("flights", "list")) == 3
    run("flights", "tag", FAULTY[:9], "line=L12", "pilot=kim")
    run("flights", "tag", FAULTY[:9], "pilot=")
    (shown,) = rows("flights", "show", FAULTY[:9])
    assert (shown["flight_id"], shown["tags"], shown["n_frames"]) == (FAULTY, {"line": "L12"}, 32)
    assert "line=L12" in run("flights", "list")
    assert select(store, "SELECT * FROM flight_tags") == [
        {"flight_id": FAULTY, "key": "line", "value": "L12"}
    ]
    assert run("flights", "rm", FAULTY) == f"{FAULTY} removed\n"
    assert not store.flight_dir(FAULTY).exists()
    assert len(rows("flights", "list")) == 2
    assert verify(store) == ()
    for table in ("coverage", "coverage_bins", "coverage_gaps", "anomalies", "conductor_counts"):
        assert not select(store, f"SELECT * FROM {table} WHERE flight_id = ?", [FAULTY])
    run("flights", "tag", made.flight_id_of("old"), "nothing", code=2)
    for beginning, words in (("zz", "no flight begins"), ("0123456789ab", "no flight begins")):
        with pytest.raises(QueryError, match=words):
            CliRunner().invoke(cli.app, ["flights", "show", beginning], catch_exceptions=False)


def test_named_queries(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    answer_here(monkeypatch)
    for name, query in named_queries().items():
        values = [f"--param={parameter}={FAULTY[:8]}" for parameter in query.parameters]
        assert query.purpose
        assert f"{name}" in run("query", "--named", "list")
        assert run("query", "--named", name, "--show-sql") == query.sql.rstrip() + "\n"
        assert re.search(r"\d+ rows?\)$", run("query", "--named", name, *values))
    run("query", "--named", "flights", "SELECT 1", code=2)
    run("query", code=2)
    for arguments, words in (
        (["none"], "there are anomalies"),
        (["coverage"], "needs a value of flight, and no other"),
        (["flights", "--param", "x=1"], "takes no values"),
    ):
        with pytest.raises(QueryError, match=words):
            CliRunner().invoke(cli.app, ["query", "--named", *arguments], catch_exceptions=False)


def test_values_of_named_queries_are_values(store: Store) -> None:
    sql = named_queries()["gaps"].with_values({"flight": "a'); DROP TABLE flights; --"})
    assert "'a''); DROP TABLE flights; --'" in sql


def test_user_input_survives_a_torn_line(store: Store) -> None:
    run("flights", "tag", FAULTY, "a=1")
    with (store.root / "tags.jsonl").open("a") as file:
        file.write('{"flight_id": "x", "ke')
    run("flights", "tag", FAULTY, "b=2")
    assert {(tag.key, tag.value) for tag in load_tags(store)} == {("a", "1"), ("b", "2")}
    (store.root / "tags.jsonl").write_text('{"something": "else"}\n')
    with pytest.raises(StoreError, match="not a tag"):
        load_tags(store)
