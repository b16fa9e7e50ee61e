"""Compare lines judged by their tracks with those of single frames, on drawn flights and on recordings.

    python benchmarks/bench_track_support.py [--ground PHOTO ...] [--wire-free RECORDING ...] [--seeds 1]

Recall is the share of the length of visible conductors within 3 px of a reported line, precision the reverse.
`lower` has no tracks, but a lower least score: the lowest that is as precise as the lines judged by tracks.
`faint` pictures have less contrast, noise, and strong compression. Recordings named as free of wires should
not get more lines by their tracks.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import defaultdict
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from measure import conclude
from scipy.spatial import cKDTree

from inspect_pipeline.config import PlacingOptions
from inspect_pipeline.detection import ProcessedFrame, StageTimes, judge_by_tracks
from inspect_pipeline.georeference.frames import Georeferencer
from inspect_pipeline.recording.frames import iter_undecoded
from inspect_pipeline.recording.reader import open_recording
from inspect_pipeline.simulation.options import FlightKind, SimulationOptions, TowerKind, WeatherKind
from inspect_pipeline.simulation.truth import simulate_truth
from inspect_pipeline.simulation.write import simulate_flight
from inspect_pipeline.tracking.support import candidate_score
from lsnet import Detector

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from inspect_pipeline.simulation.records import FrameTruth
    from lsnet.arrays import Floats, ImageArray
    from lsnet.segments import Lines

RATES = {1.0: 40.0, 4.0: 20.0, 30.0: 5.0}  # images a second, and seconds of flight
FLIGHTS = (
    SimulationOptions(image_size=(360, 640)),
    SimulationOptions(image_size=(360, 640), n_bundle=2, weather=WeatherKind.LOW_SUN),
    SimulationOptions(image_size=(360, 640), flight=FlightKind.ORBIT, towers=TowerKind.STEEL),
    SimulationOptions(image_size=(360, 640), flight=FlightKind.LOSS, weather=WeatherKind.HAZE),
)
_TOLERANCE_PX, _STEP_PX = 3.0, 2.0
_CONTRAST, _NOISE, _JPEG_QUALITY = 0.6, 10.0, 40


def faint(image: ImageArray, number: int) -> ImageArray:
    """Return an image of less contrast, with noise, compressed."""
    noise = np.random.default_rng(number).normal(0, _NOISE, image.shape)
    pixels = np.clip(128 + (image.astype(float) - 128) * _CONTRAST + noise, 0, 255).astype(np.uint8)
    data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1]
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)


def unchanged(image: ImageArray, _number: int) -> ImageArray:
    """Return the image."""
    return image


PICTURES = {"clear": unchanged, "faint": faint}


def detect_recording(
    path: Path, detector: Detector, change: Callable[[ImageArray, int], ImageArray] = unchanged
) -> list[ProcessedFrame]:
    """Return the frames of a recording with their poses and lines, candidates included."""
    recording = open_recording(path)
    georeferencer, found = Georeferencer.of(recording, PlacingOptions()), []
    for undecoded in iter_undecoded(recording, recording.select_cameras(None)):
        frame = undecoded.decode()
        if frame.image is None:
            continue
        image = change(frame.image, frame.frame_idx)
        lines = detector.detect([image], min_line_score=candidate_score(detector.min_score))[0]
        pose = georeferencer.place(frame)
        found.append(ProcessedFrame(replace(frame, image=None), detections=lines, pose=pose))
    return found


def lines_of(frames: Iterable[ProcessedFrame]) -> list[Lines]:
    """Return the lines of each frame."""
    return [each.detections.lines for each in frames if each.detections]


def judged(frames: list[ProcessedFrame], min_score: float) -> list[Lines]:
    """Return the lines of each frame as `process` reports them."""
    return lines_of(judge_by_tracks(frames, min_score, StageTimes()))


def sampled(polylines: Iterable[Floats]) -> Floats:
    """Return points (N, 2) at equal distances along polylines."""
    points = [np.zeros((0, 2))]
    for polyline in polylines:
        along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(polyline, axis=0).T))))
        at = np.arange(_STEP_PX / 2, along[-1], _STEP_PX)
        points.append(np.column_stack([np.interp(at, along, polyline[:, i]) for i in (0, 1)]))
    return np.concatenate(points)


def n_near(points: Floats, others: Floats, distance_px: float) -> int:
    """Return how many points are near any other."""
    if not len(points) or not len(others):
        return 0
    return int((cKDTree(others).query(points)[0] <= distance_px).sum())


def count(lines: Lines, truth: FrameTruth) -> Floats:
    """Return lengths in steps: reported, of that right, of conductors, of these found."""
    reported, conductors = sampled(lines.points), sampled(line.points for line in truth.lines)
    near_px = _TOLERANCE_PX + max((line.width_px.max() / 2 for line in truth.lines), default=0.0)
    right, found = n_near(reported, conductors, near_px), n_near(conductors, reported, near_px)
    return np.array([len(reported), right, len(conductors), found], float)


def scores_of(counts: Floats) -> tuple[float, float, float]:
    """Return precision, recall and F."""
    precision, recall = counts[1] / max(counts[0], 1), counts[3] / max(counts[2], 1)
    return precision, recall, 2 * precision * recall / max(precision + recall, 1e-9)


def compare(
    flights: list[SimulationOptions], detector: Detector
) -> dict[tuple[str, str], tuple[float, float, float]]:
    """Return precision, recall and F over some flights, of each kind of pictures and way to choose lines."""
    least = detector.min_score
    thresholds = np.linspace(candidate_score(least), least, 5).tolist()
    counts: defaultdict[tuple[str, object], Floats] = defaultdict(lambda: np.zeros(4))
    for options in flights:
        truth = [frame for frame in simulate_truth(options).frames if not frame.dropped]
        for kind, frames in _detected(options, detector):
            ways: dict[object, list[Lines]] = {"tracks": judged(frames, least)}
            ways |= {score: [lines.above(score) for lines in lines_of(frames)] for score in thresholds}
            for way, chosen in ways.items():
                counts[kind, way] += sum(count(*pair) for pair in zip(chosen, truth, strict=True))
    table = {}
    for kind in PICTURES:
        table[kind, "alone"] = scores_of(counts[kind, least])
        table[kind, "tracks"] = scores_of(counts[kind, "tracks"])
        lower = [scores_of(counts[kind, score]) for score in thresholds]
        as_precise = [found for found in lower if found[0] >= table[kind, "tracks"][0]]
        table[kind, "lower"] = max(as_precise, key=lambda found: found[1], default=lower[-1])
    return table


def _detected(options: SimulationOptions, detector: Detector) -> Iterator[tuple[str, list[ProcessedFrame]]]:
    """Draw a flight; yield the frames of each kind of pictures."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight.mcap"
        simulate_flight(path, options)
        for kind, change in PICTURES.items():
            yield kind, detect_recording(path, detector, change)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--ground", type=Path, nargs="*", default=[], metavar="PHOTO")
    parser.add_argument("--wire-free", type=Path, nargs="*", default=[], metavar="RECORDING")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first-seed", type=int, default=300)
    arguments = parser.parse_args()
    detector = Detector.load(threads=1)
    figures: dict[str, float] = {}
    bars: dict[str, tuple[float, float]] = {}
    print(f"{'a second':>8}  {'pictures':8}  {'lines':8}  {'precision':>9}  {'recall':>6}  {'F':>6}")
    for fps, seconds in RATES.items():
        grounds = cycle(arguments.ground or [None])
        flights = [
            replace(one, fps=fps, seconds=seconds, seed=seed, ground=next(grounds))
            for seed in range(arguments.first_seed, arguments.first_seed + arguments.seeds)
            for one in FLIGHTS
        ]
        for (kind, way), found in compare(flights, detector).items():
            key = f"{kind}_{fps:g}_{way}"
            figures |= dict(zip((f"{key}_precision", f"{key}_recall", f"{key}_f"), found, strict=True))
            numbers = f"{found[0]:9.3f}  {found[1]:6.3f}  {found[2]:6.3f}"
            print(f"{fps:8g}  {kind:8}  {way:8}  {numbers}", flush=True)
        bars |= {f"{kind}_{fps:g}_tracks_f": (figures[f"{kind}_{fps:g}_alone_f"], 1.0) for kind in PICTURES}
    for path in arguments.wire_free:
        frames = detect_recording(path, detector)
        alone = sum(len(lines.above(detector.min_score)) for lines in lines_of(frames))
        by_tracks = sum(len(lines) for lines in judged(frames, detector.min_score))
        print(f"{path.name}: {alone} false lines, {by_tracks} judged by tracks")
        figures[f"{path.stem}_lines"] = by_tracks
        bars[f"{path.stem}_lines"] = (0, alone)
    return conclude("track_support", figures, bars)


if __name__ == "__main__":
    raise SystemExit(main())
