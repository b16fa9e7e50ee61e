"""Figures of a page: a picture kept with the flight, with the lines of its frame and the mark over it."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import TYPE_CHECKING

from inspect_pipeline.images.draw import track_colours
from inspect_pipeline.report.thumbnails import FOLDER, is_made

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from inspect_pipeline.report.data import Row
    from inspect_pipeline.report.evidence import Crop, Evidence, FlightEvidence


@dataclass(frozen=True, slots=True)
class FigureLine:
    """A line of a frame, as the value of the SVG attribute `points`, px of the frame."""

    points: str
    colour: str
    title: str


@dataclass(frozen=True, slots=True)
class Figure:
    """A frame, and a crop where something in it is marked. Sources are None where the picture is missing."""

    frame_idx: int
    width: int
    height: int
    source: str | None
    lines: list[FigureLine]
    mark: tuple[float, float, float] | None
    crop: Crop | None
    crop_source: str | None


def make_figures(
    flight_folder: Path, evidence: FlightEvidence
) -> tuple[dict[str, Figure], dict[str, Figure]]:
    """Return the figures of anomalies by anomaly_id, and of spans by span_id."""
    folder = flight_folder / FOLDER

    def to_figure(one: Evidence) -> Figure:
        frame, *crops = one.picture_names
        return Figure(
            frame_idx=one.frame_idx,
            width=one.width,
            height=one.height,
            source=_data_uri(folder / frame),
            lines=_to_lines(evidence.lines.get(one.key, [])),
            mark=one.mark,
            crop=one.crop,
            crop_source=_data_uri(folder / crops[0]) if crops else None,
        )

    of_anomalies = {anomaly_id: to_figure(one) for anomaly_id, one in evidence.of_anomalies.items()}
    return of_anomalies, {span_id: to_figure(one) for span_id, one in evidence.of_spans.items()}


def _data_uri(path: Path) -> str | None:
    if not is_made(path):
        return None
    return "data:image/jpeg;base64," + base64.b64encode(path.read_bytes()).decode()


def _to_lines(rows: Sequence[Row]) -> list[FigureLine]:
    colours = track_colours([row["track_id"] for row in rows]).tolist()
    return [
        FigureLine(
            points=" ".join(f"{x:.0f},{y:.0f}" for x, y in row["points"]),
            colour="#{:02x}{:02x}{:02x}".format(*colour),
            title=f"score {row['score']:.2f}"
            + ("" if row["track_id"] is None else f", track {row['track_id']}"),
        )
        for row, colour in zip(rows, colours, strict=True)
    ]
