"""What further recordings would determine that a family's machines can make beside a log (`Family.further`).

Their motion is that of the log with the changes the family states, their readings are those of the fitted
model, and their information is added to the log's. A zero that such a recording sets anew is unknown in it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from hallsym.estimation import Cost, cost_near, least_information, scales, structural_directions
from hallsym.estimation.decoding import logged_columns
from hallsym.inference.evidence import Evidence
from hallsym.inference.workspace import visited
from hallsym.log import Log
from hallsym.model import Model, on_arrays

SAMPLES = 20_000
"""Samples of a log that stand for a further recording; the information of more is proportional to them."""
BETTER = 2.0
"""Factor by which an uncertainty must fall beyond what the same motion once more makes, to be told."""
SHARED = 1e-6
"""Sine of the angle within which two structural null directions are one."""


@dataclass(frozen=True)
class Gained:
    """A parameter that a further recording determines (`before` is None) or determines better.

    `std`: its standard uncertainty with both recordings, `before`: with the log and the same motion once
    more; both in `unit`.
    """

    parameter: str
    unit: str
    std: float
    before: float | None


@dataclass(frozen=True)
class FurtherReport:
    """What a log and one further recording determine together: `rank` of `of` directions; what is gained."""

    recording: str
    rank: int
    of: int
    gained: tuple[Gained, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the record that `hallsym sensitivity --json` prints."""
        return {**vars(self), "gained": [vars(gained) for gained in self.gained]}


def further_reports(evidence: Evidence, log: Log) -> tuple[FurtherReport, ...]:
    """Return one report for each further recording that the family of the model offers."""
    model = evidence.model
    offered = [(f, read) for f in model.family.further if (read := f.read(model)) is not None]
    if not offered:
        return ()
    columns, factor = _columns(evidence, log)
    again = _together(evidence, model, columns, factor).std
    return tuple(
        _report(evidence, f.text, again, _together(evidence, read, columns | dict(f.moved(columns)), factor))
        for f, read in offered
    )


LEFT = 1e-3
"""Part of a determined parameter that may lie along undetermined directions: they move it by less than a
thousandth of its bounds."""


@dataclass(frozen=True, eq=False)
class _Known:
    """What two recordings determine: the rank, and standard uncertainties (n,), nan where there is none."""

    rank: int
    std: np.ndarray


def _report(evidence: Evidence, text: str, again: np.ndarray, known: _Known) -> FurtherReport:
    parameters = evidence.model.parameters
    gained = [
        Gained(p.name, p.unit, float(std), None if np.isnan(before) else float(before))
        for p, before, std in zip(parameters, again, known.std, strict=True)
        if np.isfinite(std) and (np.isnan(before) or before > BETTER * std)
    ]
    return FurtherReport(text, known.rank, sum(p.width > 0 for p in parameters), tuple(gained))


def _together(evidence: Evidence, model: Model, columns: Mapping[str, np.ndarray], factor: float) -> _Known:
    """Return what the log and a recording of these columns, as `model` reads them, determine together.

    `factor`: times as much as these samples are recorded.
    """
    n, first = len(evidence.p), evidence.cost
    p = np.concatenate([evidence.p, model.nominal[n:]])
    second = _cost(evidence, model, p, columns)
    scale = scales(evidence.model)
    added = _eliminated(second.information(p, 2.0), n)
    information = (first.information(evidence.p, 2.0) + factor * added) * np.outer(scale, scale)
    always, rest = structural_directions(first, evidence.p)
    theirs = structural_directions(second, p)[0][:n]
    basis = np.hstack([rest, always @ _apart(always, theirs)])
    values, vectors = np.linalg.eigh(basis.T @ information @ basis)
    good = values >= least_information(values)
    vectors = basis @ vectors
    found = vectors[:, good] @ (vectors[:, good] / values[good]).T
    left = 1 - np.sum(vectors[:, good] ** 2, axis=1)  # of a parameter, along what is not determined
    std = np.where(left < LEFT**2, scale * np.sqrt(np.diag(found)), np.nan)
    return _Known(int(good.sum()), std)


def _apart(always: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """Return the directions (k, m) among the columns of `always` (n, k) that are not in those of `theirs`."""
    if always.shape[1] == 0 or theirs.shape[1] == 0:
        return np.eye(always.shape[1])
    u, cosines, _ = np.linalg.svd(always.T @ scipy.linalg.orth(theirs))
    shared = int(np.sum(cosines > np.sqrt(1 - SHARED**2)))
    return np.asarray(u[:, shared:])


def _eliminated(information: np.ndarray, n: int) -> np.ndarray:
    """Return the information about the first n parameters, the others unknown."""
    own = information[n:, n:]
    if own.size == 0:
        return information
    cross = information[n:, :n]
    return np.asarray(information[:n, :n] - cross.T @ np.linalg.pinv(own, hermitian=True) @ cross)


def _columns(evidence: Evidence, log: Log) -> tuple[dict[str, np.ndarray], float]:
    """Return the first samples of each run that was fitted, and how many times as many there are."""
    names = ("run", "t_s", *logged_columns(evidence.model))
    kept: dict[str, list[np.ndarray]] = {c: [] for c in names}
    counts = dict(zip(evidence.cost.summary.runs, evidence.cost.summary.counts.tolist(), strict=True))
    most = max(1, SAMPLES // len(counts))
    taken = dict.fromkeys(counts, 0)
    for block in log.blocks(names[1:]):
        room = most - taken.get(block.run, most)
        if room <= 0:
            continue
        rows = {c: np.asarray(v)[:room] for c, v in block.data.items()}
        taken[block.run] += len(rows["t_s"])
        kept["run"].append(np.full(len(rows["t_s"]), block.run))
        for c in names[1:]:
            kept[c].append(rows[c])
    columns = {c: np.concatenate(parts) for c, parts in kept.items()}
    return columns, sum(counts.values()) / len(columns["run"])


def _cost(evidence: Evidence, model: Model, p: np.ndarray, columns: Mapping[str, np.ndarray]) -> Cost:
    """Return the likelihood of a recording of these poses, its readings those of `model` at p."""
    cost = evidence.cost
    names = (*evidence.model.channels, *evidence.model.references, *evidence.model.state)
    sigma = np.sqrt([*cost.reading_variance, *cost.column_variance])
    noise = dict(zip(names, sigma.tolist(), strict=True))
    poses = Log.from_arrays(columns)
    at = visited(poses, model, poses.rows, noise, model.named(p))
    own = dict(zip(cost.summary.runs, cost.at(evidence.p).zeros, strict=True))
    zeros = np.array([own[int(run)] for run in at.runs]).T
    (read,) = on_arrays(model.reading)(p, zeros, at.pose, at.state)
    log = Log.from_arrays({**columns, **dict(zip(model.channels, read, strict=True))})
    return replace(cost_near(log, model, p, noise), planned=cost.planned)
