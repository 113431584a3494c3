"""From a calibration to the files of a decoupler."""

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from hallsym.codegen.accepted import Ends, accepted_of
from hallsym.codegen.backend import Backend
from hallsym.codegen.bounds import LEAST_GAIN, Bounds, least_gains, straight
from hallsym.codegen.box import box_of, shortened
from hallsym.codegen.decoupler import Box, Decoupler, short, steps_on_arrays
from hallsym.codegen.float_backend import FloatBackend
from hallsym.codegen.folder import options_of as options_before
from hallsym.codegen.folder import record_of, replace_params, write_folder
from hallsym.codegen.integer_backend import IntegerBackend
from hallsym.codegen.integer_c import float_instead, integer_program
from hallsym.codegen.lowering import check_columns, lower, lowering_of, options_of
from hallsym.codegen.naming import (
    PREFIX,
    check_distinct,
    check_license,
    check_prefix,
    mapping,
    renamed,
)
from hallsym.codegen.observer import Observer
from hallsym.codegen.templates import LICENSE
from hallsym.errors import InputError, quoted, require
from hallsym.estimation.calibration import Fit
from hallsym.estimation.prediction import reading_variance
from hallsym.records import builtins
from hallsym.shown import Shown

ARITHMETICS = ("float", "q31")
REPLACED = (
    "decoupler_params.", "table/", "test/selftest", "test/faults.c", "proof/report.md", "proof/eva.c",
    "proof/exhaustive.c",
)  # fmt: skip
"""Beginnings of the files that a recalibration replaces: numbers, and what tries them."""
UNSEEN = {"accuracy": np.pi}
"""Options of float code of which integers take the model and the box alone: the least there is to compute."""


@dataclass(frozen=True, eq=False, repr=False)
class Generated(Shown):
    """What `generate` made: files by path, the backend that made them, largest errors met, and notes.

    `name`: prefix of symbols and files.
    """

    backend: Backend
    files: Mapping[str, str | bytes]
    errors: Mapping[str, float]
    notes: tuple[str, ...]
    name: str = PREFIX

    @property
    def decoupler(self) -> Decoupler:
        """The arithmetic from inputs to pose."""
        return self.backend.decoupler

    @property
    def bounds(self) -> Bounds:
        """Range and rounding error bound of the pose over the box."""
        return self.backend.bounds

    @property
    def params(self) -> dict[str, str | bytes]:
        """The files that a recalibration replaces."""
        beginnings = tuple(renamed(beginning, self.name) for beginning in REPLACED)
        return {name: content for name, content in self.files.items() if name.startswith(beginnings)}

    def write(self, folder: str | Path, *, force: bool = False, params_only: bool = False) -> None:
        """Write the folder, or only its parameters. Raises `InputError` before anything is written."""
        if params_only:
            replace_params(Path(folder), self.params, self.backend.layout, self.name)
        else:
            write_folder(Path(folder), self.files, force=force, name=self.name)

    def to_dict(self) -> dict[str, Any]:
        """Return the readable record."""
        d, backend = self.decoupler, self.backend
        return {
            "name": self.name,
            "model": d.model.name,
            "identifiers": mapping((*d.inputs, *d.pose)),
            "type": backend.type,
            "layout": f"0x{backend.layout:08x}",
            "table_bytes": len(backend.binary),
            "calibration_sha256": backend.record["calibration_sha256"],
            "box": {c: list(d.ends(c)) for c in d.inputs},
            **backend.summary(),
            "error_bound": dict(backend.error_bound),
            "error_met": dict(self.errors),
            "files": sorted(self.files),
            "notes": list(self.notes),
        }


