"""Measured times are CPU times."""

from __future__ import annotations

import time

from lsnet.evaluation.speed import least_cpu_ms


class Busy:
    """A backend that computes for 3 ms, then waits for 10; the second frame takes longer."""

    name, precision, threads = "fake", "f32", 1

    def __init__(self) -> None:
        self.sizes: list[tuple[int, ...]] = []

    def run(self, images: list) -> list:
        self.sizes += [image.shape for image in images]
        until = time.process_time_ns() + (20 if len(self.sizes) == 2 else 3) * 1_000_000
        while time.process_time_ns() < until:
            pass
        time.sleep(0.01)
        return []


def test_least_cpu_time_of_all_repeats_is_returned() -> None:
    backend = Busy()
    assert 3 <= least_cpu_ms(backend, size=64, repeats=5) < 9
    assert backend.sizes == [(64, 64, 3)] * 6  # the first one warms up
