"""The page of a flight: rows of the index and pictures, arranged for its template."""

from __future__ import annotations

import json
from itertools import groupby
from typing import TYPE_CHECKING, Any

from inspect_pipeline.index.inspected import load_store_rules
from inspect_pipeline.inspection.rules import PRIORITIES
from inspect_pipeline.report import words
from inspect_pipeline.report.charts import draw_timeline
from inspect_pipeline.report.data import load_flight
from inspect_pipeline.report.evidence import load_evidence
from inspect_pipeline.report.figures import make_figures
from inspect_pipeline.report.map import draw_map
from inspect_pipeline.report.page import load_assets, render
from inspect_pipeline.store.images import source_path

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from inspect_pipeline.report.data import FlightData, Row
    from inspect_pipeline.report.page import Serving
    from inspect_pipeline.store.store import Store

_N_FIRST = 6  # findings named on the first screen


def render_flight(store: Store, flight_id: str, serving: Serving | None = None) -> str:
    """Return the page of a flight, with buttons where it is served. Raises StoreError, RulesError."""
    scripts = ("page.js", "review.js") if serving else ("page.js",)
    data, evidence = load_flight(store, flight_id), load_evidence(store, flight_id)
    figures, span_figures = make_figures(store.flight_dir(flight_id), evidence)
    spans = {row["span_id"]: f"span-{number}" for number, row in enumerate(data.spans, 1)}
    judged = _judge_spans(data, load_store_rules(store).check["min_judged_share"])
    flown = [row["span_id"] for row in data.spans if row["passed_m"] >= row["length_m"] / 2]
    numbers = {row["anomaly_id"]: number for number, row in enumerate(data.anomalies, 1)}
    return render(
        "flight.html",
        assets=load_assets(*scripts, serving=serving),
        serving=serving,
        data=data,
        name=source_path(data.flight["source_uri"]).name,
        map=draw_map(
            spans=data.spans,
            stretches=data.stretches,
            frames=data.frames,
            gaps=data.gaps,
            anomalies=data.anomalies,
            targets=spans,
        ),
        timeline=draw_timeline(data),
        tiles=_coverage_tiles(data),
        open_counts=count_open(data.anomalies),
        first_findings=[row for row in data.anomalies if row["verdict"] == "open"][:_N_FIRST],
        groups=_group_findings(data),
        numbers=numbers,
        figures=figures,
        span_figures=span_figures,
        span_targets=spans,
        judged=judged,
        decided=[row for row in data.anomalies if row["verdict"] != "open"],
        config=_flatten(json.loads(data.settings["config"] or "{}")),
        n_flown=len(flown),
        n_judged=sum(not judged.get(span_id, {"why_not": True})["why_not"] for span_id in flown),
    )


def count_open(anomalies: Sequence[Row]) -> dict[str, int]:
    """Return how many anomalies of each priority are not decided."""
    is_open = [row["priority"] for row in anomalies if row["verdict"] == "open"]
    return {priority: is_open.count(priority) for priority in PRIORITIES}


def _coverage_tiles(data: FlightData) -> list[dict[str, Any]]:
    """Return title, share, definition, and in words what is not known, of the four kinds of coverage."""
    known = {row["kind"]: row for row in data.coverage if row["unit"] != "m" or row["kind"] == "corridor"}
    tiles = []
    for kind, (title, definition) in words.COVERAGE.items():
        share = data.flight[f"{kind}_coverage"]
        reason = known.get(kind, {}).get("reason") if kind != "span" else _span_reason(data)
        tiles.append({"title": title, "share": share, "definition": definition, "reason": reason})
    return tiles


def _span_reason(data: FlightData) -> str | None:
    """Return why the coverage of spans is not known, or not all of it."""
    if not data.spans:
        return data.unplaced_reason or "no span near the path; import some by lsnet-pipe spans import"
    reasons = [row["reason"] for row in data.spans if row["reason"]]
    return max(dict.fromkeys(reasons), key=reasons.count) if reasons else None


def _group_findings(data: FlightData) -> list[dict[str, Any]]:
    """Return findings by span, in the order of lines and spans, and last those of the recording itself."""
    spans = {row["span_id"]: row for row in data.spans}
    order = {span_id: number for number, span_id in enumerate(spans)}
    last = len(order)
    findings = sorted(data.anomalies, key=lambda row: order.get(row["span_id"], last))
    return [
        {"span": spans.get(rows[0]["span_id"]), "findings": rows}
        for _, group in groupby(findings, key=lambda row: order.get(row["span_id"], last))
        if (rows := list(group))
    ]


def _judge_spans(data: FlightData, min_share: float) -> Mapping[str, dict[str, Any]]:
    """Return by span how many of the rules judged enough of it, and the others with their reason."""
    judged: dict[str, dict[str, Any]] = {}
    for row in data.judged:
        own = judged.setdefault(row["span_id"], {"n_rules": 0, "n_judged": 0, "why_not": {}})
        own["n_rules"] += 1
        if row["judged_m"] >= min_share * row["length_m"]:
            own["n_judged"] += 1
        else:
            own["why_not"].setdefault(row["why_not"], []).append(row["kind"])
    return judged


def _flatten(config: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str | None]]:
    """Return the settings of a run in one list, those of groups behind the name of the group."""
    flat: list[tuple[str, str | None]] = []
    for key, value in config.items():
        if isinstance(value, dict):
            flat += _flatten(value, f"{prefix}{key} ")
        else:
            flat.append((prefix + key, None if value is None else json.dumps(value).strip('"')))
    return flat
