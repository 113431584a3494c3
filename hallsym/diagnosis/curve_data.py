"""The shape of what no effect explains: a curve, with a band, over the coordinate that carries most of it."""

from typing import Any

import numpy as np

from hallsym.diagnosis.curves import MEMORIES, Curve
from hallsym.diagnosis.localisation import Located
from hallsym.diagnosis.residual_table import ResidualTable, phase
from hallsym.units import readable

BAND = 1.96
"""Standard errors of a band, which come from runs left out in turn: 95 %."""
NAMES = {"sensed": "reading_m", "rate": "reading_rate_m_s"}
"""What JSON calls the columns that every sensor has for itself."""


def unexplained(found: Located, share: float) -> dict[str, Any]:
    """Return `{"share", "by", "at", "of_it", "curve"}` for what is left, as `located` found it.

    `share`: part of the gap above the noise floor that is left (squares). `by`: the first statement's
    coordinate, None where the rest goes with nothing; `of_it`: the share of the rest that goes with it.
    `curve`: `shape` over the coordinate that most of it goes with, None where there is none.
    """
    first = found.statements[0] if found.statements else None
    curve = found.curves[0] if found.curves else None
    return {
        "share": share,
        "by": first.by if first else None,
        "at": first.at if first else None,
        "of_it": first.share if first else None,
        "text": first.text if first else "it goes with no sensor, coordinate, frequency or run above chance",
        "curve": shape(curve, found.fitted) if curve and found.fitted else None,
    }


def shape(c: Curve, r: ResidualTable) -> dict[str, Any]:
    """Return a curve as data: how the residual of each reading follows a coordinate.

    `coordinate`, `column`, `unit`: of the `grid` (m,), `line`: whether that is a place on a line. `kind`:
    "offset" (`value` in m of reading) or "gain" (`value` is a relative change of the gain). By reading:
    `value`, `low`, `high`, each (m,), the band at 95 % from runs left out in turn. Several coordinates
    together, a direction of motion and an acceleration are no place on a line: `grid` counts features then,
    which `labels` names (else None).
    """
    value, spread, scale, gain = c.offset, c.spread, 1.0, False
    if c.gain is not None and c.gain_spread is not None and _size(c.gain) > _size(c.offset):
        value, spread, scale, gain = c.gain, c.gain_spread, c.scale, True
    periodic = {phase(x): x for x in r.references}
    column = periodic.get(c.coordinate.column, c.coordinate.column)
    of = {
        channel: {
            "value": (v / scale).tolist(),
            "low": ((v - BAND * e) / scale).tolist(),
            "high": ((v + BAND * e) / scale).tolist(),
        }
        for channel, v, e in zip(r.channels, value, spread, strict=True)
    }
    return {
        "coordinate": c.coordinate.name,
        "line": c.coordinate.ordered,
        "column": NAMES.get(column, column),
        "unit": c.coordinate.unit,
        "kind": "gain" if gain else "offset",
        "value_unit": "1" if gain else "m",
        "grid": c.at.tolist(),
        "labels": _labels(c, r),
        "readings": of,
    }


def _labels(c: Curve, r: ResidualTable) -> list[str] | None:
    """Names of the features of a coordinate that is no place on a line."""
    if c.coordinate.memory:
        return [f"play {w:g} rms" for w in MEMORIES]
    names = [readable(n)[2] for n in c.coordinate.of]
    if c.coordinate.gain and names:
        return [f"{what}, {n.capitalize()}" for what in ("offset", "gain") for n in names]
    return [readable(n)[2].removesuffix("_ref") for n in r.references] if names else None


def _size(curve: np.ndarray) -> float:
    """Mean square of a curve about its mean: a constant is the model's own."""
    return float(((curve - curve.mean(axis=1, keepdims=True)) ** 2).mean())
