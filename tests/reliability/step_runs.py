"""Commands killed at every named step; like fault_runs.py, but on a good disk.

Arguments: a folder, the command, the step between the moments. A step is the call of a function of the
program. Steps between which the store is the same, byte for byte, leave the same to the next run: the moments
are before the first and before the last of such steps. Prints what was killed, as JSON.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

from factories import make_recording, shots
from fault_runs import prepare, run, warm_up
from stores import check_visible, contents, disk_state, file_names, where_states_change

from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from collections.abc import Callable


def profile(on_step: Callable[[str], object]) -> Callable[[Any, str, Any], None]:
    """Report the names of the program's functions before they are run."""

    def look(frame: Any, event: str, _argument: Any) -> None:
        module, name = frame.f_globals.get("__name__", ""), frame.f_code.co_qualname
        if event == "call" and module.startswith("inspect_pipeline") and "<" not in name:
            on_step(f"{module.removeprefix('inspect_pipeline.')}:{name}")

    return look


def watch(on_step: Callable[[str], object]) -> None:
    """Profile this thread and all that start from now on."""
    threading.setprofile(profile(on_step))
    sys.setprofile(profile(on_step))


def main() -> None:
    """Kill at every moment, and run again."""
    folder, command, step = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
    prepare(folder, command)
    inbox, messages = folder / "inbox", folder / "messages"
    inbox.mkdir()
    make_recording(inbox / "a.mcap", shots(3))

    def go(store: Store, weights: str, begin: Callable[[], object] = lambda: None) -> int:
        return run(command, inbox, store, weights, messages, begin)

    warm_up(folder, command, inbox)
    before, after = Store(folder / "before"), Store(folder / "after")
    assert go(before, "first") == 0, messages.read_text()
    make_recording(inbox / "b.mcap", shots(2))
    shutil.copytree(before.root, after.root)
    log = os.open(folder / "steps", os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def note(name: str) -> None:
        os.write(log, f"{disk_state(after)} {name}\n".encode())

    assert go(after, "second", lambda: watch(note)) == 0, messages.read_text()
    states, names = zip(*map(str.split, (folder / "steps").read_text().splitlines()), strict=True)
    chosen = where_states_change(states)[::step]
    moments = [(names[i], names[: i + 1].count(names[i])) for i in chosen]
    wanted = contents(after), file_names(after)

    for name, number in moments:
        store = Store(folder / "store")
        shutil.copytree(before.root, store.root)
        n_left = number

        def count(called: str, wanted: str = name) -> None:
            nonlocal n_left
            n_left -= called == wanted
            if n_left == 0:
                os.kill(os.getpid(), signal.SIGKILL)

        where = f"killed before call {number} of {name}"
        assert go(store, "second", lambda: watch(count)) == -signal.SIGKILL, where
        try:
            check_visible(store)
            assert go(store, "second") == 0, messages.read_text()
            assert (contents(store), file_names(store)) == wanted
        except Exception:
            print(where, file=sys.stderr)
            raise
        shutil.rmtree(store.root)
    report = {"n_steps": len(names), "n_states": len(set(states)), "n_kills": len(moments)}
    print(json.dumps({**report, "names": sorted({name.rsplit(":", 1)[1] for name in names})}))


if __name__ == "__main__":
    main()
