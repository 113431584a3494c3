"""What a recording that a family's machines can make beside a log (`Family.further`) tells of two models.

It is the log's own motion with the changes that the family states. One model generates its readings, without
noise; the other is fitted to these and to the log at once. Zeros that the recording sets anew are free in it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np

from hallsym.diagnosis.normal_equations import normal_equations
from hallsym.diagnosis.recordings import LONGEST, Recording
from hallsym.diagnosis.refit import Refitted, with_model
from hallsym.diagnosis.residuals import Base
from hallsym.diagnosis.simulated_machine import readings_of
from hallsym.estimation import pseudo_inverse
from hallsym.log import Log
from hallsym.model import Further
from hallsym.simulation import Run

Told = tuple[list[Recording], np.ndarray]
"""Recordings, and the whitened squared distance that each adds for the closest pair of models."""


def further_recordings(fits: Sequence[Refitted]) -> Told:
    """Return the family's further recordings with what each adds: `fits`, each fitted on the log."""
    first = fits[0].base
    offered = [f for f in first.model.family.further if f.read(first.model) is not None]
    if not offered:
        return [], np.zeros(0)
    motion = _motion(first)
    run, t = motion["run"], motion["t_s"]
    seconds = float(sum(np.ptp(t[run == r]) for r in np.unique(run)))
    told = [min(_told(f, motion, a, b) for a, b in permutations(fits, 2)) for f in offered]
    return [Recording(f"{f.text} ({seconds:.3g} s)", Run(seconds, {}, {})) for f in offered], np.array(told)


def _motion(base: Base) -> dict[str, np.ndarray]:
    """Return all columns but the readings of the first samples of each run that was fitted."""
    runs = [r for r in base.log.runs if r not in base.holdout]
    each = max(1, LONGEST // len(runs))
    run = base.log.array("run").astype(int)
    rows = np.concatenate([np.flatnonzero(run == r)[:each] for r in runs])
    names = [c for c in base.log.columns if c not in (*base.model.channels, "run")]
    return {"run": run[rows]} | {c: base.log.array(c)[rows] for c in names}


def _told(further: Further, motion: dict[str, np.ndarray], a: Refitted, b: Refitted) -> float:
    """Return the squared distance of b from the readings of a, b refitted to log and recording at once."""
    columns = motion | dict(further.moved(motion))
    one, other = (_read_as(further, fit.base) for fit in (a, b))
    if one is None or other is None:
        return 0.0
    return added(
        normal_equations(recording(other, with_readings(columns, one))).likelihood.sum(axis=0), other, b
    )


def recording(base: Base, log: Log) -> Base:
    """Return a model on a recording that was not made yet, zeros at rest."""
    zeros = dict.fromkeys(log.runs, np.zeros(len(base.model.zeros)))
    return replace(base, log=log, zeros=zeros, keep=None, holdout=frozenset[int]())


def added(M: np.ndarray, there: Base, known: Refitted) -> float:
    """Return the squares that products M of a recording add once `there` is fitted to it and to the log.

    `known`: the same model, or one with fewer parameters, fitted to the log.
    """
    n, own = len(there.free), len(known.base.free)
    place = {there.model.names[k]: j for j, k in enumerate(there.free)}
    at = np.array([place[known.base.model.names[k]] for k in known.base.free])
    both = M[:n, :n].copy()
    both[at[:, None], at] += known.tangents.likelihood[known.fitted].sum(axis=0)[:own, :own]
    return max(float(M[n, n] - M[:n, n] @ pseudo_inverse(both) @ M[:n, n]), 0.0)


def _read_as(further: Further, base: Base) -> Base | None:
    model = further.read(base.model)
    return None if model is None else with_model(base, model)


def with_readings(columns: Mapping[str, np.ndarray], base: Base) -> Log:
    """Add the readings that the model of `base` gives; columns that it computes come from the motion."""
    model = base.model
    blank = np.zeros(len(columns["run"]))
    bare = Log.from_arrays({**columns, **dict.fromkeys(model.channels, blank)}, noise=base.log.noise)
    readings = readings_of(replace(base, log=bare, zeros={}), model, base.p)
    return Log.from_arrays(
        {**columns, **dict(zip(model.channels, readings, strict=True))}, noise=base.log.noise
    )
