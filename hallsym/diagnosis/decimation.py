"""A shorter log that shows the same: every m-th sample, and of long runs the beginning."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from hallsym.diagnosis.base import Base
from hallsym.log import Log
from hallsym.log.derived import extended
from hallsym.model.derived import rate

PER_PERIOD = 25.0
"""Samples that a period of the fastest motion must keep."""
MAINS_HZ = 126.0
"""Sampling rate that must be kept: a little more than twice the mains."""
MOST = 30_000
"""Samples beyond which long runs are cut."""


@dataclass(frozen=True, eq=False)
class Decimated:
    """The log in memory, and in words what was left out ("" for nothing)."""

    log: Log
    every: int
    text: str


def decimated(base: Base, rows: int) -> Decimated:
    """Return about `rows` samples of `base.log`, as far as motion and mains stay resolved.

    Samples that the fit left out are left out here too.
    """
    log = base.log
    lengths: dict[int, int] = {}
    for block in log.blocks(("t_s",)):
        lengths[block.run] = lengths.get(block.run, 0) + len(block.data["t_s"])
    every = max(1, min(log.rows // rows, _coarsest(base)))
    share = min(1.0, max(MOST, rows) * every / log.rows)
    limits = {run: max(int(np.ceil(share * n)), min(n, 64 * every)) for run, n in lengths.items()}
    parts: dict[str, list[np.ndarray]] = {}
    for run, data, keep in _kept(base, every, limits):
        parts.setdefault("run", []).append(np.full(int(keep.sum()), run))
        for column, values in data.items():
            if column != "run":
                parts.setdefault(column, []).append(values[keep])
    columns = {c: np.concatenate(v) for c, v in parts.items()}
    said = [f"every {every}. sample"] if every > 1 else []
    said += [f"the first {100 * share:.3g} % of each run"] if share < 1 else []
    short = Log.from_arrays(columns, log.noise, replace(log.meta), log.name)
    return Decimated(short, every, " of ".join(said))


def _kept(
    base: Base, every: int, limits: dict[int, int]
) -> Iterator[tuple[int, dict[str, np.ndarray], np.ndarray]]:
    done: dict[int, int] = {}
    for block in base.log.blocks():
        n = len(block.data["t_s"])
        index = done.get(block.run, 0) + np.arange(n)
        done[block.run] = int(index[-1]) + 1
        keep = (index % every == 0) & (index < limits[block.run])
        if base.keep is not None:
            keep &= base.keep(block) > 0
        yield block.run, block.data, keep


def _coarsest(base: Base) -> int:
    """How many samples one may stand for: by the fastest motion of the first 64 blocks, and by the mains."""
    model, squares = base.model, np.zeros(2)
    axes = [[rate(c, order) for c in model.references] for order in (1, 2)]
    log = extended(base.log, model.with_columns(*axes[0], *axes[1]), base.sigma, base.values)
    steps = []
    for block in islice(log.blocks(("t_s", *(a.name for row in axes for a in row))), 64):
        t = block.data["t_s"]
        if len(t) > 1:
            steps.append(float(np.median(np.diff(t))))
        for k, row in enumerate(axes):
            squares[k] += sum(
                float(((f * block.data[a.name]) ** 2).sum())
                for f, a in zip(base.pose_weights, row, strict=True)
            )
    step = float(np.median(steps)) if steps else 1.0
    fastest = float(np.sqrt(squares[1] / max(squares[0], 1e-300))) / (2 * np.pi)
    return int(1.0 / (step * max(fastest * PER_PERIOD, MAINS_HZ)))