def generate(
    fit: Fit,
    *,
    arithmetic: str | None = None,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    jacobian: bool = False,
    accuracy: float | None = None,
    allow_undetermined: bool = False,
    calibration_sha256: str | None = None,
    name: str = PREFIX,
    license: str | None = None,
    observer: Observer | None = None,
    like: str | Path | None = None,
) -> Generated:
    """Generate the C decoupler of a calibration.

    `arithmetic`: "float" (default), or "q31" for 32-bit integers, where a controller has no floating-point
    unit. `ranges`: least and greatest value by column [SI] in place of what the log recorded. `jacobian`:
    with `decoupler_jacobian()`, the slopes of the pose by the readings. Models of an angle: `accuracy` is
    what the correction of it may leave besides rounding [rad], default 3e-8, of integers 1e-5. Magnet arrays:
    `accuracy` is what harmonics and polynomials may leave of a place [m]. `name`: prefix of symbols and
    files, so that several decouplers fit in one image. `license`: SPDX expression in every file, default
    `LICENSE`: generated, and yours to license. `observer`: with `decoupler_predict()`, position and speed at
    the time that a controller asks for. `like`: a generated folder whose code it shall have, for a
    recalibration: what was chosen there is taken where it is not given. Raises `InputError` for a calibration
    that cannot be trusted on a controller.
    """
    before: Mapping[str, Any] = {} if like is None else record_of(Path(like))
    if arithmetic is None:
        arithmetic = "q31" if before.get("type") == "q31" else "float"
    require(arithmetic in ARITHMETICS, "The arithmetic", f"one of {', '.join(ARITHMETICS)}", arithmetic)
    check_prefix(name)
    check(fit, allow_undetermined)
    named = mapping((*fit.model.channels, *fit.model.state, *fit.model.pose))
    columns = [(c, short(c)) for c in (*fit.model.channels, *fit.model.state)]
    check_distinct(columns, map(short, fit.model.pose), ())
    record = {"model": fit.model.name, "calibration_sha256": calibration_sha256 or digest_of(fit)}
    record |= {} if name == PREFIX else {"name": name}
    record["license"] = check_license(str(before.get("license", LICENSE)) if license is None else license)
    chosen, kept = options_before(before), accepted_of(before)
    box = box_of(fit, ranges, kept or ())
    given: dict[str, Any] = {
        "accuracy": chosen.get("accuracy") if accuracy is None else accuracy,
        "correction": chosen.get("correction"),
    }
    if observer is None and "observer" in chosen:
        observer = Observer(**{**chosen["observer"], "said": tuple(chosen["observer"].get("said", ()))})
    if arithmetic == "q31":
        for option, wanted in {"jacobian": jacobian, "predict": observer}.items():
            if wanted:
                raise InputError(f"--{option} belongs to --arithmetic float; leave it out, or the integers.")
        backend: Backend = _integers(fit, record, box, given, chosen.get("plan"), ranges or {}, kept)
    else:
        jacobian = jacobian or "jacobian" in chosen
        backend = _floats(fit, record, box, given, jacobian, observer, kept)
    errors = backend.errors()
    notes = (
        *notes_of(fit),
        *shortened(fit, box),
        *(f"Column {quoted(c)} is {made} in C." for c, made in named.items()),
    )
    files = {
        renamed(path, name): renamed(content, name) if isinstance(content, str) else content
        for path, content in backend.files(errors, notes).items()
    }
    return Generated(backend, files, errors, notes, name)


def _check_names(d: Decoupler) -> None:
    """Refuse columns that are called like an entry, a step or a flag of the code."""
    others = [step.name for step in (*d.steps[: -len(d.pose)], *d.at_pose)] + [e.name for e in d.entries]
    others += [array.name for array in d.arrays] + [flag.name for flag in d.flags]
    check_distinct([(c, short(c)) for c in d.inputs], map(short, d.pose), others)


def _floats(
    fit: Fit, record: Mapping[str, Any], box: Box, given: Mapping[str, Any], jacobian: bool,
    observer: Observer | None, kept: Ends | None,
) -> FloatBackend:  # fmt: skip
    found = lower(fit, box, **given)
    if observer is not None:
        reach = {c: fit.model.period.get(c, 4 * max(map(abs, box.ends[c]))) / 2 for c in found.pose}
        found = observer.behind(found, reach)
    _check_names(found)
    if jacobian and not (found.at_pose or straight(found.steps)):
        raise InputError(
            f"--jacobian is not generated for {found.model.name} of the family {found.model.family}, whose "
            "rounding bound does not cover slopes; leave it out."
        )
    variant: dict[str, Any] = {"jacobian": "reading"} if jacobian else {}
    variant |= {} if observer is None else {"observer": asdict(observer)}
    record = {**record, **_recorded({**found.options, **variant}, given)}
    backend = FloatBackend(found, record, jacobian, kept=kept)
    check_gains(found)
    for column, error in backend.bounds.error.items():
        if not error < max(-backend.bounds.low[column], backend.bounds.high[column]):  # grows without end
            raise InputError(
                f"Nothing bounds the generated {column} of model {found.model.name} over the whole box: its "
                "iterations spread too far; give a smaller box with --range."
            )
    check_same(found)
    return backend


def _integers(
    fit: Fit, record: Mapping[str, Any], box: Box, given: Mapping[str, Any], plan: Sequence[int] | None,
    ranges: Collection[str], kept: Ends | None,
) -> IntegerBackend:  # fmt: skip
    if fit.model.family.decoder == "wave":
        raise float_instead(fit.model)
    options = options_of(lowering_of(fit.model))
    for column in ranges:
        if column in fit.model.channels and column in fit.model.period:
            raise InputError(
                f"--range {column} does not go with --arithmetic q31, where every bit pattern of {column} is "
                "an angle; leave it out."
            )
    found = lower(fit, box, **(UNSEEN if "correction" in options else given))
    _check_names(found)
    check_gains(found)
    check_same(found)
    made = integer_program(found, plan, **{name: value for name, value in given.items() if value is not None})
    chosen = _recorded({**made.options, "plan": made.plan}, given)
    return IntegerBackend(made.d, {**record, **chosen}, made, kept=kept)


