"""Columns that repeat, such as angles: a reference without jumps, and readings on its branch.

A model says which of its columns repeat and with which period (`Model.period`). A reading that is half a
period or less from its reference, give or take one constant for the whole log (the zero is free), is then
continuous wherever the reference turns, however often, and a residual is an ordinary number.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from hallsym.log import Log
from hallsym.log.columns import RUN
from hallsym.model import Model
from hallsym.model.arrays import on_arrays

CHUNK = 65_536


def wrapped(values: np.ndarray, period: float) -> np.ndarray:
    """Return values moved by whole periods to -period / 2 .. period / 2, same shape."""
    return values - period * np.round(values / period)


def nearest_turn(model: Model, p: np.ndarray) -> np.ndarray:
    """Return parameters (n,) with those that repeat within half a period of zero."""
    out = np.array(p, dtype=float)
    for k, name in enumerate(model.names):
        if name in model.period:
            out[k] = wrapped(out[k], model.period[name])
    return out


def designed(model: Model, p: np.ndarray) -> np.ndarray:
    """Return nominal parameters (n,), what repeats as in `p`: a zero is mounting, which no drawing states."""
    return np.where([name in model.period for name in model.names], p, model.nominal)


def near(model: Model, pose: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return a decoded pose (n_pose, samples) on the branch of its reference, where a coordinate repeats."""
    out = np.array(pose, dtype=float)
    for k, coordinate in enumerate(model.pose):
        if coordinate in model.period:
            out[k] = reference[k] + wrapped(out[k] - reference[k], model.period[coordinate])
    return out


def continuous(log: Log, model: Model) -> Log:
    """Return the log with the columns of `model` that repeat made continuous; the log itself if none do.

    References are unwrapped along each run. A channel that repeats is brought next to the first reference,
    less the circular mean of their difference over the log.
    """
    references = {c: model.period[c] for c in model.references if c in model.period}
    channels = {c: model.period[c] for c in model.channels if c in model.period}
    if (not references and not channels) or isinstance(log.table, _Continuous):
        return log
    log.table.require((*references, *channels))
    along = next(iter(references), None)
    apart = homes(log, model) if along and model.zeros else {}
    middle = _middles(log, channels, along, apart) if along else {}
    table: Any = _Continuous(log.table, references, channels if along else {}, along, middle, apart)
    return replace(log, table=table)


def home_notes(log: Log, zeros: Mapping[int, np.ndarray]) -> tuple[str, ...]:
    """Return what to say of a log whose runs have zeros: `zeros` by run [rad], beside that of `homes`."""
    apart = log.table.apart if isinstance(log.table, _Continuous) else {}
    if not apart or not any(map(len, zeros.values())):
        return ()
    at = {run: np.degrees(apart[run] + zeros[run]) for run in apart if run in zeros}
    first = next(iter(at))
    said = [f"run {run}: {wrapped(v - at[first], 360.0)[0]:+.4f}" for run, v in list(at.items())[:LISTED]]
    more = f", and {len(at) - LISTED} more" if len(at) > LISTED else ""
    return (
        f"Each run has a zero of its own; in deg, beside run {first}: {', '.join(said)}{more}. A delay of "
        "the readings at one speed is part of it.",
    )


LISTED = 8
"""Zeros of runs that a note lists."""
WELL = 0.02
"""Least eigenvalue of the mean products of 1 and both waves in a run for a wave to be fitted to it: that of
120 deg of a turn."""


def homes(log: Log, model: Model) -> dict[int, float]:
    """Return by run the angle of the reading at the zero of the reference, in the unit of its column.

    The phase of the first wave of exp(i angle) over the reference, beside a constant and the wave that turns
    the other way, which take up offset, gain and phase. Of a run that turns little, the circular mean.
    """
    if model.begin is None:
        return {}
    (column,), v = model.references, ca.SX.sym("v", len(model.channels))
    nominal = {p.name: ca.SX(p.nominal) for p in model.parameters}
    angle = on_arrays(ca.Function("angle", [v], [model.begin(v, nominal)]))
    scale = 2 * np.pi / model.period[column]
    sums: dict[int, list[np.ndarray]] = {}
    for piece in log.table.pieces((RUN, *model.channels, column), CHUNK):
        (read,) = angle([piece[c] for c in model.channels])
        z, turn = np.exp(1j * scale * np.ravel(read)), np.exp(1j * scale * piece[column])
        rows = np.array([np.ones_like(turn), turn, np.conj(turn)])
        good = np.isfinite(z) & np.isfinite(turn)
        for run in np.unique(piece[RUN]).tolist():
            here = good & (piece[RUN] == run)
            mine = sums.setdefault(int(run), [np.zeros((3, 3), complex), np.zeros(3, complex)])
            mine[0] = mine[0] + np.conj(rows[:, here]) @ rows[:, here].T
            mine[1] = mine[1] + np.conj(rows[:, here]) @ z[here]
    out = {}
    for run, (square, right) in sums.items():
        count = max(float(square[0, 0].real), 1.0)
        whole = float(np.linalg.eigvalsh(square / count)[0]) > WELL
        out[run] = float(np.angle((np.linalg.solve(square, right) if whole else right)[1])) / scale
    return out


