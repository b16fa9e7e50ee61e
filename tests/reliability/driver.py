"""A batch with a stub detector, in a process of its own that tests can kill.

Arguments: inbox, store, folder for the notes of the stub, name of the weights, seconds per batch of images.
"""

from __future__ import annotations

import sys
from pathlib import Path

from stubs import MakeStub

from inspect_pipeline.batch import BatchOptions, run_batch
from inspect_pipeline.config import ProcessOptions
from inspect_pipeline.stopping import stop_on_signals
from inspect_pipeline.store import Store
from inspect_pipeline.worker import Job


def main() -> int:
    inbox, root, notes, weights, delay_s = sys.argv[1:]
    store = Store(Path(root))
    job = Job(store.root, ProcessOptions(), MakeStub(Path(notes), weights, float(delay_s)))
    options = BatchOptions((inbox,), n_workers=2, max_attempts=10, settle_s=0)
    with stop_on_signals() as stop:
        return run_batch(store, job, options, lambda event, **fields: None, stop).exit_code


if __name__ == "__main__":
    sys.exit(main())
