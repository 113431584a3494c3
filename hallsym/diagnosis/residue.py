"""What a model leaves on a log, sample by sample, beside the coordinates that it may go with.

At most `ROOM` samples are held, evenly thinned, so that memory does not grow with the log.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hallsym.diagnosis.base import Base
from hallsym.diagnosis.residuals import pieces
from hallsym.diagnosis.spectrum import Spectrum
from hallsym.model.arrays import on_arrays
from hallsym.units import readable

ROOM = 60_000
"""Samples that are held."""
FOLDS = 64
"""Groups of neighbouring runs that are left out in turn, at most."""
BLOCKS = 48
"""Blocks that significance rests on, at least: runs, or stretches of runs where there are fewer runs."""
FEWEST = 24
"""Runs from which on a run is a block."""
STILL = 5.0
"""An axis that moves less than this many sigma of its noise (rms) stands still."""
PARTS = 4
SHORTEST = 20
"""A run is cut into that many parts at least, of that many samples."""


@dataclass(frozen=True, eq=False)
class Residue:
    """Residual of the readings on some runs and what it may go with.

    `residual`, `felt`, `speed`: (K, n) residual, expected reading at the smoothed reference, its rate [m, m,
    m/s]. `columns`: (n,) each. `precision`: (K, K) inverse covariance of one residual. `fold`, `block`,
    `part`: (n,) index of the group of runs, of the block for significance, of the stretch of a run.
    `output`: (n_pose, K) turns a residual into decoded pose. `state`: logged columns that the model reads.
    `length`: (n_pose,) what turns an output into length in the gap metric. `timed`: with a clock.
    """

    channels: tuple[str, ...]
    pose: tuple[str, ...]
    references: tuple[str, ...]
    state: tuple[str, ...]
    run: np.ndarray
    residual: np.ndarray
    felt: np.ndarray
    speed: np.ndarray
    columns: Mapping[str, np.ndarray]
    precision: np.ndarray
    fold: np.ndarray
    block: np.ndarray
    part: np.ndarray
    output: np.ndarray
    length: np.ndarray
    sigma: Mapping[str, float]
    spectrum: Spectrum = field(default_factory=Spectrum)
    timed: bool = True

    @property
    def squares(self) -> np.ndarray:
        """Whitened square of each sample, (n,); K on average where there is noise only."""
        return np.einsum("kn,kl,ln->n", self.residual, self.precision, self.residual)

    def run_of(self, group: np.ndarray) -> np.ndarray:
        """Return the run in which each of the consecutive groups begins."""
        first = np.flatnonzero(np.diff(group, prepend=group[0] - 1))
        return self.run[first]

    @property
    def excess(self) -> float:
        """Sum of the whitened squares above what the noise explains."""
        return float(self.squares.sum()) - self.residual.size


def residue(base: Base, runs: Sequence[int]) -> Residue | None:
    """Return what `base` leaves on `runs`; None where no sample of them counts."""
    model, wanted = base.model, frozenset(runs)
    read = on_arrays(model.reading)
    back = np.linalg.inv(base.whiten)
    stride = max(1, -(-base.log.rows // ROOM))
    out: dict[str, list[np.ndarray]] = {}
    spectrum = Spectrum()
    for piece in pieces(base, wanted):
        spectrum.add(piece)
        at = np.flatnonzero(piece.used)[::stride]
        data = {c: v[at] for c, v in piece.data.items()}
        for c in model.references:
            if c in model.period:
                data["turn_rad"] = data[f"d0_{c}"] % model.period[c]
                data["turning_rad_s"] = data[f"d1_{c}"]
            data[f"d0_{c}"] = moved(data[f"d0_{c}"], base.sigma.get(c, 0.0))
        smooth = [data[f"d0_{c}"] for c in model.references]
        (felt,) = read(base.p, base.zeros_in(piece.run), smooth, [data[c] for c in model.state])
        rows = {"residual": back @ piece.residual[:, at], "speed": back @ piece.speed[:, at], "felt": felt}
        for name, values in {**data, **rows, "run": np.full(len(at), piece.run)}.items():
            out.setdefault(name, []).append(values)
    if not out or sum(len(v) for v in out["run"]) == 0:
        return None
    joined = {c: np.concatenate(v, axis=-1) for c, v in out.items()}
    run = joined.pop("run")
    spread = np.asarray(model.noise_gain(base.p, [float(joined[c].mean()) for c in model.state], base.weight))
    fold, block, part = _blocks(run)
    made = {c.name for c in model.computed}
    logged = tuple(c for c in model.state if c not in made)
    return Residue(
        model.channels, model.pose, model.references, logged, run, joined.pop("residual"),
        joined.pop("felt"), joined.pop("speed"), joined,
        np.linalg.inv(base.covariance), fold, block, part, spread, base.pose_weights, base.sigma, spectrum,
        base.timed,
    )  # fmt: skip


def moved(x: np.ndarray, sigma: float) -> np.ndarray:
    """Return where an axis was: its mean where all that moved it is noise, which is part of the residual."""
    return x if len(x) == 0 or np.std(x) > STILL * sigma else np.full(len(x), x.mean())


def _blocks(run: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Group of runs to leave out, block for significance and stretch of a run of each sample."""
    _, first, order, counts = np.unique(run, return_index=True, return_inverse=True, return_counts=True)
    fold = order * min(FOLDS, len(first)) // len(first)
    parts = max(PARTS, -(-BLOCKS // len(first)))
    place = np.arange(len(run)) - first[order]
    each = np.clip(counts // SHORTEST, 1, parts)[order]
    part = order * parts + place * each // counts[order]
    return fold, (fold if len(first) >= FEWEST else part), part


# -- coordinates -------------------------------------------------------------------------------------------

KNOTS = 9
"""Knots of a smooth curve."""


@dataclass(frozen=True, eq=False)
class Coordinate:
    """What a residual may go with: `name`, the `column` behind it, its unit.

    `gain`: it may also change the gain. `own`: every sensor has its own, made from `felt` or `speed`. `fine`:
    the residual may have fine structure over it.
    """

    name: str
    column: str
    unit: str
    gain: bool = True
    own: bool = False
    fine: bool = False

    def values(self, r: Residue) -> np.ndarray | None:
        """Return (n,) values, (K, n) for each sensor's own; None where there are none or they do not vary."""
        if self.own:
            x = r.felt if self.column == "felt" else r.speed
        elif self.column in r.columns:
            x = r.columns[self.column]
        else:
            return None
        if self.fine and self.unit == "rad" and np.ptp(x) > TURN:
            x = np.mod(x, TURN)
        spread = float(np.std(x))
        return x if spread > max(5 * r.sigma.get(self.column, 0.0), 1e-15) else None


NAMES = {"z_m": "height Z", "rx_rad": "tilt Rx", "ry_rad": "tilt Ry", "rz_ref_rad": "rotation Rz"}
TOGETHER: dict[tuple[str, ...], str] = {("z_m", "rx_rad", "ry_rad"): "height Z and tilts Rx, Ry"}
TURN = 2 * np.pi
"""An angle that goes further than this is taken within the turn."""


TURNING = (
    Coordinate("temperature", "temperature_degc", "degC"),
    Coordinate("place in the turn", "turn_rad", "rad", gain=False, fine=True),
    Coordinate("speed", "turning_rad_s", "rad/s"),
    Coordinate("time in the campaign", "campaign_s", "s"),
    Coordinate("time since the start of the run", "run_s", "s", gain=False),
)
"""What the residual of a sensor that goes round may go with."""
CLOCKED = ("turning_rad_s", "campaign_s", "run_s")
"""What a log without time does not tell: there a counter stands for it."""


def coordinates(r: Residue) -> tuple[Coordinate, ...]:
    """Return what the residual of a model may go with: from the most telling to the least.

    Of two that explain the same the first is named.
    """
    if "turn_rad" in r.columns:
        return TURNING if r.timed else tuple(c for c in TURNING if c.column not in CLOCKED)
    states = [Coordinate(NAMES.get(c, readable(c)[2].replace("_", " ")), c, _unit(c)) for c in r.state]
    reading = _unit(r.channels[0])
    together = TOGETHER.get(r.state, ", ".join(s.name for s in states) + " together")
    return (
        Coordinate("temperature", "temperature_degc", "degC"),
        *states,
        *([Coordinate(together, "states", "1", gain=False)] if len(states) > 1 else []),
        Coordinate("the reading itself", "felt", reading, gain=False, own=True, fine=True),
        Coordinate("direction of motion", "direction", "1", gain=False, own=True),
        Coordinate("velocity", "speed", f"{reading}/s", own=True),
        Coordinate("acceleration", "acceleration", "m/s2", gain=False),
        *(Coordinate(_place(c, r), f"d0_{c}", _unit(c), fine=True) for c in r.references),
        Coordinate("time in the campaign", "campaign_s", "s"),
        Coordinate("time since the start of the run", "run_s", "s", gain=False),
    )


def _place(reference: str, r: Residue) -> str:
    if reference in NAMES:
        return NAMES[reference]
    stem = readable(reference)[2].removesuffix("_ref").replace("_", " ")
    if _unit(reference) != "rad":
        return f"place in the stroke of {stem}"
    return f"place in the turn of {stem}" if np.ptp(r.columns[f"d0_{reference}"]) > TURN else f"angle {stem}"


def _unit(column: str) -> str:
    return {"degc": "degC", "1": "1"}.get(unit := column.rpartition("_")[2], unit)


def knots(x: np.ndarray) -> np.ndarray:
    """Return ends and inner knots of a smooth curve over x: quantiles, none closer than 2 % of the range."""
    wanted = np.quantile(x, np.linspace(0.0, 1.0, KNOTS))
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