def _recorded(options: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the choices of a lowering as `table/decoupler_params.json` holds them, for a recalibration."""
    found = {**options, **({} if given["accuracy"] is None else {"accuracy": given["accuracy"]})}
    return {"options": found} if found else {}


def decouple(fit: Fit) -> ca.Function:
    """Return the decoupled pose as a CasADi function `(reading, state) -> pose`, parameters as numbers.

    Columns in SI: `reading` (n_channels,), `state` (n_state,), `pose` (n_pose,); zero deviations are 0. The
    route for those who build with CasADi; `generate` writes C without it.
    """
    model = fit.model
    reading, state = ca.SX.sym("reading", len(model.channels)), ca.SX.sym("state", len(model.state))
    pose = model.decoded(fit.values, np.zeros(len(model.offsets)), reading, state, 1 / reading_variance(fit))
    return ca.Function("decouple", [reading, state], [pose], ["reading", "state"], ["pose"])


SAME = 1e-13
"""Largest difference [m, rad] between the printed expressions in double and the model's own decoded pose."""


def check(fit: Fit, allow_undetermined: bool) -> None:
    """Refuse a calibration that a controller cannot trust."""
    check_columns(fit.model)
    if fit.status != "converged":
        raise InputError(
            f"The fit did not converge ({fit.status}); a controller needs one that did: fit the log again."
        )
    if not np.all(np.isfinite(fit.values)):
        raise InputError("The calibration holds values that are not finite; fit the log again.")
    lower, upper = fit.model.bounds
    slack = 1e-9 * np.maximum(np.abs(lower), np.abs(upper))
    outside = (upper > lower) & ((fit.values < lower - slack) | (fit.values > upper + slack))
    for k in np.flatnonzero(outside)[:1]:
        raise InputError(
            f"Parameter {fit.model.names[k]} of the calibration is {fit.values[k]:g}, outside its bounds "
            f"{lower[k]:g} to {upper[k]:g}: no fit ends there; fit the log again."
        )
    if fit.undetermined_by_log and not allow_undetermined:
        names = ", ".join(fit.undetermined_by_log)
        raise InputError(
            f"The log of this calibration does not determine {names}, which the decoded pose depends on; "
            "record runs that move what they belong to, or give --allow-undetermined to use the values they "
            "were fixed at."
        )


def check_gains(d: Decoupler) -> None:
    """Refuse a box within which a gain comes near zero."""
    for channel, share in least_gains(d).items():
        if not share >= LEAST_GAIN:
            raise InputError(
                f"Within the box the gain of {channel} falls to {100 * share:.0f} % of its gain at rest, and "
                "what is decoded grows without bounds where it crosses zero; give a smaller box with --range."
            )


def notes_of(fit: Fit) -> tuple[str, ...]:
    """Return what a user of the code should know of the calibration."""
    amiss = fit.goodness and fit.goodness.said("The model of this calibration does not describe its log")
    notes = [f"{amiss}: the decoder inherits that error."] if amiss else []
    if fit.structural:
        notes.append(
            f"No recording distinguishes {', '.join(fit.structural)}; only the combinations that readings "
            "depend on are used, and those are determined."
        )
    if fit.undetermined_by_log:
        notes.append(
            f"The log does not determine {', '.join(fit.undetermined_by_log)}; the values they were fixed at "
            "are used."
        )
    for channel, (source, sign) in zip(fit.model.channels, fit.assignment or (), strict=bool(fit.assignment)):
        if (source, sign) != (channel, 1):
            notes.append(
                f"The fit took {channel} from {'-' if sign < 0 else ''}{source}: give it so here too."
            )
    if fit.at_bound:
        notes.append(f"{', '.join(fit.at_bound)} ended at a bound.")
    return tuple(notes)


def check_same(d: Decoupler) -> None:
    """Refuse a model whose decoded pose the printed expressions are not."""
    low, high = np.array([d.ends(c) for c in d.inputs]).T[:, :, None]
    rng = np.random.default_rng(0)
    share = np.hstack([rng.choice([0.0, 1.0], (len(low), 256)), rng.random((len(low), 2048))])
    inputs = low + (high - low) * share if d.drawn is None else d.drawn(rng, 2304)
    printed, *seen = steps_on_arrays(d)(inputs, d.constants)
    if seen:
        clear = d.raised(seen[0]) == 0
        printed, inputs = printed[:, clear], inputs[:, clear]
    off = np.abs(d.difference(printed, d.exact(inputs))).max(axis=1, initial=0.0)
    for column, error in zip(d.pose, off, strict=True):
        if not error <= d.left(column) + d.cut + SAME:
            raise InputError(
                f"The generated {column} differs by {error:.3g} from model {d.model.name}: its readings are "
                "no polynomial of pose and state times a gain, and C cannot be generated for it."
            )


def digest_of(fit: Fit) -> str:
    """Return the SHA-256 of a calibration that is in no file: of its model, values, noise and log."""
    record = {
        "model": fit.model.name,
        "effects": list(fit.model.effects),
        "parameters": fit.model.named(fit.values),
        "noise": fit.noise.std,
        "log": builtins(fit.log),
    }
    return sha256(json.dumps(record, sort_keys=True).encode())


def sha256(data: bytes) -> str:
    """Return the SHA-256 of a file's bytes in hex."""
    return hashlib.sha256(data).hexdigest()