def _middles(
    log: Log, channels: Mapping[str, float], along: str, apart: Mapping[int, float]
) -> dict[str, float]:
    """Circular mean of channel - reference over the log, by channel."""
    sums = dict.fromkeys(channels, 0j)
    if not channels:
        return {}
    for piece in log.table.pieces((*channels, along, *((RUN,) if apart else ())), CHUNK):
        home = _of_runs(apart, piece[RUN]) if apart else 0.0
        for c, period in channels.items():
            turn = 2j * np.pi / period * (piece[c] - piece[along] - home)
            sums[c] += np.exp(turn[np.isfinite(turn)]).sum()
    return {c: float(np.angle(total)) * channels[c] / (2 * np.pi) for c, total in sums.items()}


def _of_runs(values: Mapping[int, float], runs: np.ndarray) -> np.ndarray:
    known, place = np.unique(runs, return_inverse=True)
    return np.array([values.get(int(run), 0.0) for run in known])[place]


class _Continuous:
    """The table of a log whose repeating columns are continuous; `apart` is added to a run's reference."""

    def __init__(
        self,
        table: Any,
        references: Mapping[str, float],
        channels: Mapping[str, float],
        along: str | None,
        middle: Mapping[str, float],
        apart: Mapping[int, float],
    ) -> None:
        self.apart = apart
        self.table, self.references, self.channels = table, references, channels
        self.along, self.middle = along, middle

    def __getattr__(self, name: str) -> Any:
        return getattr(self.table, name)

    def pieces(self, columns: Sequence[str], size: int) -> Iterator[dict[str, np.ndarray]]:
        needs: dict[str, None] = dict.fromkeys(columns)
        if any(c in self.references or c in self.channels for c in columns):
            needs |= {RUN: None}
        if self.along and any(c in self.channels for c in columns):
            needs |= {self.along: None}
        last: dict[str, tuple[int, float]] = {}
        for piece in self.table.pieces(tuple(needs), size):
            done = {
                c: v if c not in self.references else self._unwrapped(c, piece, last)
                for c, v in piece.items()
            }
            for c in columns:
                if c in self.channels:
                    base, period = done[str(self.along)] + self.middle[c], self.channels[c]
                    done[c] = base + wrapped(piece[c] - base, period)
            yield {c: done[c] for c in columns}

    def _unwrapped(
        self, column: str, piece: Mapping[str, np.ndarray], last: dict[str, tuple[int, float]]
    ) -> np.ndarray:
        """Return a reference without jumps of a period, run by run, going on from the piece before."""
        values, run, period = piece[column], piece[RUN], self.references[column]
        out = np.array(values, dtype=float)
        edges = [0, *(np.flatnonzero(run[1:] != run[:-1]) + 1).tolist(), len(run)]
        for start, stop in pairwise(edges):
            if stop == start:
                continue
            part = _unwrapped(out[start:stop], period)
            if last.get(column, (None, 0.0))[0] == run[start]:
                before = last[column][1]
                part = part + (before + wrapped(out[start] - before, period)[()] - out[start])
            out[start:stop] = part
        if len(run):
            last[column] = (int(run[-1]), float(out[-1]))
        return out + _of_runs(self.apart, run) if self.apart and column == self.along else out


def _unwrapped(x: np.ndarray, period: float) -> np.ndarray:
    """Return x (n,) less whole periods, so that no step is longer than half of one; `np.unwrap`, but lean."""
    whole = np.round(np.diff(x) / period)
    return np.concatenate([x[:1], x[1:] - period * np.cumsum(whole)]) if whole.any() else x
