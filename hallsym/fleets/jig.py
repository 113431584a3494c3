"""What rings on one jig have in common: places and heights of the heads, and the ripple of the drive.

The table belongs to its ring; heads and drive are those of the jig. Mixed effects in two passes: each ring by
itself, then the common values from all of them (medians, means that stand out of their scatter), then each
ring again with these fixed.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from hallsym.errors import InputError, counted, one_line
from hallsym.estimation.self_calibration import CONSTANT, Jig, SelfCalibration, self_calibrate
from hallsym.estimation.without_reference import (
    SelfFit,
    model_for_table,
    samples_of,
    self_fit_of,
    terms_of,
)
from hallsym.fleets.result import Fleet
from hallsym.fleets.row import AMISS, FAILED, GOOD, UNDETERMINED, record
from hallsym.fleets.workers import Failed, completed
from hallsym.log import Log
from hallsym.model import Model
from hallsym.shown import Shown

LEAST_RINGS = 8
"""Rings from which on a scatter between them is known to a third."""
STANDS_OUT = 4.0
"""Standard errors of its mean from which on a wave of the drive is common: by chance one in 3000 waves is."""
RAYLEIGH = 1.1774
"""Median of the length of a pair of normal numbers over the standard deviation of one of them."""


def jig_of(rings: Sequence[SelfCalibration]) -> Jig:
    """Return what rings have in common, from each ring calibrated by itself.

    Raises `InputError` for rings that are too few, or whose heads do not see one field.
    """
    closed = [r for r in rings if r.closure is not None]
    if len(closed) < LEAST_RINGS:
        raise InputError(
            f"A jig is known from {LEAST_RINGS} rings at least whose heads see one field; there are "
            f"{len(closed)}: calibrate each by itself with 'hallsym fit --reference'."
        )
    heads, _ = Counter(r.closure.jig.heads for r in closed if r.closure).most_common(1)[0]
    count = min(len(r.ripple) for r in closed)
    same = [r for r in closed if r.closure and r.closure.jig.heads == heads]
    places = np.median([r.closure.jig.places for r in same if r.closure], axis=0)
    heights = np.median([r.closure.jig.heights for r in same if r.closure], axis=0)
    ripple = np.array([r.ripple[:count] for r in same])
    mean = ripple.mean(axis=0)
    error = np.sqrt((np.abs(ripple - mean) ** 2).sum(axis=0) / (len(same) - 1) / len(same))
    common = np.abs(mean) > STANDS_OUT * error
    waves = min(len(r.line.table) for r in same)
    scatter = np.median(np.abs(ripple - mean), axis=0)[:waves] / RAYLEIGH
    return Jig(heads, places, heights, np.flatnonzero(common) + 1, mean[common], closure_std=scatter)


# -- a fleet of rings ---------------------------------------------------------------------------------------

OUTLYING = 5.0
"""Robust standard deviations above the median of what is left from which on a ring does not repeat."""


def calibrated(ring: tuple[str, dict[str, Any]]) -> SelfCalibration:
    """Return a ring calibrated, of its name and arguments of `self_calibrate`; a function workers import."""
    return self_calibrate(**ring[1])


@dataclass(frozen=True, eq=False, repr=False)
class RingFleet(Shown):
    """Rings of one jig: the table of devices, best first, each `SelfFit` by name, and what they share."""

    fleet: Fleet
    fits: Mapping[str, SelfFit]
    jig: Jig
    ripple_std: np.ndarray
    """(waves,) standard error of each part of the ripple of the drive [rad, mechanical]."""

    @property
    def pairs(self) -> int:
        """Pole pairs of the rings."""
        return next(iter(self.fits.values())).found.pairs

    @property
    def sentence(self) -> str:
        """What constant speed would have learned wrongly of every ring, in a sentence."""
        if not len(self.jig.orders):
            return f"The drive has no ripple that all {len(self.fits)} rings show."
        k = int(np.argmax(np.abs(self.jig.ripple)))
        size, error = (np.degrees(v[k]) * self.pairs for v in (np.abs(self.jig.ripple), self.ripple_std))
        return (
            f"The drive has a ripple that all {len(self.fits)} rings show: {size:.2f} +- {error:.2f} "
            f"electrical deg at wave {self.jig.orders[k]} per turn; a table from constant speed would have "
            "learned it as each sensor's, and it is taken off."
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the record that `hallsym fleet --json` prints of rings."""
        return {
            "sentence": self.sentence,
            "heads": [h + 1 for h in self.jig.heads],
            "places_rad": self.jig.places.tolist(),
            "heights": self.jig.heights.tolist(),
            "ripple": [
                {"per_turn": int(n), "rad": float(abs(c)), "std_rad": float(s)}
                for n, c, s in zip(self.jig.orders, self.jig.ripple, self.ripple_std, strict=True)
            ],
            "fleet": self.fleet.to_dict(),
        }

    def save(self, path: Any) -> None:
        """Write the table of devices."""
        self.fleet.save(path)


