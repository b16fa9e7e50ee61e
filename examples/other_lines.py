"""Teach LS-Net another linear structure: the two rails of a track, or the two edges of a pipeline.

Run `python other_lines.py FOLDER STEPS`: it draws labelled images as labelme would label them, trains the
shipped network further on them, and prints how much of the rails each of the two finds. Without arguments, it
takes a few steps only, to show the way. With photographs of your own: `lsnet-pipe model train --data`.
"""

import json
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

from lsnet.evaluation.cables import evaluate_cables
from lsnet.evaluation.compare.compare import grids_of
from lsnet.training.labels import LabelledScenes, load_labels
from lsnet.training.recipe import TrainConfig
from lsnet.training.trainer import Trainer
from lsnet.weights import load_weights

SIZE_PX, SLEEPER_PX = 256, 18


def draw(folder: Path, count: int, first: int) -> None:
    """Draw straight tracks and pipelines; their rails and edges are the lines, sleepers are not."""
    folder.mkdir(parents=True, exist_ok=True)
    for i in range(first, first + count):
        rng = np.random.default_rng(i)
        image = rng.normal(110, 25, (SIZE_PX, SIZE_PX, 3)).clip(0, 255).astype(np.uint8)
        angle, gauge = rng.uniform(0, np.pi), rng.uniform(22, 40)
        along = np.array([np.cos(angle), np.sin(angle)])
        across = np.array([-along[1], along[0]]) * gauge / 2
        middle = rng.uniform(0.3, 0.7, 2) * SIZE_PX
        ends = [middle - along * 400, middle + along * 400]
        sides = [[end + side * across for end in ends] for side in (-1, 1)]
        if i % 2:  # a pipeline: wide, so its two edges are the lines
            pipe = np.array([*sides[0], *sides[1][::-1]], np.int32)
            cv2.fillConvexPoly(image, pipe, rng.uniform(150, 230, 3).tolist(), cv2.LINE_AA)
        else:
            for at in np.arange(-400, 400, SLEEPER_PX):
                sleeper = [middle + at * along + side * across * 1.5 for side in (-1, 1)]
                cv2.line(image, *(tuple(p.astype(int).tolist()) for p in sleeper), (70, 60, 55), 6)
            for side in sides:
                cv2.line(image, *(tuple(p.astype(int).tolist()) for p in side), (190, 185, 180), 3)
        cv2.imwrite(str(folder / f"{i:04d}.png"), image)
        shapes = [
            {"label": "line", "shape_type": "line", "points": np.array(side).tolist()} for side in sides
        ]
        content = {"imageHeight": SIZE_PX, "imageWidth": SIZE_PX, "shapes": shapes}
        (folder / f"{i:04d}.json").write_text(json.dumps(content))


folder, steps = (Path(sys.argv[1]), int(sys.argv[2])) if sys.argv[1:] else (Path(tempfile.mkdtemp()), 2)
is_long = steps > 100
draw(folder / "train", 64 if is_long else 4, first=0)
draw(folder / "validation", 16 if is_long else 2, first=1000)
train_on, validate_on = (
    LabelledScenes(load_labels(folder / name), SIZE_PX if is_long else 96, seed)
    for seed, name in enumerate(("train", "validation"))
)
config = TrainConfig(
    steps=steps,
    batch_size=4,
    learning_rate=1e-3,
    warmup_steps=1,
    validate_every=max(1, steps // 4),
    validation_images=8 if is_long else 2,
    workers=0,
    data="rails and pipelines",
)
trainer = Trainer(config, folder / "run", start="fast")
trainer.run(train_on, validate_on, report=lambda _progress: None)
nets = {"shipped weights": load_weights("fast").net, f"after {trainer.step} steps": trainer.average}
for name, net in nets.items():
    report = evaluate_cables(grids_of(net.eval())("MHVC"), validate_on, 16 if is_long else 2, min_score=0.5)
    print(f"{name}: {report.covered_share:.0%} of rails and edges found, {report.false_px:.0f} px elsewhere")
