"""The table of a calibration without a reference: over the turn, and wave by wave what it belongs to."""

from __future__ import annotations

import numpy as np

from hallsym.estimation.self_calibration import MOTION, OPEN, SENSOR, coefficients, columns
from hallsym.estimation.without_reference import SelfFit
from hallsym.report import picture as p


def waves_figure(result: SelfFit) -> p.Picture:
    """Return the table over the turn with the ripple left out, and the amplitude and verdict of each wave."""
    found = result.found
    degrees = np.degrees(1.0) * found.pairs
    orders, every = (np.array([w.per_turn for w in waves]) for waves in (found.kept, found.waves))
    angle = np.linspace(0, 2 * np.pi, max(720, 8 * int(every.max())))
    table = degrees * columns(angle, orders) @ coefficients(found.table)
    turn: list[p.Layer] = [p.line(np.degrees(angle), table, p.AFTER, "table")]
    motion = np.array([w.motion if w.verdict == MOTION and w.motion else 0j for w in found.waves])
    if motion.any():
        ripple = degrees * columns(angle, every) @ coefficients(motion)
        turn.append(p.line(np.degrees(angle), ripple, p.BEFORE, "motion, left out"))
    errors = degrees * np.array([np.nan if w.std is None else w.std for w in found.kept])
    size, pale = degrees * np.abs(found.table), p.Look(p.BLUE, p.PALE_BLUE)
    waves = [
        p.boxes(orders - 0.4, orders + 0.4, 0.0, size, pale, f"table ({SENSOR})"),
        p.line(orders, errors, p.GREY, "standard error"),
    ]
    for verdict, look in (
        (MOTION, p.Look(p.ORANGE, p.ORANGE, marker="v", size=6.0)),
        (OPEN, p.Look(p.INK, marker="x", size=6.0)),
    ):
        own = found.verdicts(verdict)
        if own:
            size = [degrees * abs((w.motion if verdict == MOTION else w.sensor) or 0) for w in own]
            waves.append(p.points([w.per_turn for w in own], size, look, verdict))
    drawn = (
        (p.Axis("mechanical angle [deg]", 0.0, 360.0, most=8), p.Axis("correction [electrical deg]"), turn),
        (
            p.Axis("waves per mechanical turn", 0.0, every.max() + 1.0, most=8),
            p.Axis("amplitude [electrical deg]", low=0.0),
            waves,
        ),
    )
    return p.Picture([p.Panel(*parts, height=150.0) for parts in drawn], across=1)
