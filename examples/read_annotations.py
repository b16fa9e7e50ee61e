"""Read the annotations of an annotated copy with the plain mcap reader, without this package.

Run `python read_annotations.py ANNOTATED.mcap`. Without an argument, one short flight is simulated and
processed first.
"""

import sys
import tempfile
from pathlib import Path

from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from mcap.reader import make_reader

if sys.argv[1:]:
    annotated = Path(sys.argv[1])
else:
    from inspect_pipeline import SimulationOptions, process, simulate

    scratch = Path(tempfile.mkdtemp())
    simulate(scratch / "flight.mcap", SimulationOptions(seconds=2, image_size=(360, 640)))
    annotated = process(scratch / "flight.mcap", scratch / "inspections").annotated

with annotated.open("rb") as file:
    reader = make_reader(file)
    topics = [
        channel.topic
        for channel in reader.get_summary().channels.values()
        if channel.topic.endswith("/lsnet/annotations")
    ]
    for _, channel, message in reader.iter_messages(topics):
        lines = [points for points in ImageAnnotations.FromString(message.data).points if points.points]
        print(f"{message.log_time} {channel.topic}: {len(lines)} lines")
