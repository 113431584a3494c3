"""How large the gap is above what noise leaves: per output and sensor, on fitted and on held-out runs."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from hallsym.diagnosis.decoded_errors import BlockErrors
from hallsym.diagnosis.p_values import beyond
from hallsym.diagnosis.residual_table import ResidualTable
from hallsym.diagnosis.shares import CERTAIN, Powers, means, outputs, sensors

SIDES = ("fitted", "held_out")


def sizes(
    residues: Mapping[str, ResidualTable | None],
    errors: Mapping[str, BlockErrors],
    floor: Mapping[str, float],
) -> dict[str, Any]:
    """Return `{"outputs": {"x_m": ..}, "sensors": {"hall_a_m": ..}}`, each with "fitted" and "held_out".

    Every side holds, in SI: `rms`, `noise` (the floor of that output or sensor), `above` (root of the
    difference of their squares), `share` (of the excess of all outputs, as the gap metric weighs them, or of
    all sensors) and `p_value` (of no excess, from blocks of samples; noise that is larger than it was stated
    is an excess too). The share is None where the excess as a whole is no more than chance. Outputs come
    from `errors`, the decoded pose; sensors from `residues`. `floor`: noise by output.
    """
    out: dict[str, Any] = {"outputs": {}, "sensors": {}}
    for side in SIDES:
        r = residues.get(side)
        if r is None:
            continue
        clear = beyond(means(r.squares - len(r.residual), r.block)) < CERTAIN
        moved = outputs(r)
        rms = np.sqrt(errors[side].squares.sum(axis=0) / max(errors[side].count.sum(), 1.0))
        noise = np.array([floor.get(c, 0.0) for c in r.pose])
        _put(out["outputs"], side, moved, r.block, rms, noise, clear)
        seen = sensors(r)
        _put(out["sensors"], side, seen, r.block, seen.rms, np.sqrt(seen.noise), clear)
    return out


def _put(
    out: dict[str, Any],
    side: str,
    p: Powers,
    block: np.ndarray,
    rms: np.ndarray,
    noise: np.ndarray,
    clear: bool,
) -> None:
    above = np.maximum(rms**2 - noise**2, 0.0)
    weighed = above * p.weight
    total = float(weighed.sum())
    for k, name in enumerate(p.names):
        out.setdefault(name, {})[side] = {
            "rms": float(rms[k]),
            "noise": float(noise[k]),
            "above": float(np.sqrt(above[k])),
            "share": float(weighed[k] / total) if clear and total > 0 else None,
            "p_value": beyond(means(p.squares[k] / p.noise[k] - 1.0, block)),
        }
