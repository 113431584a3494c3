"""Which tolerance is worth money: global sensitivity of the nominal decoder's errors, before any data."""

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.model import Model
from hallsym.simulation import Campaign, paper_campaign
from hallsym.uncertainty.tolerances.calibrated import after_calibration
from hallsym.uncertainty.tolerances.ranges import USUAL, Tolerance, default_tolerances, given_tolerances
from hallsym.uncertainty.tolerances.result import Errors95, Tolerances, Worth
from hallsym.uncertainty.tolerances.sobol import (
    COVERAGE,
    Indices,
    Moments,
    design,
    field_indices,
    moments,
    scalar_indices,
)
from hallsym.uncertainty.tolerances.workspace import (
    Errors,
    Workspace,
    gain_ratio,
    nominal_errors,
    workspace_of,
)

BLOCK = 2**16
"""Machines times points that are evaluated at once; bounds the memory."""
LEAST_SAMPLES, MOST_SAMPLES = 16, 2**16
"""Base samples; the bootstrap of SALib takes 10 kB for each."""


def tolerances(
    model: Model,
    where: Campaign | Workspace | None = None,
    *,
    ranges: Mapping[str, Any] | tuple[Tolerance, ...] | None = None,
    samples: int = 1024,
    seed: int = 0,
) -> Tolerances:
    """Return how the errors of the nominal decoder follow from each tolerance of the machine.

    Machines are drawn with every parameter independent in its tolerance; each is read by a decoder that uses
    the nominal values, without calibration, noise or zero deviations. `where`: campaign or
    workspace over which errors count (default: the paper's campaign). `ranges`: see `given_tolerances`;
    default: nominal value +- half the width of the model's bounds. `samples`: base samples of Saltelli's
    design, a power of two; 3 n + 2 times as many machines are drawn for n tolerances. The same seed gives the
    same numbers. Needs SALib.

    Raises `InputError` for an unknown parameter or unit, a tolerance that is not positive, and one so wide
    that the gain of a machine crosses zero.
    """
    started = time.perf_counter()
    _check_samples(samples)
    if seed < 0:
        raise InputError(f"A seed must be a whole number, 0 or more; instead received {seed!r}.")
    where = paper_campaign() if where is None else where
    space = workspace_of(model, where) if isinstance(where, Campaign) else where
    all_ = _ranges(model, ranges)
    active = tuple(t for t in all_ if t.width > 0)
    if not active:
        raise InputError(f"Every parameter of {model.name} is exact: there is no tolerance to judge.")
    draws = design(len(active), samples, seed)
    machines = partial(_machines, all_, active)
    _check_gain(model, space, active, machines(np.concatenate([draws[:, 0], draws[:, -1]])))
    drawn = _Sums(nominal_errors(model, space), len(model.pose), space.points)
    found = drawn.run(draws, machines)
    worth = _worth(drawn, draws[:, 0], all_, active)
    return Tolerances(
        model=model,
        tolerances=all_,
        active=tuple(t.name for t in active),
        points=space.points,
        samples=samples,
        seed=seed,
        errors=_errors(found),
        indices=_indices(model, found, seed),
        worth=worth,
        remainder=after_calibration(model, space, machines(draws[:, 0]), np.array([t.width for t in all_])),
        notes=(*_notes(model, all_), *_worse(worth, active)),
        seconds=time.perf_counter() - started,
    )


def _ranges(model: Model, ranges: Mapping[str, Any] | tuple[Tolerance, ...] | None) -> tuple[Tolerance, ...]:
    if ranges is None:
        return default_tolerances(model)
    if isinstance(ranges, Mapping):
        return given_tolerances(model, ranges)
    if tuple(t.name for t in ranges) != model.names:
        raise InputError(f"'ranges' must hold one Tolerance per parameter of {model.name}, in its order.")
    return ranges


def _check_samples(samples: int) -> None:
    if not LEAST_SAMPLES <= samples <= MOST_SAMPLES or samples & (samples - 1):
        near = 2 ** round(np.log2(min(max(samples, LEAST_SAMPLES), MOST_SAMPLES)))
        raise InputError(
            f"'samples' must be a power of two from {LEAST_SAMPLES} to {MOST_SAMPLES}, such as {near}; "
            f"instead received {samples!r}."
        )


