"""The four ablations of the paper (Section IV-B): strides or pooling, grids, regression loss, cells' loss.

Scored as there: segments 1 px wide, threshold 0.5, per image. The published figures are on the set of Yetgin
and Gerek; beside figures on other sets they show the order of the methods only.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from statistics import fmean, stdev
from typing import TYPE_CHECKING, Any, NamedTuple

from lsnet.errors import LSNetError
from lsnet.evaluation.compare.compare import grids_of
from lsnet.evaluation.compare.trainings import Trainings, Variant
from lsnet.evaluation.paper import ABLATED, PaperProtocol, evaluate_as_paper
from lsnet.network_config import PRESETS, LSNetConfig
from lsnet.training.losses import MultiTaskLoss
from lsnet.training.options import with_options
from lsnet.training.tasks import LSNetTask

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from torch import nn

    from lsnet.evaluation.pixels import LineDetector

ALL_GRIDS = "MHVC"


class Published(NamedTuple):
    """The paper's figures of one method."""

    apr: float | None
    arr: float | None
    f1: float | None


class Method(NamedTuple):
    """One row of the paper's tables: how it differs from LS-Net, and its figures."""

    name: str
    published: Published
    grids: str = ALL_GRIDS
    network: str | None = None
    loss: str | None = None


_LSNET = Published(0.8004, 0.5368, 0.5940)
ABLATIONS: dict[str, tuple[Method, ...]] = {
    "downsample": (
        Method("LS-Net-P", Published(0.7828, 0.5378, 0.5885), network="downsample=pool"),
        Method("LS-Net-S", _LSNET),
    ),
    "grids": (
        Method("LS-Net-1-M", Published(0.8312, 0.3791, 0.4847), "M"),
        Method("LS-Net-2-MH", Published(0.8174, 0.4717, 0.5540), "MH"),
        Method("LS-Net-2-MV", Published(0.8173, 0.4703, 0.5533), "MV"),
        Method("LS-Net-2-MC", Published(0.8165, 0.4776, 0.5574), "MC"),
        Method("LS-Net-3-MHC", Published(0.8080, 0.5121, 0.5792), "MHC"),
        Method("LS-Net-3-MVC", Published(0.8080, 0.5117, 0.5791), "MVC"),
        Method("LS-Net-3-MVH", Published(0.8064, 0.5165, 0.5826), "MVH"),
        Method("LS-Net-4-MHVC", _LSNET),
    ),
    "regression": (
        Method("LS-Net-2 (L2)", Published(0.7277, 0.5789, 0.5866), loss="regression=l2"),
        Method("LS-Net-1 (L1)", Published(0.7032, 0.5694, 0.5765), loss="regression=l1"),
        Method("LS-Net-S (Smooth L1)", Published(0.7317, 0.5495, 0.5728), loss="regression=smooth_l1"),
        Method("LS-Net-W (Wing)", _LSNET),
    ),
    "classification": (
        Method("LS-Net-CE", Published(0.7946, 0.5353, 0.5899), loss="classification=cross_entropy"),
        Method("LS-Net-FL", _LSNET),
    ),
}


@dataclass(frozen=True, slots=True)
class AblationRow:
    """One method on one set: APR, ARR and F1 of each seed, and the paper's.

    `leads` is by how much its F1 is above that of LS-Net itself with the same seed, which means with the same
    crops in the same order: what they do to both is not in its deviation. Empty for LS-Net itself.
    """

    what: str
    method: str
    folder: str
    values: list[list[float]]
    published: Published
    leads: list[float] = field(default_factory=list)

    @classmethod
    def heads(cls) -> list[str]:
        """Return the heads of the columns of a table."""
        return ["method", "set", "APR", "ARR", "F1", "F1 above LS-Net", "paper: APR", "ARR", "F1"]

    def cells(self) -> list[str]:
        """Return the cells of a table: means and, of several seeds, standard deviations."""
        measured = [_spread([seed[k] for seed in self.values]) for k in range(3)]
        measured.append(_spread(self.leads, "+.3f") if self.leads else "-")
        published = ["-" if value is None else f"{value:.4f}" for value in self.published]
        return [self.method, self.folder.rpartition("/")[2], *measured, *published]


def _spread(values: Sequence[float], how: str = ".3f") -> str:
    mean = f"{fmean(values):{how}}"
    return f"{mean} ± {stdev(values):.3f}" if len(values) > 1 else mean


def with_leads(rows: Sequence[AblationRow], own: str) -> list[AblationRow]:
    """Return the rows of one table with their leads over the method `own`; of as many seeds only."""
    bases = {row.folder: [f1 for _, _, f1 in row.values] for row in rows if row.method == own}
    return [
        row
        if row.method == own or len(row.values) != len(bases[row.folder])
        else replace(
            row, leads=[f1 - base for (_, _, f1), base in zip(row.values, bases[row.folder], strict=True)]
        )
        for row in rows
    ]


