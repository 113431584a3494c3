"""The table of a calibration without a reference: over the turn, and wave by wave what it belongs to."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hallsym.estimation.self_calibration import MOTION, OPEN, SENSOR, coefficients, columns
from hallsym.estimation.without_reference import SelfFit
from hallsym.report.figures.style import AFTER, BEFORE, BLACK, GREY

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def waves_figure(result: SelfFit) -> Figure:
    """Return the table over the turn with the ripple left out, and the amplitude and verdict of each wave."""
    from matplotlib.figure import Figure

    found = result.found
    degrees = np.degrees(1.0) * found.pairs
    orders, every = (np.array([w.per_turn for w in waves]) for waves in (found.kept, found.waves))
    angle = np.linspace(0, 2 * np.pi, max(720, 8 * int(every.max())))
    at = columns(angle, orders)
    motion = np.array([w.motion if w.verdict == MOTION and w.motion else 0j for w in found.waves])
    figure = Figure(figsize=(9.0, 5.6), layout="constrained")
    turn, waves = figure.subplots(2, 1)
    turn.plot(
        np.degrees(angle), degrees * at @ coefficients(found.table), color=AFTER, linewidth=1.0, label="table"
    )
    if motion.any():
        ripple = degrees * columns(angle, every) @ coefficients(motion)
        turn.plot(np.degrees(angle), ripple, color=BEFORE, linewidth=0.8, label="motion, left out")
    turn.set(xlabel="mechanical angle [deg]", ylabel="correction [electrical deg]", xlim=(0, 360))
    turn.set_ylim(*(1.3 * end for end in turn.get_ylim()))
    turn.legend(ncols=2, frameon=False, loc="upper right")
    sizes = degrees * np.abs(found.table)
    waves.bar(orders, sizes, width=0.8, color=AFTER, alpha=0.6, label=f"table ({SENSOR})")
    errors = degrees * np.array([np.nan if w.std is None else w.std for w in found.kept])
    waves.plot(orders, errors, color=GREY, linewidth=1.0, label="standard error")
    for verdict, mark, color in ((MOTION, "v", BEFORE), (OPEN, "x", BLACK)):
        own = found.verdicts(verdict)
        if own:
            size = [degrees * abs((w.motion if verdict == MOTION else w.sensor) or 0) for w in own]
            waves.plot([w.per_turn for w in own], size, mark, color=color, markersize=6, label=verdict)
    waves.set(
        xlabel="waves per mechanical turn", ylabel="amplitude [electrical deg]", xlim=(0, every.max() + 1)
    )
    waves.set_ylim(0, 1.3 * waves.get_ylim()[1])
    waves.legend(frameon=False, loc="upper right", ncols=2)
    for each in (turn, waves):
        each.spines[["top", "right"]].set_visible(False)
    return figure