def _machines(all_: tuple[Tolerance, ...], active: tuple[Tolerance, ...], u: np.ndarray) -> np.ndarray:
    """Parameters (m, n) of machines at probabilities u (m, n_active); exact ones at their centre."""
    out = np.tile(np.array([t.centre for t in all_]), (len(u), 1))
    place = {t.name: k for k, t in enumerate(all_)}
    for j, t in enumerate(active):
        out[:, place[t.name]] = t.at(u[:, j])
    return out


def _check_gain(model: Model, space: Workspace, active: tuple[Tolerance, ...], drawn: np.ndarray) -> None:
    """Refuse ranges in which a probe loses or reverses its gain somewhere in the workspace."""
    rows = max(1, BLOCK // space.points)
    least = np.concatenate(
        [gain_ratio(model, space, drawn[k : k + rows]) for k in range(0, len(drawn), rows)]
    )
    bad = int(np.sum(least <= 0))
    if not bad:
        return
    nominal = np.tile(model.nominal, (2 * len(active), 1))
    for j, t in enumerate(active):
        nominal[[2 * j, 2 * j + 1], model.names.index(t.name)] = t.at(np.array([0.0, 1.0]))
    alone = gain_ratio(model, space, nominal).reshape(-1, 2).min(axis=1)
    worst = active[int(np.argmin(alone))]
    raise InputError(
        f"Tolerances let the gain of a probe cross zero in the workspace, in {bad} of {len(drawn)} machines "
        f"drawn; {worst.name} (+-{worst.width:.4g} {worst.unit}, "
        f"{'from the bounds of the model' if worst.source == 'bounds' else 'as given'}) moves it most: "
        'state a narrower tolerance in --ranges, or "exact".'
    )


# -- machines drawn, block by block ----------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Found:
    """Per pose coordinate: moments of the field, and squares and peaks (samples, n + 2) of each machine."""

    moments: list[Moments]
    mean: np.ndarray
    square: np.ndarray
    peak: np.ndarray


@dataclass(frozen=True, eq=False)
class _Sums:
    """Evaluates machines in blocks of bounded size."""

    errors: Errors
    n_pose: int
    points: int

    def blocks(self, samples: int, rows: int) -> Iterator[slice]:
        step = max(1, BLOCK // (rows * self.points))
        return (slice(k, min(k + step, samples)) for k in range(0, samples, step))

    def run(self, draws: np.ndarray, machines: Any) -> _Found:
        """Draw the whole design. The mean field comes first, from A and B, so that moments are centred."""
        samples, rows, n = draws.shape
        mean = np.zeros((self.n_pose, self.points))
        for at in self.blocks(samples, 2):
            mean += self.errors(machines(draws[at][:, [0, -1]].reshape(-1, n))).sum(axis=1)
        mean /= 2 * samples
        square, peak = np.empty((2, self.n_pose, samples, rows))
        parts: list[list[Moments]] = [[] for _ in range(self.n_pose)]
        for at in self.blocks(samples, rows):
            field = self.errors(machines(draws[at].reshape(-1, n))).reshape(
                self.n_pose, -1, rows, self.points
            )
            square[:, at] = np.einsum("csjt,csjt->csj", field, field) / self.points
            peak[:, at] = np.maximum(field.max(axis=-1), -field.min(axis=-1))
            for part, y, centre in zip(parts, field, mean, strict=True):
                part.append(moments(y, centre))
        joined = [
            Moments(*(np.concatenate([getattr(m, k) for m in part]) for k in ("first", "total", "variance")))
            for part in parts
        ]
        return _Found(joined, mean, square, peak)

    def squares(self, drawn: np.ndarray) -> np.ndarray:
        """Mean square over the workspace of each machine, (n_pose, m)."""
        out = np.empty((self.n_pose, len(drawn)))
        for at in self.blocks(len(drawn), 1):
            field = self.errors(drawn[at])
            out[:, at] = np.einsum("cst,cst->cs", field, field) / self.points
        return out


def _errors(found: _Found) -> Errors95:
    square, peak = (v[:, :, [0, -1]].reshape(len(v), -1) for v in (found.square, found.peak))
    return Errors95(
        rms=np.sqrt(square.mean(axis=1)),
        mean=np.sqrt((found.mean**2).mean(axis=1)),
        rms_spread=np.sqrt(square).std(axis=1),
        rms_95=np.sqrt(np.quantile(square, 0.95, axis=1)),
        peak_95=np.quantile(peak, 0.95, axis=1),
    )


def _indices(model: Model, found: _Found, seed: int) -> dict[str, dict[str, Indices]]:
    return {
        "error": {c: field_indices(m, seed) for c, m in zip(model.pose, found.moments, strict=True)},
        "rms": {c: scalar_indices(np.sqrt(y), seed) for c, y in zip(model.pose, found.square, strict=True)},
        "peak": {c: scalar_indices(y, seed) for c, y in zip(model.pose, found.peak, strict=True)},
    }


def _worth(drawn: _Sums, u: np.ndarray, all_: tuple[Tolerance, ...], active: tuple[Tolerance, ...]) -> Worth:
    """Draw the machines A again, one tolerance exact or halved at a time, everything else the same."""
    before = drawn.squares(_machines(all_, active, u))
    rows = []
    for t in active:
        changed = []
        for other in (t.made_exact(), t.halved()):
            ranges = tuple(other if k.name == t.name else k for k in all_)
            moved = tuple(other if k.name == t.name else k for k in active)
            changed.append(drawn.squares(_machines(ranges, moved, u)))
        rows.append(_falls(before, *changed))
    return Worth(*np.array(rows).transpose(1, 0, 2))


def _falls(before: np.ndarray, exact: np.ndarray, halved: np.ndarray) -> np.ndarray:
    """Relative falls (4, n_pose) as in `Worth`; nothing can fall where there is no error."""
    level = before.mean(axis=1)
    safe = np.where(level > 0, level, 1.0)
    ratio = np.where(level > 0, exact.mean(axis=1) / safe, 1.0)
    half = np.where(level > 0, halved.mean(axis=1) / safe, 1.0)
    scatter = (exact - ratio[:, None] * before).std(axis=1, ddof=1) / np.sqrt(before.shape[1]) / safe
    width = np.where(ratio > 0, COVERAGE * scatter / (2 * np.sqrt(np.where(ratio > 0, ratio, 1.0))), 0.0)
    spread = np.sqrt(before).std(axis=1)
    fall = 1 - np.sqrt(exact).std(axis=1) / np.where(spread > 0, spread, 1.0)
    return np.array([1 - np.sqrt(ratio), 1 - np.sqrt(half), width, np.where(spread > 0, fall, 0.0)])


def _worse(worth: Worth, active: tuple[Tolerance, ...]) -> Iterator[str]:
    worse = [
        t.name
        for t, fall in zip(active, worth.exact, strict=True)
        if np.any(fall < -worth.exact_half - 0.005)
    ]
    if worse:
        yield (
            f"the error grows where {', '.join(worse)} alone is brought to its nominal value "
            "and others stay off theirs in common."
        )


def _notes(model: Model, all_: tuple[Tolerance, ...]) -> Iterator[str]:
    bounds = [t.name for t in all_ if t.source == "bounds" and t.width > 0]
    if bounds:
        yield (
            f"the ranges of {len(bounds)} parameters are half the width of the model's bounds about the "
            "nominal value: search ranges of a calibration, not drawing tolerances."
        )
    usual = [t.name for t in all_ if t.source == USUAL and t.width > 0]
    if usual:
        yield (
            f"the ranges of {len(usual)} parameters are usual tolerances of such machines, not yours: state "
            "yours in a tolerance file."
        )
    lower, upper = model.bounds
    outside = [
        t.name
        for t, low, high in zip(all_, lower, upper, strict=True)
        if t.source == "bounds" and not low <= t.nominal <= high
    ]
    if outside:
        yield (
            f"the nominal value of {', '.join(outside)} lies outside its bounds; the range is about the "
            "nominal value (limits [low, high] in a tolerance file give another one)."
        )
    if model.zeros:
        yield "zero deviations are new at every reset, not a tolerance of the machine: they are left out."
