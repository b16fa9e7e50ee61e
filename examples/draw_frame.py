"""Detect the lines of one frame of a recording and draw them, without a store.

Run `python draw_frame.py RECORDING PICTURE`. Without arguments, one short flight is simulated first.
"""

import sys
import tempfile
from pathlib import Path

from inspect_pipeline import SimulationOptions, iter_frames, open_recording, simulate
from inspect_pipeline.images.draw import draw_lines, track_colours, write_picture
from lsnet import Detector

scratch = Path(tempfile.mkdtemp())
recording = Path(sys.argv[1]) if sys.argv[1:] else scratch / "flight.mcap"
picture = Path(sys.argv[2]) if sys.argv[2:] else scratch / "frame.png"

if not sys.argv[1:]:
    simulate(recording, SimulationOptions(seconds=1))

frames = iter_frames(open_recording(recording))
frame = next(frame for frame in frames if frame.image is not None)
(detections,) = Detector.load().detect([frame.image])
lines = detections.lines
write_picture(picture, draw_lines(frame.image, lines.points, track_colours(range(len(lines)))))
print(f"{picture}: frame {frame.frame_idx} of {frame.topic}, {len(lines)} lines")