def thin_paper(thinner: int) -> LSNetConfig:
    """Return the network of the paper with a fraction of its channels.

    Raises:
        LSNetError: The channels of its first stage are no multiple of the divisor.
    """
    network = PRESETS["paper"]
    if network.stage_channels[0] % thinner:
        raise LSNetError(f"channels cannot be divided by {thinner}; give 1, 2, 4 or 8")
    channels = tuple(c // thinner for c in network.stage_channels)
    return replace(network, stage_channels=channels, head_channels=network.head_channels // thinner)


def chosen(names: Sequence[str], known: Sequence[str]) -> list[str]:
    """Return the known methods of these names; all of them for none. Raises LSNetError for another name."""
    unknown = [name for name in names if name not in known]
    if unknown:
        raise LSNetError(f"no method {unknown[0]!r} to train; choose of {', '.join(known)}")
    return [name for name in known if not names or name in names]


def methods_of(what: Sequence[str], only: Sequence[str] = ()) -> list[tuple[str, Method]]:
    """Return the methods of some ablations, with the ablation.

    Args:
        what: Ablations.
        only: Of the methods that need a training of their own, these; all of them for none.

    Raises:
        LSNetError: No method of these ablations has such a name.
    """
    methods = [(name, method) for name in what for method in ABLATIONS[name]]
    kept = chosen(only, [method.name for _, method in methods if method.network or method.loss])
    return [(name, m) for name, m in methods if m.name in kept or not (m.network or m.loss)]


def ablate(
    trainings: Trainings,
    network: LSNetConfig,
    seeds: int,
    what: Sequence[str] = tuple(ABLATIONS),
    only: Sequence[str] = (),
) -> list[AblationRow]:
    """Train the methods of some ablations with several seeds, where there is no result yet.

    LS-Net itself is in all four and is trained once; that is also what is scored with some of its grids.

    Args:
        trainings: The drawn set and the results so far.
        network: LS-Net itself.
        seeds: Trainings of each method.
        what: Ablations.
        only: As in `methods_of`.

    Raises:
        LSNetError: As of `Trainings.score` and `methods_of`.
    """
    tables: dict[str, list[AblationRow]] = {}
    for name, method in methods_of(what, only):
        found = [_score(trainings, network, method, seed) for seed in range(seeds)]
        tables.setdefault(name, []).extend(
            AblationRow(name, method.name, folder, [scores[folder] for scores in found], method.published)
            for folder in found[0]
        )
    return _all_with_leads(tables)


def _all_with_leads(tables: dict[str, list[AblationRow]]) -> list[AblationRow]:
    """LS-Net itself is the last method of each table."""
    return [row for name, rows in tables.items() for row in with_leads(rows, ABLATIONS[name][-1].name)]


def count_trainings(seeds: int, what: Sequence[str], only: Sequence[str] = ()) -> int:
    """Return how often `ablate` asks for a trained network."""
    return seeds * len(methods_of(what, only))


def _score(trainings: Trainings, network: LSNetConfig, method: Method, seed: int) -> dict[str, list[float]]:
    task = LSNetTask(
        with_options(network, [method.network] if method.network else []),
        with_options(MultiTaskLoss(), [method.loss] if method.loss else []),
    )
    sets = trainings.sets
    # LS-Net itself is scored with all combinations of its grids at once.
    shown = [m.grids for m in ABLATIONS["grids"]] if task == LSNetTask(network) else [method.grids]

    def score(net: nn.Module) -> dict[str, Any]:
        open_grids = grids_of(net)
        return {grids: ablated_scores(open_grids(grids), sets) for grids in shown}

    scores = trainings.score(Variant(method.name, task, seed), "ablation", score).scores
    found: dict[str, list[float]] = scores[method.grids]
    return found


def ablate_grids(open_grids: Callable[[str], LineDetector], sets: Sequence[Path]) -> list[AblationRow]:
    """Return the ablation of the grids for weights that are trained; `open_grids` opens their detector.

    Raises:
        LSNetError: A folder has no images or no pixel truth.
    """
    rows = []
    for method in ABLATIONS["grids"]:
        scores = ablated_scores(open_grids(method.grids), sets)
        rows += [AblationRow("grids", method.name, str(f), [scores[str(f)]], method.published) for f in sets]
    return _all_with_leads({"grids": rows})


def ablated_scores(detector: LineDetector, sets: Sequence[Path]) -> dict[str, list[float]]:
    """Return APR, ARR and F1 by set, 1 px wide from score 0.5. Raises LSNetError for a set without truth."""
    found = {}
    for folder in sets:
        scores = evaluate_as_paper(detector, folder, PaperProtocol(ABLATED))
        if not scores:
            raise LSNetError(f"{folder}: has no pixel truth; give folders with masks or boundaries")
        found[str(folder)] = [scores[0].apr, scores[0].arr, scores[0].f1]
    return found
