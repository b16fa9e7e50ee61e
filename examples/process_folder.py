"""Process every recording of a folder, bring the results into the index, and list the flights.

Run `python process_folder.py FOLDER STORE`. Without arguments, one short flight is simulated first.
"""

import sys
import tempfile
from pathlib import Path

from inspect_pipeline import InspectError, SimulationOptions, process, publish, query, simulate

scratch = Path(tempfile.mkdtemp())
folder = Path(sys.argv[1]) if sys.argv[1:] else scratch
store = Path(sys.argv[2]) if sys.argv[2:] else scratch / "inspections"

if not sys.argv[1:]:
    simulate(folder / "flight.mcap", SimulationOptions(seconds=3, image_size=(360, 640)))

for path in sorted(folder.glob("*.mcap")):
    try:
        result = process(path, store)
    except InspectError as error:  # one line that names the file and says what to do
        print(f"error: {error}", file=sys.stderr)
        continue
    print(f"{path.name}: {result.status}, {result.n_frames} frames, {result.n_bad_frames} bad")

publish(store)
for flight_id, n_frames, n_lines in query(
    store, "SELECT flight_id, n_frames, n_lines FROM flights ORDER BY start_ns"
).fetchall():
    print(f"{flight_id[:16]}  {n_frames} frames  {n_lines} lines")
