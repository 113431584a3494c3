"""A log without a reference becomes a calibration: the table of `self_calibration` in terms of a model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hallsym.errors import InputError, counted, listed, require
from hallsym.estimation.calibration import Fit, LogRecord, SolverRecord, calibrated
from hallsym.estimation.self_calibration import (
    FEW,
    MOTION,
    NONE,
    OPEN,
    REFERENCES,
    SPEEDS,
    Jig,
    SelfCalibration,
    Wave,
    coefficients,
    columns,
    self_calibrate,
)
from hallsym.estimation.task import model_of, versions_used
from hallsym.families import FAMILIES, adapted
from hallsym.log import Log, Noise, Sigma, as_log, wrapped
from hallsym.model import Model
from hallsym.shown import Shown

TABLE = "turn_waves"
"""The effect that holds a table over the turn; a family whose models take it can be calibrated so."""
POINTS = 8
"""Angles a wave at which a table is turned over, from decoding to reading."""
NAMED = 6
"""Waves that a sentence names."""


@dataclass(frozen=True, eq=False, repr=False)
class SelfFit(Shown):
    """A calibration without a reference: `fit` as any other, and `found`, what each wave belongs to."""

    fit: Fit
    found: SelfCalibration

    @property
    def sentence(self) -> str:
        """What constant speed would have learned wrongly, or what is not known, in a sentence."""
        return sentence_of(self.found)

    @property
    def open(self) -> tuple[Wave, ...]:
        """Waves that this recording does not separate from the motion."""
        return self.found.verdicts(OPEN)

    def save(self, path: Any) -> None:
        """Write the calibration."""
        self.fit.save(path)

    def to_dict(self) -> dict[str, Any]:
        """Return the record that `hallsym fit --json` prints without a reference."""
        found, closure = self.found, self.found.closure
        return {
            "sentence": self.sentence,
            "reference": found.reference,
            "pole_pairs": found.pairs,
            "turns": list(found.turns),
            "waves": [w.to_dict(found.pairs) for w in found.waves],
            "table_waves": [w.per_turn for w in found.kept],
            "separated_by": list(separated_by(found)),
            "left_rad": {name: {"rms": a, "less_motion": b} for name, (a, b) in found.left.items()},
            "one_field": None
            if closure is None
            else {
                "heads": [self.fit.model.channels[h] for h in closure.jig.heads],
                "places_rad": closure.jig.places.tolist(),
                "misfit": closure.misfit,
                "noise": closure.noise,
            },
            "speeds_ratio": found.line.ratio,
            "calibration": self.fit.to_dict(),
        }


def fit_without_reference(
    log: Any,
    model: str | Model | None = None,
    reference: str = NONE,
    *,
    effects: Sequence[str] = (),
    parameters: Mapping[str, Mapping[str, float]] | None = None,
    jig: Jig | None = None,
) -> SelfFit:
    """Calibrate an encoder whose log holds readings alone, or readings and `t_s`.

    `reference`: what is known of the motion, "none", "constant-speed" or "coasting". `effects`: a table of
    other waves than all that the pole pairs ask for, `turn_waves:count=4,step=25`. `jig`: what a fleet knows.
    Without `t_s` samples are taken at equal steps.

    Returns a `SelfFit`: `fit` is saved, evaluated and made C as any calibration; its parameters that this
    recording does not separate from the motion are not determined. Raises `InputError` for a log in which
    nothing turns.
    """
    require(reference in REFERENCES, "Input reference", f"one of {', '.join(REFERENCES)}", reference)
    log = as_log(log)
    model = model_for_table(log, model, effects, parameters)
    runs = samples_of(log, model)
    pairs, phases, orders = terms_of(model)
    found = self_calibrate(runs, pairs, phases, reference, orders=orders, jig=jig)
    return self_fit_of(log, model, found, runs)


def of_ring(model: Model) -> bool:
    """Return whether a model is of the family that can be calibrated without a reference."""
    return any(e.name == TABLE for e in model.family.effects)


def usual_model() -> str:
    """Return the model that is taken where none is named: of the family whose models take a table."""
    return next(f.default for f in FAMILIES if any(e.name == TABLE for e in f.effects))


def model_for_table(
    log: Log,
    model: str | Model | None,
    effects: Sequence[str] = (),
    parameters: Mapping[str, Mapping[str, float]] | None = None,
) -> Model:
    """Return the model of a log; raises `InputError` for one that cannot be fitted without a reference."""
    model = model_of(log, model or usual_model(), effects, parameters)
    if not of_ring(model):
        raise InputError(
            f"Model {model.name} cannot be calibrated without a reference; encoders of several Halls can: "
            f"--model {usual_model()}."
        )
    other = [e for e in model.effects if e != TABLE]
    if other:
        raise InputError(f"Without a reference the table alone is fitted; leave {', '.join(other)} out.")
    return model


def check_referenced(log: Log, model: Model) -> None:
    """Refuse a log without a reference, of a model that can be calibrated so, with the words for it."""
    if of_ring(model) and not set(model.references) & set(log.columns):
        raise InputError(
            f"{log.name} has no {model.references[0]}; without a reference say what is known of the motion: "
            f"--reference {'|'.join(REFERENCES)}, or map the column with --column {model.references[0]}=NAME."
        )


def terms_of(model: Model) -> tuple[int, np.ndarray, tuple[int, ...]]:
    """Return pole pairs, nominal electrical phases of the heads, and waves of the table if it states them."""
    pairs = int(model.layout[0].pole_pairs)
    phases = np.array([pairs * (h.place_rad - model.layout[0].place_rad) for h in model.layout])
    stated = [n for n in model.names if n[0] == "t" and n.endswith("c")] if TABLE in model.effects else []
    return pairs, phases, tuple(int(n[1:-1]) for n in stated)


def samples_of(log: Log, model: Model) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Return run -> times (samples,), rows without `t_s`, and readings (samples, heads)."""
    log.table.require(model.channels)
    timed, out = log.timed, {}
    for run in log.runs:
        data = log.run(run, (*model.channels, *(("t_s",) if timed else ())))
        x = np.stack([data[c] for c in model.channels], axis=1)
        time = data["t_s"] if timed else np.arange(len(x), dtype=float)
        if not np.isfinite(x).all() or not np.isfinite(time).all() or not (np.diff(time) > 0).all():
            raise InputError(
                f"Run {run} of {log.name} has readings that are no numbers, or a time that stands still; "
                "without a reference every sample counts: cut the log there."
            )
        out[run] = time, x
    return out


