"""What sorting finds: gains and bins of the sensors, the drift, the repeats, and who was refused."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hallsym.sorting.bins import bins_of, change_probability, wrong_probability
from hallsym.sorting.seating import Refusal, Scatter
from hallsym.units import Array

METHODS = ("smooth", "ratio", "none")
"""How drift is taken out: by the smoothed reference, by each reading of it, or not at all."""


@dataclass(frozen=True, eq=False)
class Drift:
    """The drift and how it was taken out.

    `time` (m,) [s, or order], `read` (m,) the reference sensor's relative gain and `value` (m,) the drift
    behind it, relative; `noise` of the reference (1 sigma) and `step` of the drift between two measurements.
    `scatter`: repeatability that each method gives, where sensors were measured again. `per_kelvin`: change
    with the logged temperature and its standard uncertainty [1/K].
    """

    method: str
    time: Array
    read: Array | None
    value: Array
    noise: float
    step: float
    scatter: dict[str, float]
    per_kelvin: tuple[float, float] | None = None
    timed: bool = False

    @property
    def span(self) -> float:
        """Largest less smallest drift, relative."""
        return float(np.ptp(self.value)) if len(self.value) else 0.0


@dataclass(frozen=True, eq=False)
class Repeats:
    """Sensors measured again: `first` and `second` (r,) relative gains of their first two measurements."""

    scatter: Scatter
    first: Array
    second: Array

    @property
    def drift(self) -> float:
        """Mean change from the first to the second measurement, relative."""
        return float(np.mean(self.second - self.first))

    @property
    def std(self) -> float:
        """Standard deviation of that change; nan for one sensor."""
        return float(np.std(self.second - self.first, ddof=1)) if len(self.first) > 1 else float("nan")

    def changes(self, width: float) -> dict[int, tuple[int, float]]:
        """Return for each change in bins how many sensors made it, and how many are expected to."""
        moved = bins_of(self.second, width) - bins_of(self.first, width)
        reach = max(int(np.abs(moved).max(initial=1)), 1)
        known = np.isfinite(self.std) and self.std > 0
        return {
            k: (
                int((moved == k).sum()),
                len(moved) * change_probability(k, width, self.drift, self.std) if known else float("nan"),
            )
            for k in range(-reach, reach + 1)
        }


@dataclass(frozen=True, eq=False)
class Sorting:
    """Sensors that were sorted, all of shape (n,), and what the record says of the bench.

    `gain` [`unit`] and `offset` [`reading_unit`], `std` of the gain [`unit`] of `dof` degrees of freedom
    without the common scale of the known field, `offset_std` [`reading_unit`] (nan: nothing tells it),
    `relative` gain over `nominal`, `measurements` of each that count.
    """

    sensors: tuple[str, ...]
    gain: Array
    offset: Array
    std: Array
    offset_std: Array
    dof: float
    nominal: float
    unit: str
    reading_unit: str
    measurements: Array
    width: float
    drift: Drift
    repeats: Repeats | None
    refused: tuple[Refusal, ...]
    notes: tuple[str, ...]
    source: str
    seconds: float = 0.0

    @cached_property
    def relative(self) -> Array:
        """Gain over the nominal one, (n,)."""
        return np.asarray(self.gain / self.nominal)

    @cached_property
    def bin(self) -> Array:
        """Bin of each sensor, (n,): k stands for gains within half a width of 1 + k width."""
        return bins_of(self.relative, self.width)

    @cached_property
    def wrong(self) -> Array:
        """Probability that each sensor belongs to another bin, (n,)."""
        return wrong_probability(self.relative, self.std / self.nominal, self.dof, self.width)

    @property
    def expected_wrong(self) -> tuple[float, float]:
        """Sensors expected in a wrong bin, and the standard deviation of their number.

        The number grows as the repeatability, which `dof` leaves uncertain by 1 / sqrt(2 dof).
        """
        number = float(self.wrong.sum())
        return number, float(np.sqrt((self.wrong * (1 - self.wrong)).sum() + number**2 / (2 * self.dof)))

    @property
    def bins(self) -> dict[int, int]:
        """Number of sensors in each bin that holds any."""
        found, counts = np.unique(self.bin, return_counts=True)
        return dict(zip(found.tolist(), counts.tolist(), strict=True))

    def to_dict(self) -> dict[str, Any]:
        """Return the record as plain data: every sensor, bins, drift, repeats, refusals."""
        d, r = self.drift, self.repeats
        columns = (
            self.sensors,
            self.gain,
            self.std,
            self.offset,
            tuple(_number(x) for x in self.offset_std.tolist()),
            self.relative,
            self.bin,
            self.wrong,
            self.measurements,
        )
        names = (
            "sensor",
            "gain",
            "gain_std",
            "offset",
            "offset_std",
            "relative",
            "bin",
            "wrong_bin_probability",
            "measurements",
        )
        plain = [c if isinstance(c, tuple) else c.tolist() for c in columns]
        return {
            "source": self.source,
            "unit": self.unit,
            "offset_unit": self.reading_unit,
            "nominal": self.nominal,
            "bin_width": self.width,
            "degrees_of_freedom": self.dof if np.isfinite(self.dof) else None,
            "sensors": [dict(zip(names, row, strict=True)) for row in zip(*plain, strict=True)],
            "bins": [{"bin": k, "centre": 1 + k * self.width, "sensors": n} for k, n in self.bins.items()],
            "expected_wrong": dict(zip(("number", "std"), self.expected_wrong, strict=True)),
            "drift": {
                "method": d.method,
                "span": d.span,
                "reference_noise": d.noise,
                "step": d.step,
                "repeatability": d.scatter,
                "per_kelvin": (
                    None if d.per_kelvin is None else dict(zip(("value", "std"), d.per_kelvin, strict=True))
                ),
            },
            "repeats": (
                None
                if r is None
                else {
                    "std": r.scatter.std,
                    "sensors": len(r.first),
                    "drift": _number(r.drift),
                    "std_of_change": _number(r.std),
                    "changes": [
                        {"bins": k, "observed": n, "expected": _number(e)}
                        for k, (n, e) in r.changes(self.width).items()
                    ],
                }
            ),
            "refused": [{"sensor": x.sensor, "reason": x.reason, "whole": x.whole} for x in self.refused],
            "notes": list(self.notes),
            "seconds": self.seconds,
        }


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None
