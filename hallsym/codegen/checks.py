"""What a calibration must be before C is generated from it, and what its user should know."""

import hashlib
import json

import numpy as np

from hallsym.codegen.bounds import LEAST_GAIN, Bounds
from hallsym.codegen.decoupler import Decoupler
from hallsym.codegen.execution import on_arrays
from hallsym.errors import InputError
from hallsym.estimation.calibration import Fit
from hallsym.model import Model

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
            "were held at."
        )


def check_columns(model: Model) -> None:
    """Refuse a model whose columns a controller does not have, or that nothing can be decoded from."""
    for column in model.computed:
        raise InputError(
            f"Model {model.name} with {', '.join(model.effects)} needs {column.name}, which is computed from "
            "a whole log and its history; a controller does not have it: generate from a calibration without "
            "that effect."
        )
    if len(model.channels) < len(model.pose):
        raise InputError(
            f"Model {model.name} has fewer readings than pose coordinates; nothing can be decoded."
        )


def check_gains(found: Bounds) -> None:
    """Refuse a box within which a gain comes near zero."""
    for channel, share in found.least_gain.items():
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
            f"No recording tells {', '.join(fit.structural)} apart; only the combinations that readings "
            "depend on are used, and those are determined."
        )
    if fit.undetermined_by_log:
        notes.append(
            f"The log does not determine {', '.join(fit.undetermined_by_log)}; the values they were held at "
            "are used."
        )
    for channel, (source, sign) in zip(fit.model.channels, fit.wiring or (), strict=bool(fit.wiring)):
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
    printed, *seen = on_arrays(d)(inputs, d.constants)
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


def check_bounds(d: Decoupler, found: Bounds) -> None:
    """Refuse what could grow beyond all bounds somewhere in the box."""
    for column, error in found.error.items():
        if not np.isfinite(error):
            raise InputError(
                f"Nothing bounds the generated {column} of model {d.model.name} over the whole box: its "
                "iterations spread too far; give a smaller box with --range."
            )


def digest_of(fit: Fit) -> str:
    """Return the SHA-256 of a calibration that is in no file: of its model, values, noise and log."""
    record = {
        "model": fit.model.name,
        "effects": list(fit.model.effects),
        "parameters": dict(zip(fit.model.names, fit.values.tolist(), strict=True)),
        "noise": fit.noise.std,
        "log": dict(fit.log),
    }
    return sha256(json.dumps(record, sort_keys=True).encode())


def sha256(data: bytes) -> str:
    """Return the SHA-256 of a file's bytes in hex."""
    return hashlib.sha256(data).hexdigest()