def ring_fleet(
    logs: Mapping[str, Log],
    model: str | Model | None = None,
    reference: str = CONSTANT,
    *,
    effects: Sequence[str] = (),
    parameters: Mapping[str, Mapping[str, float]] | None = None,
    workers: int | None = None,
    on_progress: Callable[[str], None] | None = None,
) -> RingFleet:
    """Calibrate rings of one jig without a reference; `logs`: name -> log.

    In two passes over all rings: each by itself, then with the places of the heads and the ripple of the
    drive that they have in common. A ring that does not turn, whose Hall is dead, or whose last turn is not
    as those before, has its reason in the table. Raises `InputError` where no jig is known from the rings.
    """
    began, say = perf_counter(), on_progress or (lambda _: None)
    models: dict[str, Model] = {}
    asked: dict[str, dict[str, Any]] = {}
    rows: dict[str, dict[str, Any]] = {}
    for name, log in logs.items():
        own = model_for_table(log, model, effects, parameters)
        pairs, phases, orders = terms_of(own)
        models[name], asked[name] = own, {
            "runs": samples_of(log, own), "pairs": pairs, "phases": phases, "reference": reference,
            "orders": orders,
        }  # fmt: skip
    jig: Jig | None = None
    found: dict[str, SelfCalibration] = {}
    for turn in ("each by itself", "with the jig"):
        alone = {name: one.closure for name, one in found.items()}
        work = [
            (name, {**ring, "jig": jig, "begin": alone.get(name)})
            for name, ring in asked.items()
            if name not in rows
        ]
        found = {}
        for (name, _), outcome in completed(calibrated, work, workers=workers):
            if isinstance(outcome, Failed):
                rows[name] = {"verdict": FAILED, "reason": one_line(outcome.reason)}
            else:
                found[name] = outcome
            say(f"{turn}: {len(found)} of {counted(len(work), 'ring')}")
        jig = jig or jig_of(list(found.values()))
    assert jig is not None
    fits = {n: self_fit_of(logs[n], models[n], found[n], asked[n]["runs"]) for n in asked if n in found}
    left = {n: f.left["table"][1] for n, f in found.items() if "table" in f.left}
    middle = float(np.median(list(left.values()))) if left else np.nan
    spread = 1.4826 * float(np.median(np.abs(np.array(list(left.values())) - middle))) if left else np.nan
    rows |= {name: _row(fits[name], left.get(name), middle, spread) for name in fits}
    order = sorted(rows, key=lambda n: (rows[n].get("left_rad") is None, rows[n].get("left_rad") or 0.0))
    table = tuple({"device": n, "log": str(logs[n].path or ""), **rows[n]} for n in order)
    scatter = np.array([f.ripple[jig.orders - 1] for f in found.values() if len(f.ripple)])
    error = scatter.std(axis=0) / np.sqrt(2 * len(fits))
    fleet = Fleet(table, next(iter(fits.values())).fit.model if fits else None, perf_counter() - began)
    return RingFleet(fleet, fits, jig, error)


def _row(result: SelfFit, left: float | None, middle: float, spread: float) -> dict[str, Any]:
    """What the table of devices keeps of a ring."""
    fit, found = result.fit, result.found
    verdict, reason = GOOD, ""
    if left is not None and left > middle + OUTLYING * spread:
        verdict = AMISS
        reason = (
            f"It does not repeat: its last turn is off by {np.degrees(left):.2f} electrical deg, "
            f"the median ring's by {np.degrees(middle):.2f}."
        )
    elif result.open:
        verdict, reason = UNDETERMINED, result.sentence
    kept = [n for n in fit.model.names if n[0] in "VAp"]  # the table is its ring's: no spread of it is of use
    more = {"seconds": fit.seconds, "left_rad": left, "turns": float(sum(found.turns))}
    return record(fit, verdict, reason, kept) | more
