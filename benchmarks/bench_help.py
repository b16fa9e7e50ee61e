"""`lsnet-pipe --help` from a shell, against Python that only imports typer."""

from __future__ import annotations

import subprocess
import sys
from functools import partial

from measure import alternate, conclude, measured, median_ratio, print_run, print_table

N_ROUNDS = 9
BARS = {"seconds": (0.0, 0.5)}
METHODS = {
    "help": [sys.executable, "-m", "cli", "--help"],
    "typer": [sys.executable, "-c", "import typer"],
}


def main() -> int:
    runs = alternate(__file__, METHODS, N_ROUNDS)
    print_table(runs)
    seconds = min(run.seconds for run in runs["help"])
    return conclude("help", {"times_typer": median_ratio(runs, "typer", "help"), "seconds": seconds}, BARS)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        run = partial(subprocess.run, METHODS[sys.argv[1]], check=True, stdout=subprocess.DEVNULL)
        print_run(measured(run))
    else:
        sys.exit(main())
