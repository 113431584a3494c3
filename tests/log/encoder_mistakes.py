"""Mistakes that only the fit of an encoder reveals: voltages and references that turn another way."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from mistakes import ENCODER, Arrays, Ends, Make, Mistake


def turned(change: Callable[[np.ndarray], np.ndarray], *columns: str, run: int | None = None) -> Make:
    """Change columns, in one run or in all."""

    def make(arrays: Arrays) -> None:
        at = slice(None) if run is None else arrays["run"] == run
        for column in columns:
            arrays[column][at] = change(arrays[column][at])

    return make


def exchanged(run: int | None = None) -> Make:
    """Exchange both voltages, in one run or in all."""

    def make(arrays: Arrays) -> None:
        at = slice(None) if run is None else arrays["run"] == run
        sine = arrays["v_sin_v"][at].copy()
        arrays["v_sin_v"][at] = arrays["v_cos_v"][at]
        arrays["v_cos_v"][at] = sine

    return make


def times(factor: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return what multiplies by a factor."""
    return lambda values: factor * values


def of_fit(name: str, make: Make, says: str, ends: Ends = "claim") -> Mistake:
    return Mistake(f"encoder: {name}", make, says, ends, found="fit", on=ENCODER)


_TURN, _PLATES = 2 * np.pi, ("v_sin_v", "v_cos_v")
_UNIT = r"undo it with --correct 'scale angle_ref_rad {}'"
_REVERSED = r"turns against angle_ref_rad .*; v_sin_v is taken with its sign reversed"

ENCODERS = (
    of_fit("degrees for rad", turned(np.degrees, "angle_ref_rad"), _UNIT.format("deg")),
    of_fit("rad for degrees", turned(np.radians, "angle_ref_rad"), _UNIT.format("57.2957795")),
    of_fit("turns for rad", turned(times(1 / _TURN), "angle_ref_rad"), _UNIT.format("rev")),
    of_fit("gradians for rad", turned(times(400 / _TURN), "angle_ref_rad"), _UNIT.format("grad")),
    of_fit("mrad for rad", turned(times(1e3), "angle_ref_rad"), _UNIT.format("mrad")),
    of_fit(
        "degrees for rad in one run", turned(np.degrees, "angle_ref_rad", run=1), _UNIT.format("deg in 1")
    ),
    of_fit(
        "counts of another resolution",
        turned(lambda a: np.mod(a, _TURN) / 4, "angle_ref_rad"),
        _UNIT.format("4"),
    ),
    of_fit("mV for V", turned(times(1e3), *_PLATES), r"--correct 'scale v_sin_v,v_cos_v mv'"),
    of_fit("mV for V in one column", turned(times(1e3), "v_cos_v"), r"--correct 'scale v_cos_v mv'"),
    of_fit("an inverted plate", turned(np.negative, "v_cos_v"), _REVERSED, "remark"),
    of_fit("exchanged plates", exchanged(), _REVERSED, "remark"),
    of_fit("an inverted reference", turned(np.negative, "angle_ref_rad"), _REVERSED, "remark"),
    of_fit("plates exchanged in one run", exchanged(run=2), r"--correct 'exchange v_sin_v v_cos_v in 2'"),
    of_fit(
        "the reference inverted in one run",
        turned(np.negative, "angle_ref_rad", run=2),
        r"--correct 'sign angle_ref_rad in 2'",
    ),
    of_fit(
        "a reference that stands in one run",
        turned(times(0.0), "angle_ref_rad", run=1),
        r"--correct 'clipped angle_ref_rad .* inf",
    ),
)
