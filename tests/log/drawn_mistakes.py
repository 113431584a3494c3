"""One mistake of a size drawn by a seed, in a healthy log of any kind: near the thresholds as well as far."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from healthy_logs import Arrays, healthy

Draw = np.random.Generator
Made = tuple[Arrays, str]
"""The changed columns, and a regular expression that says so."""


def drawn(mistake: str, kind: str, seed: int) -> Made:
    """Return a healthy log with one mistake, and what must be said of it."""
    return DRAWN[mistake](healthy(kind, seed), np.random.default_rng([seed, 7]))


def _reading(arrays: Arrays, rng: Draw) -> str:
    """A reading, one that moves most."""
    names = [c for c in arrays if c.startswith(("hall_", "v_")) or c == "angle_rad"]
    wide = [c for c in names if np.ptp(arrays[c]) > 0.3 * max(np.ptp(arrays[n]) for n in names)]
    return str(rng.choice(wide))


def _stretch(arrays: Arrays, length: int, rng: Draw) -> slice:
    """A stretch inside one run."""
    runs = [r for r in np.unique(arrays["run"]).tolist() if np.sum(arrays["run"] == r) > length + 20]
    here = np.flatnonzero(arrays["run"] == (rng.choice(runs) if runs else arrays["run"][0]))
    first = int(rng.integers(0, max(len(here) - length, 1)))
    return slice(int(here[first]), int(here[min(first + length, len(here)) - 1]) + 1)


def rail(arrays: Arrays, rng: Draw) -> Made:
    """A reading is cut off at one end or both, with or without noise behind it."""
    name = _reading(arrays, rng)
    x, share = arrays[name], rng.uniform(0.005, 0.2)
    high = np.quantile(x, 1 - share)
    low = np.quantile(x, share) if rng.random() < 0.5 else -np.inf
    noise = rng.choice([0.0, 1e-4, 1e-3, 4e-3]) * np.ptp(x)
    arrays[name] = np.clip(x, low, high) + noise * rng.standard_normal(len(x))
    return arrays, rf"{name} .* is saturated"


def held(arrays: Arrays, rng: Draw) -> Made:
    """A reading repeats one value."""
    name = _reading(arrays, rng)
    where = _stretch(arrays, int(rng.integers(8, 60)), rng)
    arrays[name][where] = arrays[name][where.start]
    return arrays, rf"{name} .* holds one value"


def dropped(arrays: Arrays, rng: Draw) -> Made:
    """A reading is zero for a while."""
    name = _reading(arrays, rng)
    arrays[name][_stretch(arrays, int(rng.integers(8, 60)), rng)] = 0.0
    return arrays, rf"{name} .* holds one value .* dropped out"


def twice(arrays: Arrays, rng: Draw) -> Made:
    """A stretch of the log is there again, later."""
    rows = len(arrays["run"])
    n = int(min(rng.integers(70, 400), rows // 2))
    again = {c: v[:n].copy() for c, v in arrays.items()}
    again["run"][:] = arrays["run"].max() + 1
    again["t_s"] = arrays["t_s"][-1] + 1.0 + again["t_s"] - again["t_s"][0]
    order = np.argsort(again["run"], kind="stable")
    return (
        {c: np.concatenate([v, again[c][order]]) for c, v in arrays.items()},
        r"are there twice|again, sample for sample|hold the same samples",
    )


def slower(arrays: Arrays, rng: Draw) -> Made:
    """A reading is recorded at a lower rate."""
    name, times = _reading(arrays, rng), int(rng.integers(3, 8))
    arrays[name] = np.repeat(arrays[name][::times], times)[: len(arrays["run"])]
    return arrays, rf"{name} .* repeats each value about"


def old(arrays: Arrays, rng: Draw) -> Made:
    """A reading repeats the value before now and then."""
    name, share = _reading(arrays, rng), rng.uniform(0.03, 0.2)
    at = np.flatnonzero(rng.random(len(arrays["run"])) < share)
    at = at[at > 0]
    arrays[name][at] = arrays[name][at - 1]
    return arrays, rf"{name} .* repeats the value before it"


def dead(arrays: Arrays, rng: Draw) -> Made:
    """A reading never changes in one run."""
    name = _reading(arrays, rng)
    runs, spans = np.unique(arrays["run"]), []
    for run in runs:
        spans.append(np.ptp(arrays[name][arrays["run"] == run]))
    here = arrays["run"] == runs[int(np.argmax(spans))]
    arrays[name][here] = arrays[name][here][0]
    return arrays, rf"{name} .* never changes"


def coarse(arrays: Arrays, rng: Draw) -> Made:
    """A reading takes few values."""
    name = _reading(arrays, rng)
    step = np.ptp(arrays[name]) / rng.uniform(3.0, 5.5)
    arrays[name] = step * np.round(arrays[name] / step)
    return arrays, rf"{name} .* takes \d values only"


DRAWN: dict[str, Callable[[Arrays, Draw], Made]] = {
    make.__name__: make for make in (rail, held, dropped, twice, slower, old, dead, coarse)
}
