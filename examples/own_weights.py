"""Process a recording with weights of your own, made by `lsnet-pipe model export`.

Run `python own_weights.py WEIGHTS RECORDING STORE`. Without arguments, the shipped weights are used on one
short simulated flight, with a higher threshold.
"""

import sys
import tempfile
from pathlib import Path

from inspect_pipeline import ProcessOptions, SimulationOptions, process, simulate
from lsnet import Detector

if sys.argv[1:]:
    weights, recording, store = sys.argv[1:4]
else:
    scratch = Path(tempfile.mkdtemp())
    weights, recording, store = "fast", str(scratch / "flight.mcap"), str(scratch / "inspections")
    simulate(Path(recording), SimulationOptions(seconds=2, image_size=(360, 640)))

detector = Detector.load(weights, min_score=0.6)
result = process(recording, store, detector, ProcessOptions(every=2, write="none"))
print(f"{result.source}: {result.n_frames} frames by {detector.describe()['weights']}")