def self_fit_of(
    log: Log, model: Model, found: SelfCalibration, runs: Mapping[int, tuple[np.ndarray, np.ndarray]]
) -> SelfFit:
    """Return the calibration in the parameters of a model, the table turned over from decoding to reading."""
    if TABLE not in model.effects:
        model = adapted(model, (f"{TABLE}:count={len(found.kept)}",), {})
    plane, pairs, values = found.plane, found.pairs, model.named(model.nominal)
    std, sigma = dict.fromkeys(model.names, 0.0), {c: Sigma(0.0, "given") for c in model.references}
    x = np.concatenate([x for _, x in runs.values()])
    phi = np.concatenate([plane.phase(x) for _, x in runs.values()])
    basis = np.column_stack([np.ones(len(phi)), np.cos(phi), np.sin(phi)])
    inverse = np.linalg.inv(basis.T @ basis)
    for k, head in enumerate(model.layout):
        a, b = plane.shape[k]
        size = float(np.hypot(a, b))
        rest = x[:, k] - plane.offset[k] - basis[:, 1:] @ plane.shape[k]
        error = np.sqrt(np.diag(inverse) * np.mean(rest**2))
        left = np.sqrt(np.mean(rest**2) / (1 - 1 / len(model.layout)))  # the heads give the angle too
        sigma[head.channel] = Sigma(max(float(left), 1e-3), "estimated")
        values |= {f"V{head.label}": float(plane.offset[k]), f"A{head.label}": size}
        std |= {f"V{head.label}": float(error[0]), f"A{head.label}": float(error[1])}
        if k:
            nominal = values[f"place_{head.label}"]
            away = wrapped(np.array(np.arctan2(-b, a) - pairs * nominal), 2 * np.pi)
            values[f"place_{head.label}"] = nominal + float(away) / pairs
            std[f"place_{head.label}"] = float(error[2]) / size / pairs
    orders = np.array([w.per_turn for w in found.kept])
    table = _turned_over(orders, coefficients(found.table))
    unknown = set()
    for wave, c, s in zip(found.kept, *np.split(table, 2), strict=True):
        for part, value in (("c", c), ("s", s)):
            name = f"t{wave.per_turn}{part}"
            values[name], std[name] = float(value), np.nan if wave.std is None else wave.std
            unknown |= {name} if wave.std is None else set()
    spread = np.array([std[n] for n in model.names])
    fixed = (*tuple(p.name for p in model.parameters if p.width == 0), "zero")
    fit = calibrated(
        model, np.array([values[n] for n in model.names]), spread, np.diag(np.nan_to_num(spread) ** 2),
        determined=np.array([n not in unknown and n not in fixed for n in model.names]),
        method="no reference",
        reason="the scatter of turns, and the misfit of one field under the heads",
        degrees_of_freedom=np.full(len(model.names), np.inf),
        fixed=fixed,
        structural=(),
        combinations=(),
        offsets={},
        noise=Noise(sigma),
        noise_floor=dict.fromkeys(model.pose, 0.0),
        status="converged",
        message="",
        solver=SolverRecord(
            name=f"reference {found.reference}", loss="none", cost=0.0, cost_per_degree_of_freedom=1.0,
            evaluations=1, starts=1, share_at_optimum=1.0, seed=0,
        ),
        log=LogRecord(path=None if log.path is None else str(log.path), rows=len(x), runs=len(runs)),
        seconds=found.seconds,
        notes=tuple(notes_of(found)),
        undetermined_by_log=tuple(n for n in model.names if n in unknown),
        error_rows={},
        source=log,
        columns=dict(log.table.mapping),
        read_with=dict(log.table.source.read_with),
        versions=dict(versions_used()),
    )  # fmt: skip
    return SelfFit(fit, found)


