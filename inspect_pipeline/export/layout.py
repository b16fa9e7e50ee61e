"""The layout of a flight for Lichtblick and Foxglove: annotations switched on, a topic in every panel.

A first-time user sees a bare picture otherwise, since both hide annotations until they are switched on.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from inspect_pipeline.annotations.schema import ANNOTATIONS_SUFFIX

if TYPE_CHECKING:
    from collections.abc import Sequence

NUMBERS_SUFFIX = "/lsnet/numbers"
TRACK_SUFFIX = "/lsnet/track"
ANOMALIES_TOPIC = "/lsnet/review/anomalies"
SPANS_TOPIC = "/lsnet/review/spans"
LOG_TOPIC = "/lsnet/review/log"

_CAMERAS = 4  # that get a panel of their own
_PLOTTED = {  # colour of each number that a plot shows at first; None for those that can be switched on
    "n_lines": "#e3218f",
    "n_conductors": "#4e98e2",
    "sharpness": None,
    "height_m": None,
    "gsd_m": None,
}


def make_layout(
    topics: Sequence[str], signals: Sequence[str], centre: tuple[float, float] | None
) -> dict[str, Any]:
    """Return the layout as viewers import it from a JSON file.

    Args:
        topics: of the cameras; the first few get a panel.
        signals: the names of the flight's signals.
        centre: latitude and longitude in degrees where the map begins; None for a flight without positions.
    """
    shown = list(topics[:_CAMERAS])
    images = {f"Image!lsnet{i}": _image_panel(topic) for i, topic in enumerate(shown)}
    plots = {f"Plot!lsnet{i}": _plot_panel(topic, signals) for i, topic in enumerate(shown[:1])}
    maps = {"map!lsnet": _map_panel(*centre)} if centre else {}
    log = {"RosOut!lsnet": _LOG_PANEL}
    left = _split("column", 72, _split_evenly(list(images)), _split_evenly(list(plots)))
    right = _split("column", 65, next(iter(maps), None), *log)
    return {
        "configById": {**images, **plots, **maps, **log},
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _split("row", 62, left, right),
    }


def _image_panel(topic: str) -> dict[str, Any]:
    return {
        "imageMode": {
            "imageTopic": topic,
            "annotations": {f"{topic}{ANNOTATIONS_SUFFIX}": {"visible": True}},
            "synchronize": True,
        },
        **_titled(topic),
    }


def _plot_panel(topic: str, signals: Sequence[str]) -> dict[str, Any]:
    numbers = f"{topic}{NUMBERS_SUFFIX}"
    paths = [
        {"value": f"{numbers}.{name}", "label": name, "enabled": colour is not None}
        | ({"color": colour} if colour else {})
        for name, colour in _PLOTTED.items()
    ]
    paths += [{"value": f"{numbers}.signals.{name}", "label": name, "enabled": False} for name in signals]
    return {
        "paths": [{**path, "timestampMethod": "receiveTime", "showLine": True} for path in paths],
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": True,
        "isSynced": True,
        "xAxisVal": "timestamp",
        "sidebarDimension": 240,
        **_titled("Lines and conductors in a frame"),
    }


def _map_panel(lat_deg: float, lon_deg: float) -> dict[str, Any]:
    """Return a map with a centre of its own: viewers know only those of some kinds of positions."""
    return {
        "center": {"lat": lat_deg, "lon": lon_deg},
        "customTileUrl": "",
        "disabledTopics": [],
        "followTopic": "",
        "layer": "map",
        "topicColors": {},
        "maxNativeZoom": 18,
        "zoomLevel": 17,
        **_titled("Track, spans and anomalies"),
    }


def _titled(title: str) -> dict[str, str]:
    return {"lichtblickPanelTitle": title, "foxglovePanelTitle": title}


_LOG_PANEL = {"searchTerms": [], "minLogLevel": 1, "topicToRender": LOG_TOPIC, **_titled("Anomalies")}


def _split(direction: str, percentage: int, first: Any, second: Any) -> Any:
    """Return two panels or splits side by side; one alone where the other is None."""
    if first is None or second is None:
        return first or second
    return {"direction": direction, "splitPercentage": percentage, "first": first, "second": second}


def _split_evenly(panels: Sequence[str]) -> Any:
    """Return panels one below the other, all of one height."""
    if len(panels) < 2:
        return panels[0] if panels else None
    return _split("column", round(100 / len(panels)), panels[0], _split_evenly(panels[1:]))
