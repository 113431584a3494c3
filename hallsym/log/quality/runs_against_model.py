"""Runs that do not belong: one that the others contradict, and a channel whose gain steps at some moment.

From the products of each run's columns, which hold all that linear least squares can ask of it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from hallsym.log.quality.findings import Finding
from hallsym.log.quality.gains import Products, listed, run_finding
from hallsym.model import Model

HEALTHY = 1.25
"""Mean square of a run's residuals over that of noise up to which nothing is asked."""
CERTAIN = 8.0
"""Standard deviations of noise that a chi-square must exceed what is expected of noise."""
SCATTER = 4.0
"""Standard deviations by which the chi-square of the other runs may exceed what is expected of noise."""
ALONE, OWN = 0.05, 0.2
"""Share of the excess chi-square that may be left without the run that does not belong, or with the step: an
effect that all runs have leaves more. Share of the run's own excess that its own coefficients may leave: else
it is the noise that is another."""
PARTLY = 0.25
"""Share of the excess that may be left where a step falls into a run, which then fits neither."""
SLIP = 0.03
"""Step of a gain up to which a mount may have slipped, an effect for `hallsym diagnose`; beyond it a range, a
supply or a probe was changed."""
FEWEST, TRIED = 4, 8
"""Runs beside the odd one that have to agree; runs that are tried as the odd one, those that fit worst."""
CLEARLY = 4.0
"""Mean square over that of noise from which on a run is odd whose gains are those of the others."""
ODD_SHARE = 0.2
"""Share of the largest change of a gain up to which another gain counts as unchanged."""
SINGULAR = 1e-6
"""Part of a step that the model must not be able to imitate, for its size to mean anything."""
LOUD = 10.0
"""Variance of what a channel hears in a run over noise from which on its gain there is known."""

Sums = Callable[[np.ndarray, int], np.ndarray]


def judge_runs(log: Any, model: Model, seen: Products, holdout: Collection[int] = ()) -> Iterator[Finding]:
    """Judge runs by what the others say of them: one that they contradict, and a gain that steps."""
    n = len(seen.runs)
    if not len(seen.features[0]):
        return
    whole = seen.chi_squares(seen.coefficients(np.ones((1, n))))[0]
    noise = seen.counts * len(seen.variance)
    worst = whole.sum(axis=1) / noise
    if n <= FEWEST or worst.max() < HEALTHY or not _exceeds(whole.sum(axis=1), noise).any():
        return
    step, odd = _step(seen, whole), _odd(seen, whole)
    if step is not None and (odd is None or step.left < odd.left):
        yield Finding(
            f"The gain of {model.channels[step.channel]} of {log.name} changes by "
            f"{_percent(step.gain - 1)} % from {_moment(log, step)} on",
            remedy="check its range, supply and mount; fit the runs before and after apart",
        )
    elif odd is not None and (text := _said(odd, model)):
        yield run_finding(log, [odd.run], text, holdout, refuse=False)