def _turned_over(orders: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Return e of theta + e(theta) = u from h of u + h(u) = theta, both by their coefficients."""
    count = POINTS * int(orders.max())
    theta = np.arange(count) * 2 * np.pi / count
    u = theta.copy()
    for _ in range(20):
        u = theta - columns(u, orders) @ h
    waves = columns(theta, orders)
    return np.asarray(waves.T @ (u - theta) * (2 / count))


# -- sentences ----------------------------------------------------------------------------------------------


def electrical(found: SelfCalibration, angle: complex | float | None) -> float:
    """Return the size of a mechanical angle [rad] in electrical degrees."""
    return float("nan") if angle is None else float(np.degrees(abs(angle)) * found.pairs)


def _waves(waves: Sequence[Wave]) -> str:
    orders = sorted(w.per_turn for w in waves)
    return listed([str(n) for n in orders[:NAMED]]) + (
        f" and {len(orders) - NAMED} more" if len(orders) > NAMED else ""
    )


def sentence_of(found: SelfCalibration) -> str:
    """Return what constant speed would have learned wrongly, or what this recording leaves open."""
    motion, unknown = found.verdicts(MOTION), found.verdicts(OPEN)
    if motion:
        worst = motion[0]
        more = f" (and of {counted(len(motion) - 1, 'wave')} more)" if len(motion) > 1 else ""
        said = (
            f"A table from constant speed would have learned {electrical(found, worst.motion):.3f} +- "
            f"{electrical(found, worst.motion_std):.3f} electrical deg of the motion at wave "
            f"{worst.per_turn} per turn"
            f"{more} as the sensor's; this table leaves it out."
        )
        return said + (f" {_left_open(found, unknown)}" if unknown else "")
    if unknown:
        return _left_open(found, unknown)
    worst = max(found.waves, key=lambda w: w.motion_std or 0.0)
    return (
        "No wave of the motion shows: a table from constant speed would have learned none wrongly beyond "
        f"{electrical(found, worst.motion_std):.2f} electrical deg (wave {worst.per_turn} per turn, 1 sigma)."
    )


def _left_open(found: SelfCalibration, unknown: Sequence[Wave]) -> str:
    which = f"{'wave' if len(unknown) == 1 else 'waves'} {_waves(unknown)} per turn"
    if found.reference == NONE:
        return f"The readings alone do not tell {which} of the table; they are left out of it."
    return (
        f"This recording does not separate {which} of the sensor from the motion: the table holds both, and "
        "a ripple of the drive there is learned wrongly."
    )


def separated_by(found: SelfCalibration) -> tuple[str, ...]:
    """Return the recordings that separate what this one does not; empty where it separates all."""
    if not found.verdicts(OPEN):
        return ()
    motion = []
    if found.reference == NONE:
        motion = ["the motion beside the readings: --reference coasting, at two speeds in ratio 2 or more"]
    elif found.line.ratio < SPEEDS:
        motion = [
            "two speeds in ratio 2, the rotor coasting: a torque ripple falls with the speed squared (q = "
            "(slow / fast)^2, error sqrt(v_fast + q^2 v_slow) / (1 - q): 1.37 times that of one speed)"
        ]
    return (
        *motion,
        "a second head at an angle p where n p is near no multiple of 360 deg for these waves ('hallsym plan "
        "--encoder' lists them): it separates any motion, a stepper's or a gear's too",
        "turning back does not help: cogging and kinematic ripple are the same function of the angle in both "
        "directions",
    )


def notes_of(found: SelfCalibration) -> tuple[str, ...]:
    """Return what else a reader should know."""
    out = []
    closure, trained = found.closure, found.line.turns
    if closure is None:
        out.append("No two Halls see one field, so the readings alone tell nothing beyond the ellipse.")
    else:
        heads = listed([str(h + 1) for h in closure.jig.heads])
        out.append(
            f"Halls {heads} see one field: misfit {closure.misfit:.3g}, noise {closure.noise:.3g} in the "
            "unit of the readings."
        )
    if found.reference != NONE and trained < 4:
        out.append(
            f"The table is learned from {counted(trained, 'turn')}: slow wander of the speed makes it up to "
            f"{FEW[min(trained, 2)]:g} times worse than the errors of more turns say; record 5 or more."
        )
    if found.pairs > 1:
        out.append(
            "The table counts from the period in which the recording began; a controller must count periods "
            "from there, or use the waves of the period alone (turn_waves with the pole pairs as its step)."
        )
    out.append("The sense is that of the first run, the zero that of Hall 1: readings alone tell neither.")
    return tuple(out)
