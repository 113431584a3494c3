"""Which measurements are refused, and why: a sensor that was not seated or not connected."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from hallsym.sorting.bench import Measured
from hallsym.sorting.bins import LOT
from hallsym.sorting.drift import FALSE_REFUSALS, Smooth, limit, robust_std
from hallsym.units import Array

FACTOR = 2.0
"""A gain beyond this factor of the median is no sensor in its seat: their tolerances are 15 to 30 %."""
FEWEST = 5
"""Fewest degrees of freedom of a repeatability that may refuse a sensor."""
MAD_EFFICIENCY = 0.37
"""Degrees of freedom of a median absolute deviation over those of a standard deviation, normal values."""


@dataclass(frozen=True)
class Refusal:
    """Why a sensor has no gain, or one of its measurements does not count (`whole` false)."""

    sensor: str
    reason: str
    whole: bool = True


class Reasons(dict[int, str]):
    """The first reason against each measurement, by its index."""

    def refuse(self, which: Array, reason: list[str]) -> None:
        """Refuse the measurements `which` (indices), each with its reason, where none is refused yet."""
        for at, text in zip(which.tolist(), reason, strict=True):
            self.setdefault(at, text)

    def good(self, count: int) -> Array:
        """Return which of `count` measurements stand, as a mask."""
        mask = np.ones(count, bool)
        mask[list(self)] = False
        return mask


def refuse_readings(m: Measured, reasons: Reasons) -> None:
    """Refuse measurements in one field only, those whose readings are on no line, and gains of no sensor."""
    few = np.flatnonzero(~np.isfinite(m.gain))
    reasons.refuse(
        few,
        [
            "it was read in one field only; a gain needs two" if n else "it has no reading"
            for n in m.levels[few]
        ],
    )
    good = reasons.good(len(m.gain))
    middle = float(np.median(m.gain[good])) if good.any() else 0.0
    ratio = m.gain / middle if middle else np.ones(len(m.gain))
    for which, text in (
        (
            ratio < 0,
            "its readings fall where the others rise (gain {:+.3g} of the median): turned over or swapped",
        ),
        (
            (ratio >= 0) & (ratio < 1 / FACTOR),
            (
                "its readings hardly differ between the fields (gain {:.3g} of the median): not seated or"
                " not connected"
            ),
        ),
        (
            ratio > FACTOR,
            (
                "its readings differ too much between the fields (gain {:.3g} of the median): not seated or"
                " not connected"
            ),
        ),
    ):
        at = np.flatnonzero(which & good)
        reasons.refuse(at, [text.format(r) for r in ratio[at]])
    _refuse_bent(m, reasons)


def _refuse_bent(m: Measured, reasons: Reasons) -> None:
    at = np.flatnonzero(reasons.good(len(m.gain)) & (m.levels > 2))
    if len(at) < 2:
        return
    size = m.off_line[at]
    far = size > limit(len(at)) * max(float(np.median(size)), np.finfo(float).tiny)
    share = 100 * size / np.abs(m.gain[at] * m.span[at])
    reasons.refuse(
        at[far], [f"its readings are on no line: one is {s:.2g} % of the span off" for s in share[far]]
    )


def refuse_conflicting(m: Measured, scatter: float, reasons: Reasons) -> None:
    """Refuse measurements with readings in one field that differ more than those of the others.

    Where hardly any field was read twice: more than a new seat brings, `scatter`.
    """
    at = np.flatnonzero(reasons.good(len(m.gain)) & (m.levels == 2) & (m.off_line > 0))
    share = m.off_line[at] / np.abs(m.gain[at] * m.span[at])
    level = float(np.median(share)) if len(at) >= FEWEST else scatter
    far = share > limit(len(at)) * level
    text = "its readings in one field differ, by {:.2g} % of the change between the fields"
    reasons.refuse(at[far], [text.format(200 * s) for s in share[far]])


def refuse_by_reference(m: Measured, drift: Smooth, reasons: Reasons) -> None:
    """Refuse measurements in which the reference sensor reads other than shortly before and after."""
    assert m.relative is not None
    missing = np.flatnonzero(~np.isfinite(m.relative))
    reasons.refuse(missing, ["the reference sensor was not read"] * len(missing))
    at = np.flatnonzero(drift.bad & np.isfinite(m.relative))
    reasons.refuse(
        at,
        [
            f"the reference sensor read {100 * v:+.2g} % beside its neighbours: not seated"
            for v in drift.off[at]
        ],
    )


def refuse_strangers(gain: Array, offset: Array, reasons: Reasons) -> None:
    """Refuse measurements whose gain (over the median) or offset (over the median gain) [T] no lot has."""
    good = np.flatnonzero(reasons.good(len(gain)))
    if len(good) < LOT:
        return
    for values, text in (
        (np.log(gain[good]), "its gain is {:.1f} standard deviations of the lot from the median"),
        (offset[good], "its offset is {:.1f} standard deviations of the lot from the median"),
    ):
        low, high = np.quantile(values, [0.01, 0.99])
        spread = max(robust_std(values), float(high - low) / 4.653)  # a lot of two reels is no normal one
        away = np.abs(values - np.median(values)) / spread if spread > 0 else np.zeros(len(values))
        far = away > limit(len(good))
        reasons.refuse(good[far], [text.format(z) for z in away[far]])


@dataclass(frozen=True)
class Scatter:
    """Repeatability of one measurement, relative (1 sigma), of `dof` degrees of freedom; from `sensors`."""

    std: float
    dof: float
    sensors: int


def repeatability(
    sensor: Array, gain: Array, reasons: Reasons, stated: float | None = None
) -> Scatter | None:
    """Return the scatter of repeated measurements, and refuse those that contradict each other.

    Of three or more measurements of a sensor the one that is off is refused, of two both are. `stated`
    stands in place of the scatter that is found.
    """
    at = np.flatnonzero(reasons.good(len(gain)))
    groups = [g for g in grouped(sensor[at], at) if len(g) > 1]
    if not groups:
        return None if stated is None else Scatter(stated, np.inf, 0)
    away = np.concatenate([_deviations(gain[g]) for g in groups])
    dof = float(sum(len(g) - 1 for g in groups))
    level = stated or float(np.median(np.abs(away))) / 0.6745
    if stated or dof >= FEWEST:
        free = np.inf if stated else max(MAD_EFFICIENCY * dof, 1.0)
        allowed = level * float(student.isf(FALSE_REFUSALS / (2 * len(away)), free))
        groups = [_consistent(g, gain, allowed, reasons) for g in groups]
    kept = [_deviations(gain[g]) ** 2 for g in groups if len(g) > 1]
    free = float(sum(len(k) - 1 for k in kept))
    if stated is not None or not free:
        return Scatter(stated or level, np.inf if stated else 1.0, len(kept))
    # each squared deviation is scaled to the variance of one measurement
    total = sum(float(k.sum()) * (len(k) - 1) / len(k) for k in kept)
    return Scatter(float(np.sqrt(total / free)), free, len(kept))


def grouped(sensor: Array, at: Array) -> list[Array]:
    """Return the measurements `at` of each `sensor` (both (g,)), one array a sensor."""
    order = np.argsort(sensor, kind="stable")
    edges = np.flatnonzero(np.diff(sensor[order])) + 1
    return np.split(at[order], edges)


def _deviations(gain: Array) -> Array:
    """Relative deviations from the mean, each scaled to the standard deviation of one measurement."""
    n, mean = len(gain), float(gain.mean())
    return np.asarray((gain / mean - 1) * np.sqrt(n / (n - 1)))


def _consistent(group: Array, gain: Array, allowed: float, reasons: Reasons) -> Array:
    """The measurements of a sensor that agree; the others are refused one by one."""
    while len(group) > 1:
        away = _deviations(gain[group])
        if np.abs(away).max() <= allowed:
            break
        apart = 100 * np.ptp(gain[group]) / np.mean(gain[group])
        if len(group) == 2:
            text = (
                f"its 2 measurements differ by {apart:.2g} %, repeats of the lot by at most"
                f" {141.4 * allowed:.2g} %"
            )
            reasons.refuse(group, [text] * 2)
            return group[:0]
        middle = float(np.median(gain[group]))
        worst = int(np.argmax(np.abs(gain[group] - middle)))
        reasons.refuse(
            group[[worst]],
            [f"a measurement is {100 * (gain[group[worst]] / middle - 1):+.2g} % off its others"],
        )
        group = np.delete(group, worst)
    return group
