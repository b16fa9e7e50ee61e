"""For tests of what is around them: a detector without a network, a folder that may not be read."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from lsnet.segments import Detections, Lines, Segments

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import pytest
    from numpy.typing import NDArray


def forbid(patch: pytest.MonkeyPatch, folder: Path) -> None:
    """Let nobody list a folder, whoever runs the tests."""
    scan = os.scandir

    def scandir(path: str) -> object:
        if os.fspath(path) == os.fspath(folder):
            raise PermissionError(13, "Permission denied", path)
        return scan(path)

    patch.setattr(os, "scandir", scandir)


class FakeDetector:
    """Finds as many segments as the number of the picture (see factories.picture), at most three."""

    def __init__(
        self, weights: str = "fast", scale: float | None = None, min_score: float | None = None
    ) -> None:
        self.description: dict[str, Any] = {
            "weights": weights,
            "weights_sha256": "ab" * 32,
            "preset": "fast",
            "backend": "fake",
            "precision": "f32",
            "scale": scale or 1.0,
            "min_score": 0.5 if min_score is None else min_score,
        }
        self.batch_sizes: list[int] = []
        self.threads, self.n_calls, self.n_images = 2, 2, 4

    @classmethod
    def load(
        cls,
        weights: str = "fast",
        *,
        runtime: str = "auto",
        device: str | None = None,
        threads: int | None = None,
        **options: float | None,
    ) -> FakeDetector:
        return cls(weights, **options)

    def describe(self) -> dict[str, Any]:
        return dict(self.description)

    def detect(self, images: Sequence[NDArray[np.uint8]], **_: object) -> list[Detections]:
        self.batch_sizes.append(len(images))
        return [self._detect(image) for image in images]

    def _detect(self, image: NDArray[np.uint8]) -> Detections:
        size = image.shape[:2]
        count = min(int(image[0, 0, 0]) // 4, 3)
        endpoints = np.array([[1, i + 0.5, 9, i + 4.5] for i in range(count)], np.float32).reshape(-1, 4)
        return Detections(Segments(endpoints, np.full(count, 0.75, np.float32), size), Lines.empty(size))