def _exceeds(chi_square: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return whether chi-squares are beyond what is expected of noise."""
    return np.asarray(chi_square > noise + CERTAIN * np.sqrt(2 * noise))


@dataclass(frozen=True, eq=False)
class Odd:
    """The run that the others contradict: gain of each channel there over theirs (K,), standard uncertainty.

    `excess`: mean square of its residuals over noise, from the others' coefficients. `left`: what the others
    leave beyond noise, over what the run does.
    """

    run: int
    gains: np.ndarray
    std: np.ndarray
    excess: float
    left: float


def _odd(seen: Products, whole: np.ndarray) -> Odd | None:
    """Return the run that the others contradict, if they agree without it."""
    noise = seen.counts * len(seen.variance)
    tried = np.argsort(-whole.sum(axis=1) / noise)[:TRIED]
    weights = np.ones((len(tried), len(noise)))
    weights[np.arange(len(tried)), tried] = 0.0
    without = seen.coefficients(weights)
    chi = seen.chi_squares(without).sum(axis=2)
    rest = (chi - noise) @ np.ones(len(noise)) - (chi - noise)[np.arange(len(tried)), tried]
    m = int(rest.argmin())
    r, C = int(tried[m]), without[m]
    excess = chi[m, r] - noise[r]
    left = float(max(rest[m] - SCATTER * np.sqrt(2 * noise.sum()), 0.0) / excess)
    own = seen.coefficients(1.0 - weights[m : m + 1])
    alone = seen.chi_squares(own)[0, r].sum() - noise[r]
    if left > ALONE or not _exceeds(chi[m, r], noise[r]) or alone > OWN * excess:
        return None
    # the noise of references adds to what they predict, and to nothing that is read
    predicted = np.einsum("fk,fk->k", C, seen.features[r] @ C) - seen.counts[r] * seen.of_references
    heard = predicted > LOUD * seen.counts[r] * seen.variance
    size = np.where(heard, predicted, 1.0)
    gains = np.where(heard, np.einsum("fk,fk->k", C, seen.readings[r]) / size, 1.0)
    std = np.where(heard, np.sqrt(seen.variance / size), np.inf)
    return Odd(seen.runs[r], gains, std, float(chi[m, r] / noise[r]), left)


def _said(odd: Odd, model: Model) -> str:
    """Return what is odd about a run: one gain, all gains, or something else; "" where it is no matter."""
    off, heard = odd.gains - 1, np.isfinite(odd.std)
    clear = heard & (
        np.abs(off) > np.maximum(CERTAIN * odd.std, ODD_SHARE * np.abs(off[heard]).max(initial=0.0))
    )
    names = [c for c, here in zip(model.channels, clear, strict=True) if here]
    if not names:
        if odd.excess < CLEARLY:
            return ""
        return (
            f"the readings contradict the model by {np.sqrt(odd.excess):.2g} times the noise: references or "
            f"{listed(model.state) if model.state else 'readings'} of another run"
        )
    changes = listed([f"{_percent(v)} %" for v, here in zip(off, clear, strict=True) if here])
    if len(names) == 1 and heard.sum() > 1:
        return f"the gain of {names[0]} differs by {changes}: its range, its supply, or another mount"
    state = f"{listed(model.state)} of another run, or " if model.state else ""
    many = "s" if len(names) > 1 else ""
    verb = "differ" if many else "differs"
    return f"the gain{many} of {listed(names)} {verb} by {changes}: {state}another machine or mount"


@dataclass(frozen=True, eq=False)
class Step:
    """A channel whose gain is `gain` times the former from `run` on; `left`: share of the excess left."""

    channel: int
    run: int
    gain: float
    left: float
    part: float = 1.0
    """Share of the run that has the new gain."""


def _moment(log: Any, step: Step) -> str:
    """Return run and time of a step; within a run, the time that its mean gain suggests."""
    if "t_s" not in log.columns:
        return f"run {step.run}"
    t = log.run(step.run, ("t_s",))["t_s"]
    at = t[min(int((1 - step.part) * len(t)), len(t) - 1)]
    about = "about " if step.part < 1 else ""
    return f"run {step.run} ({about}{at:.4g} s)"


def _step(seen: Products, whole: np.ndarray) -> Step | None:
    """Return the channel whose gain steps with a run, if nothing but a step explains its excess."""
    n, over = len(seen.runs), whole.sum(axis=0) - seen.counts.sum()
    k, ones, ramp = int(over.argmax()), np.ones(n), np.linspace(0.0, 1.0, n)
    gained, size = _explained(seen, ones, _after, k)
    drifting, _ = _explained(seen, ones, lambda v, power: np.tensordot(ramp**power, v, axes=1)[None], k)
    s = int(gained.argmax())
    left, smooth = ((over[k] - g) / over[k] for g in (gained[s], drifting[0]))
    found = Step(k, seen.runs[s + 1], 1 + size[s], left)
    for r in (s, s + 1):  # the step may fall into a run: it is left out, and what it leaves is forgiven
        if left > ALONE and 0 < r < n - 1:
            weights = np.where(np.arange(n) == r, 0.0, 1.0)
            C = seen.coefficients(weights[None])
            chi = float(weights @ seen.chi_squares(C)[0, :, k] - weights @ seen.counts)
            more, by = _explained(seen, weights, _since(r + 1), k)
            if chi > 0 and (rest := (chi - more[0]) / over[k]) < found.left:
                part = float(np.clip((_gain(seen, C[0], r, k) - 1) / by[0], 0.0, 1.0)) if by[0] else 1.0
                found = Step(k, seen.runs[r], 1 + by[0], rest, part)
    others = (over.sum() - over[k]) / over.sum()
    clear = found.left < ALONE and left < PARTLY and smooth > 2 * max(left, ALONE) and others < PARTLY
    return found if clear and abs(found.gain - 1) > SLIP else None


def _gain(seen: Products, C: np.ndarray, r: int, k: int) -> float:
    """Return the gain of a channel in one run over that of coefficients (f, K)."""
    return float(C[:, k] @ seen.readings[r, :, k] / max(C[:, k] @ seen.features[r] @ C[:, k], 1e-300))


def _since(run: int) -> Sums:
    """Return what sums the runs from one on."""
    return lambda values, power: values[run:].sum(axis=0)[None]


def _after(values: np.ndarray, power: int) -> np.ndarray:
    """Return the sums of what comes after each run but the last, (runs, ...) -> (runs - 1, ...)."""
    return np.asarray(np.cumsum(values[:0:-1], axis=0)[::-1])


def _explained(seen: Products, weights: np.ndarray, total: Sums, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Return by how much gains of channel k that follow a shape lower chi-square, and their size, (m,) each.

    `total(values, power)`: sums of values over runs, weighted by each of m shapes to that power.
    """
    C = seen.coefficients(weights[None])[0][:, k]
    square = np.tensordot(weights, seen.features, axes=1)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(square), 1e-300))
    outer = np.outer(scale, scale)
    inverse = np.linalg.pinv(square * outer, rcond=1e-10, hermitian=True) * outer
    predicted = weights[:, None] * (seen.features @ C)
    right = total((weights[:, None] * seen.readings[:, :, k] - predicted) @ C, 1)
    cross, own = total(predicted, 1), total(predicted @ C, 2)
    free = own - np.einsum("sf,fg,sg->s", cross, inverse, cross)
    size = np.where(free > SINGULAR * own, right / np.where(free > SINGULAR * own, free, 1.0), 0.0)
    return size * right / seen.variance[k], size


def _percent(share: float) -> str:
    """Return a change to two digits.

    >>> _percent(-2.0), _percent(0.095), _percent(1.0 / 3)
    ('-200', '+9.5', '+33')
    """
    return f"{float(f'{100 * share:.2g}'):+.6g}"
