"""Phase unwrapping of periodic columns, such as angles: a continuous reference, and readings on its branch.

A model states which of its columns are periodic and with which period (`Model.period`). A reading within half
a period of its reference, less one constant for the whole log (the zero is free), is then continuous over any
number of turns, and a residual is an ordinary number.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from hallsym.log.columns import RUN
from hallsym.log.core import Log, edges_of
from hallsym.log.table import Resting, View
from hallsym.model import Model
from hallsym.model.arrays import on_arrays
from hallsym.units import readable

LOST = 2.0
"""Factor by which calibration lowers the non-periodic error above which that is no noise: the nominal
parameters do not decode the readings (for example, their circle does not enclose the nominal centre)."""


def wrapped(values: np.ndarray, period: float) -> np.ndarray:
    """Return values moved by whole periods to -period / 2 .. period / 2, same shape."""
    return values - period * np.round(values / period)


def nearest_turn(model: Model, p: np.ndarray) -> np.ndarray:
    """Return parameters (n,) with periodic ones wrapped to half a period around zero."""
    out = np.array(p, dtype=float)
    for k, name in enumerate(model.names):
        if name in model.period:
            out[k] = wrapped(out[k], model.period[name])
    return out


def designed(model: Model, p: np.ndarray) -> np.ndarray:
    """Return nominal parameters (n,) with those of the mounting as in `p`.

    These are periodic ones (a zero), and the common factor of amplitudes (`Model.amplitudes`).
    """
    out = np.where([name in model.period for name in model.names], p, model.nominal)
    these = np.isin(model.names, model.amplitudes)
    if these.any() and (p[these] * out[these] > 0).all():
        out[these] *= np.exp(np.log(p[these] / out[these]).mean())
    return out


def decoding(rest: float, calibrated: float) -> bool:
    """Return whether nominal parameters decode readings at all.

    `rest`, `calibrated`: rms of the decoded error that does not repeat over the period, with the nominal and
    with the fitted parameters.
    """
    return not rest > LOST * calibrated


def near(model: Model, pose: np.ndarray, reference: np.ndarray, p: np.ndarray | None = None) -> np.ndarray:
    """Return a decoded pose (n_pose, samples) on the branch of its reference, where a coordinate repeats.

    `p`: (n,) parameters that it was decoded with, nominal by default.
    """
    out = np.array(pose, dtype=float)
    for k, coordinate in enumerate(model.pose):
        if coordinate in model.period:
            if model.onward is None:
                out[k] = reference[k] + wrapped(out[k] - reference[k], model.period[coordinate])
                continue
            period = model.period[coordinate]
            values = model.named(model.nominal if p is None else p)
            whole = period * np.round((reference[k] - out[k]) / period)
            out = out + whole * model.onward(out, coordinate, values)
    return out


def continuous(log: Log, model: Model) -> Log:
    """Return the log with unwrapped periodic columns of `model`; the log itself if there are none.

    References are unwrapped along each run. A periodic channel is moved to the branch of its reference, less
    the circular mean of their difference over the log.
    """
    wraps = [c for c in model.references if c in model.period and c not in model.absolute]
    references = {c: model.period[c] for c in wraps}
    channels = {c: model.period[c] for c in model.channels if c in model.period}
    if (not references and not channels) or isinstance(log.table, _Continuous):
        return log
    log.table.require((*references, *channels))
    beside = {c: along for c in channels if (along := _reference_of(model, c))}
    shifts = homes(log, model)
    branches = {
        c: _Branch(along, channels[c], _middle(log, c, along, channels[c], shifts.get(along, {})))
        for c, along in beside.items()
    }
    table: Any = _Continuous(log.table, references, branches, shifts)
    return replace(log, table=table)


def as_continuous(log: Log) -> Log:
    """Return a log whose periodic columns are continuous already, marked so."""
    table: Any = _Continuous(log.table, {}, {}, {})
    return replace(log, table=table)


def followed(model: Model) -> tuple[str, ...]:
    """Return the logged columns of the state on which some reading depends."""
    made = {c.name for c in model.computed}
    follows = ca.DM(model.reading.jac_sparsity(0, 3), 1).full()
    return tuple(c for k, c in enumerate(model.state) if follows[:, k].any() and c not in made)


def at_rest(log: Log, model: Model) -> Log:
    """Return the log with state columns that it lacks at rest, where no reading of `model` follows them."""
    lacking = [c for c in model.state if c not in log.columns]
    needed = {c.name for c in model.computed}.union(followed(model) if lacking else ())
    if not lacking or needed & set(lacking):
        return log
    said = f"{log.name} has no {', '.join(lacking)}; no reading of {model.name} follows them."
    table: Any = Resting(log.table, {c: model.rest.get(c, 0.0) for c in lacking})
    return replace(log, table=table, notes=(*log.notes, said))


def rehomed(log: Log, shifts: Mapping[str, Mapping[int, float]], model: Model) -> Log:
    """Return a log whose references that repeat begin elsewhere: `shifts` by column and run are added."""
    table: Any = _Continuous(log.table, {c: model.period[c] for c in shifts}, {}, shifts)
    return replace(log, table=table)


def _reference_of(model: Model, channel: str) -> str | None:
    """The periodic reference of a channel: that of the coordinate it gives, else the first one."""
    if channel in model.pose and (own := model.references[model.pose.index(channel)]) in model.period:
        return own
    return next((c for c in model.references if c in model.period), None)


def home_notes(log: Log, model: Model, offsets: Mapping[int, np.ndarray]) -> tuple[str, ...]:
    """Return notes on a log whose runs have `offsets`, by run [SI], in addition to those of `homes`."""
    home_of = log.table.shifts if isinstance(log.table, _Continuous) else {}
    notes = []
    for k, reference in enumerate(_homed_by(model, z.name) for z in model.offsets):
        homed = home_of.get(reference, {})
        at = {run: homed[run] + offsets[run][k] for run in homed if run in offsets}
        if not at:
            continue
        factor, unit, name = readable(reference)
        name = f" of {name.removesuffix('_ref')}" if len(model.pose) > 1 else ""
        first = next(iter(at))
        shifts = {run: factor * wrapped(v - at[first], model.period[reference]) for run, v in at.items()}
        said = [f"run {run}: {v:+.4f}" for run, v in list(shifts.items())[:LISTED]]
        more = f", and {len(at) - LISTED} more" if len(at) > LISTED else ""
        notes.append(
            f"Each run has a zero of its own{name}; in {unit}, beside run {first}: {', '.join(said)}{more}. "
            "A delay of the readings at one speed is part of it."
        )
    return tuple(notes)


LISTED = 8
"""Offsets of runs that a note lists."""
WELL = 0.02
"""Least eigenvalue of the mean products of 1 and both waves in a run for a wave to be fitted to it: that of
120 deg of a turn."""


def _homed_by(model: Model, zero: str) -> str:
    """The reference whose origin in a run a zero is; "" for a zero of another kind."""
    return model.references[model.pose.index(model.homes[zero])] if zero in model.homes else ""


def homes(log: Log, model: Model) -> dict[str, dict[int, float]]:
    """Return by reference and run the coordinate as read where the reference is zero, in the column's unit.

    Of the coordinates whose origin a zero of each run is (`Model.homes`). The phase of the first wave of
    exp(i coordinate) over the reference, beside a constant and the wave that turns the other way, which take
    up offset, gain and phase. Of a run that turns little, the circular mean.
    """
    columns = [c for z in model.offsets if (c := _homed_by(model, z.name)) in model.period]
    if model.begin is None or not columns:
        return {}
    v = ca.SX.sym("v", len(model.channels))
    nominal = {p.name: ca.SX(p.nominal) for p in model.parameters}
    pose = on_arrays(ca.Function("pose", [v], [ca.densify(model.begin(v, nominal))]))
    sums: dict[str, dict[int, tuple[Any, Any]]] = {c: {} for c in columns}
    for block in log.blocks((*model.channels, *columns)):
        (read,) = pose([block.data[c] for c in model.channels])
        for column, own in sums.items():
            scale = 2 * np.pi / model.period[column]
            z = np.exp(1j * scale * read[model.references.index(column)])
            turn = np.exp(1j * scale * block.data[column])
            good = np.isfinite(z) & np.isfinite(turn)
            rows = np.array([np.ones_like(turn), turn, np.conj(turn)])[:, good]
            square, right = own.get(block.run, (0.0, 0.0))
            own[block.run] = square + np.conj(rows) @ rows.T, right + np.conj(rows) @ z[good]
    return {
        column: {run: _home(*products) * model.period[column] / (2 * np.pi) for run, products in own.items()}
        for column, own in sums.items()
    }


def _home(square: np.ndarray, right: np.ndarray) -> float:
    """Phase [rad] of the wave that turns along, from the normal equations of a run."""
    count = max(float(square[0, 0].real), 1.0)
    whole = float(np.linalg.eigvalsh(square / count)[0]) > WELL
    return float(np.angle((np.linalg.solve(square, right) if whole else right)[1]))


def _middle(log: Log, channel: str, along: str, period: float, shifts: Mapping[int, float]) -> float:
    """Circular mean of channel - reference over the log."""
    total = 0j
    for block in log.blocks((channel, along)):
        off = block.data[channel] - block.data[along] - shifts.get(block.run, 0.0)
        total += np.exp(2j * np.pi / period * off[np.isfinite(off)]).sum()
    return float(np.angle(total)) * period / (2 * np.pi)


@dataclass(frozen=True)
class _Branch:
    """Where a channel that repeats belongs: within half a period of reference `along` + `middle`."""

    along: str
    period: float
    middle: float


class _Continuous(View):
    """The table of a log whose periodic columns are continuous.

    `references`: period by column. `shifts`: by reference and run, added to it.
    """

    def __init__(
        self,
        table: Any,
        references: Mapping[str, float],
        channels: Mapping[str, _Branch],
        shifts: Mapping[str, Mapping[int, float]],
    ) -> None:
        super().__init__(table)
        self.references, self.channels, self.shifts = references, channels, shifts

    def counts_per_turn(self, column: str) -> float | None:
        """Return the counts of a turn of a column that stays within one; None of one made continuous."""
        return None if column in self.channels else self.table.counts_per_turn(column)

    def pieces(self, columns: Sequence[str], size: int) -> Iterator[dict[str, np.ndarray]]:
        along = [self.channels[c].along for c in columns if c in self.channels]
        runs = [RUN] if along or any(c in self.references for c in columns) else []
        last: dict[str, tuple[int, float]] = {}
        for piece in self.table.pieces(tuple(dict.fromkeys([*columns, *along, *runs])), size):
            done = {
                c: v if c not in self.references else self._unwrapped(c, piece, last)
                for c, v in piece.items()
            }
            for c in columns:
                if c in self.channels:
                    branch = self.channels[c]
                    base = done[branch.along] + branch.middle
                    done[c] = base + wrapped(piece[c] - base, branch.period)
            yield {c: done[c] for c in columns}

    def _unwrapped(
        self, column: str, piece: Mapping[str, np.ndarray], last: dict[str, tuple[int, float]]
    ) -> np.ndarray:
        """Return a reference without jumps of a period, run by run, going on from the piece before."""
        values, run, period = piece[column], piece[RUN], self.references[column]
        out, home = np.array(values, dtype=float), self.shifts.get(column, {})
        for start, stop in pairwise(edges_of(run)):
            if stop == start:
                continue
            part, own = unwrapped(out[start:stop], period), int(run[start])
            known, before = last.get(column, (None, 0.0))
            if known == own:
                part = part + (before + wrapped(out[start] - before, period)[()] - out[start])
            last[column] = own, float(part[-1])
            out[start:stop] = part + home.get(own, 0.0)
        return out


def unwrapped(x: np.ndarray, period: float) -> np.ndarray:
    """Return x (n,) less whole periods, so that no step is longer than half of one; `np.unwrap`, but lean."""
    whole = np.round(np.diff(x) / period)
    if not whole.any():
        return x
    return np.asarray(x - period * np.concatenate([[0.0], np.cumsum(whole)]))
