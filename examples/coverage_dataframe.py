"""Read the coverage of all flights of a store as a pandas DataFrame (`pip install pandas`).

Run `python coverage_dataframe.py STORE`. Without an argument, one short flight is simulated first.
"""

import sys
import tempfile
from pathlib import Path

from inspect_pipeline import SimulationOptions, process, publish, query, simulate

COVERAGE = """
SELECT f.source_uri, c.kind, c.unit, c.total, c.covered, c.share
FROM coverage AS c
JOIN flights AS f USING (flight_id)
WHERE c.channel_id IS NULL
ORDER BY f.start_ns, c.kind, c.span_id
"""

if sys.argv[1:]:
    store = Path(sys.argv[1])
else:
    scratch = Path(tempfile.mkdtemp())
    store = scratch / "inspections"
    simulate(scratch / "flight.mcap", SimulationOptions(seconds=3, image_size=(360, 640)))
    process(scratch / "flight.mcap", store)
    publish(store)

coverage = query(store, COVERAGE).df()
print(coverage.to_string(index=False))
