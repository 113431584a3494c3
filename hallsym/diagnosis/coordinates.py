"""What a residual may depend on: states, readings, motion, time, places on an axis or within its period."""

from dataclasses import dataclass
from math import tau

import numpy as np

from hallsym.diagnosis.residual_table import ResidualTable, phase
from hallsym.estimation.residual_noise import STILL
from hallsym.units import readable


@dataclass(frozen=True)
class Coordinate:
    """What a residual may depend on: its `name`, the `column` behind it, the unit of that.

    `gain`: it may also change the gain. `own`: every sensor has its own, from `sensed` or `rate`. `fine`: the
    residual may have fine structure over it. `period`: of a place within a period, in `unit`. `of`: several
    columns that together are the coordinate, and `memory`: the direction of motion of each sensor; neither
    is a place on a line. `clocked`: it exists only in a log with time.
    """

    name: str
    column: str
    unit: str
    gain: bool = True
    own: bool = False
    fine: bool = False
    period: float | None = None
    of: tuple[str, ...] = ()
    memory: bool = False
    clocked: bool = False

    @property
    def ordered(self) -> bool:
        """Whether it is a place on a line."""
        return not self.of and not self.memory

    def values(self, r: ResidualTable) -> np.ndarray | None:
        """Return (n,) values, (K, n) for each sensor's own; None where there are none or they do not vary."""
        if self.memory:
            return np.sign(r.rate) if np.std(r.sensed) > 0 else None
        if self.of:
            there = all(c in r.columns and (not self.gain or np.std(r.columns[c]) > 0) for c in self.of)
            return r.columns[self.of[0]] if there else None
        x = getattr(r, self.column) if self.own else r.columns.get(self.column)
        if x is None:
            return None
        if self.unit == "rad" and self.fine and np.ptp(x) > tau:
            x = np.mod(x, tau)
        return x if np.std(x) > max(STILL * r.sigma.get(self.column, 0.0), 1e-15) else None


def coordinates(r: ResidualTable) -> tuple[Coordinate, ...]:
    """Return what a residual may depend on, from the most telling to the least.

    Of two that explain the same the first is named. Where all references are periodic, their place within the
    period says all that the readings and the pose could say.
    """
    phases = [
        Coordinate(_in_period(c, r), phase(c), unit_of(c), gain=False, fine=True, period=r.period[c])
        for c in r.references
        if c in r.period
    ]
    if len(phases) == len(r.references):
        motion = [
            Coordinate("speed" + _of(c, r), f"d1_{c}", f"{unit_of(c)}/s", clocked=True) for c in r.references
        ]
        known = [*phases, *motion]
    else:
        reading = unit_of(r.channels[0])
        rates = tuple(f"d2_{c}" for c in r.references)
        known = [
            *_states(r),
            *phases,
            Coordinate("the reading itself", "sensed", reading, gain=False, own=True, fine=True),
            Coordinate("direction of motion", "direction", "1", gain=False, own=True, memory=True),
            Coordinate("velocity", "rate", f"{reading}/s", own=True),
            Coordinate("acceleration", "acceleration", "m/s2", gain=False, of=rates),
            *(Coordinate(_place(c, r), f"d0_{c}", unit_of(c), fine=True) for c in r.references),
        ]
    known = [
        Coordinate("temperature", "temperature_degc", "degC"),
        *known,
        Coordinate("time in the campaign", "campaign_s", "s", clocked=True),
        Coordinate("time since the start of the run", "run_s", "s", gain=False, clocked=True),
    ]
    return tuple(c for c in known if r.timed or not c.clocked)


def _states(r: ResidualTable) -> list[Coordinate]:
    each = [Coordinate(r.words.get(c, _stem(c)), c, unit_of(c)) for c in r.state]
    if len(each) < 2:
        return each
    together = r.together or ", ".join(s.name for s in each) + " together"
    return [*each, Coordinate(together, "states", "1", of=r.state)]


def _stem(column: str) -> str:
    return readable(column)[2].removesuffix("_ref").replace("_", " ")


def _of(reference: str, r: ResidualTable) -> str:
    """Return " of x" where there is more than one reference to tell apart."""
    return f" of {_stem(reference)}" if len(r.references) > 1 else ""


def _in_period(reference: str, r: ResidualTable) -> str:
    what = "turn" if unit_of(reference) == "rad" else "period"
    return f"place in the {what}{_of(reference, r)}"


def _place(reference: str, r: ResidualTable) -> str:
    if reference in r.words:
        return r.words[reference]
    if unit_of(reference) != "rad":
        return f"place in the stroke of {_stem(reference)}"
    far = np.ptp(r.columns[f"d0_{reference}"]) > tau
    return f"place in the turn of {_stem(reference)}" if far else f"angle {_stem(reference)}"


def unit_of(column: str) -> str:
    """Return the unit of a column: the end of its name."""
    unit = column.rpartition("_")[2]
    return "degC" if unit == "degc" else unit


def knots(x: np.ndarray) -> np.ndarray:
    """Return up to 9 knots of a smooth curve over x, quantiles: none closer than 2 % of the range."""
    wanted = np.quantile(x, np.linspace(0.0, 1.0, 9))
    low, high = wanted[0], wanted[-1]
    kept = [low]
    for k in wanted[1:-1]:
        if k - kept[-1] > 0.02 * (high - low) and high - k > 0.02 * (high - low):
            kept.append(k)
    return np.array([*kept, high])


def hats(x: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return linear interpolation between `at` as features, (len(at), n)."""
    k = np.clip(np.searchsorted(at, x, side="right") - 1, 0, len(at) - 2)
    share = np.clip((x - at[k]) / (at[k + 1] - at[k]), 0.0, 1.0)
    out = np.zeros((len(at), len(x)))
    columns = np.arange(len(x))
    out[k, columns], out[k + 1, columns] = 1.0 - share, share
    return out
