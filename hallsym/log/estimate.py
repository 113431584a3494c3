"""Noise from the log itself: the part that smooth motion does not explain."""

from __future__ import annotations

from collections.abc import Sequence
from math import comb

import numpy as np

from hallsym.errors import InputError
from hallsym.log.columns import RUN
from hallsym.log.core import Log
from hallsym.log.meta import Noise, Sigma
from hallsym.log.phase import unwrapped
from hallsym.model.arrays import median, medians, medians_of, middles
from hallsym.units import Array, si_unit

_ORDERS = range(2, 9)
_SAMPLES = 1024  # taken from the middle of each block of a run
_ENOUGH = 4  # blocks over all runs: 4096 samples know a standard deviation to 1.2 %
_RUNS = 128  # at most, spread over the log
_FEWEST = 8  # differences that an order needs in a run
_CLIP = 2.5
_CLIPPED_STD = 0.95460  # standard deviation of a unit normal cut off at +-2.5
_ROUNDS = 8
_UNEVEN = 0.01  # relative deviation of a time step from the usual one
_GAP = 5.0  # usual steps
_SLACK = 1.03
_TURN = 2 * np.pi  # an angle that steps by more than half of it began another turn


def estimate_noise(log: Log, channels: Sequence[str]) -> Noise:
    """Estimate one standard deviation of white noise for each channel, in its SI unit.

    In each run, differences of order k = 2..8 remove motion that is a polynomial of degree k - 1 over k + 1
    samples; divided by sqrt(binom(2k, k)) they have the noise's spread. It is measured by the median absolute
    deviation and refined by clipping, so outliers do not count. The median over runs is taken for each order,
    then the lowest order within 3 % of the least: higher ones leave less motion and more scatter.
    Where samples are not evenly spaced the differences are divided ones; none spans a gap. Where the ADC
    step hides the noise, step / sqrt(12) is the least that is returned.
    Angles are unwrapped first: where one begins another turn it has not moved by one.
    Some 4096 samples are used, at most 1024 in a stretch, of runs spread over the log (at most 128).

    Valid for noise that is independent from sample to sample: drift, 1/f noise and hum below about a tenth of
    the sampling rate look like motion and are not seen. A channel that is constant within all runs gives 0.
    """
    timed = "t_s" in log.columns
    typical = min(_SAMPLES, max(1, log.rows // len(log.runs)))
    wanted = min(_RUNS, -(-_ENOUGH * _SAMPLES // typical))
    chosen = set(log.runs[:: -(-len(log.runs) // wanted)])
    most = max(1, _ENOUGH // len(chosen))
    taken: dict[int, int] = {}
    by_length: dict[int, list[list[Array]]] = {}  # time and channels of stretches of one length
    for block in log.blocks((RUN, *(("t_s",) if timed else ()), *channels)):
        taken[block.run] = taken.get(block.run, 0) + 1
        if block.run not in chosen or taken[block.run] > most:
            continue
        length = len(block.data[RUN])
        start = max(0, (length - _SAMPLES) // 2)
        t = block.data["t_s"] if timed else np.arange(length, dtype=float)
        part = [values[start : start + _SAMPLES] for values in (t, *(block.data[c] for c in channels))]
        by_length.setdefault(len(part[0]), []).append(part)
    steps, spreads = [np.empty((0, len(channels)))], [np.empty((0, len(channels), len(_ORDERS)))]
    for blocks in by_length.values():
        times, rows = np.array([part[0] for part in blocks]), np.array([part[1:] for part in blocks])
        rows = rows.reshape(len(blocks), len(channels), -1)
        periodic = np.array([si_unit(name) == "rad" for name in channels])
        turns = periodic & (np.abs(np.diff(rows, axis=2)) > _TURN / 2).any(axis=2)
        for b, k in np.argwhere(turns):
            rows[b, k] = unwrapped(rows[b, k], _TURN)
        steps.append(_coarse_steps(rows.reshape(-1, rows.shape[2])).reshape(len(blocks), -1))
        even = _are_even(times)
        if even.any():
            stacked = _by_order(rows[even].reshape(-1, rows.shape[2]))
            spreads.append(stacked.reshape(-1, len(channels), len(_ORDERS)))
        spreads += [_by_order(rows[b], times[b])[None] for b in np.flatnonzero(~even)]
    combined = _combined(np.concatenate(spreads))
    for name in (n for n, spread in zip(channels, combined, strict=True) if np.isnan(spread)):
        raise InputError(
            f"Noise of {name} cannot be estimated from {log.name}: no run has {_FEWEST + 2} samples in a row;"
            f" state it with --noise {name}=..., in the column file's [noise] table or in meta.json."
        )
    coarse = medians(np.concatenate(steps).T) / np.sqrt(12.0)
    return Noise({
        n: Sigma(float(value), "estimated")
        for n, value in zip(channels, np.maximum(combined, coarse), strict=True)
    })  # fmt: skip


def _are_even(times: Array) -> Array:
    """Return whether the samples of stretches (blocks, n) are evenly spaced, (blocks,)."""
    step = np.diff(times, axis=1)
    if not step.shape[1]:
        return np.zeros(len(times), bool)
    usual = step.mean(axis=1)
    return np.asarray((usual > 0) & (np.abs(step - usual[:, None]).max(axis=1) <= _UNEVEN * usual))


def _by_order(rows: Array, t: Array | None = None) -> Array:
    """Return the spread of the differences of rows (c, n), (c, orders); `t`: (n,) times of uneven samples."""
    origin, found = rows - rows[:, :1], []
    difference = np.diff(origin, axis=1)
    for k in _ORDERS:
        difference = np.diff(difference, axis=1)
        of_noise = difference / np.sqrt(comb(2 * k, k)) if t is None else _divided(origin, t, k)
        found.append(_spreads(of_noise))
    return np.transpose(found)


def _divided(rows: Array, t: Array, k: int) -> Array:
    """Return divided differences of rows (c, n) at times t (n,), of unit norm, where none spans a gap.

    1 / prod(t_j - t_m) annihilates polynomials of degree k - 1 on any spacing.
    """
    step = np.diff(t)
    usual = median(step) if len(step) else 0.0
    if len(t) <= k or usual <= 0:
        return np.empty((len(rows), 0))
    view = np.lib.stride_tricks.sliding_window_view
    usable = view((step > 0) & (step < _GAP * usual), k).all(axis=1)
    windows = view(t / usual, k + 1)[usable]
    weights = 1.0 / (windows[:, :, None] - windows[:, None, :] + np.eye(k + 1)).prod(axis=2)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    return np.asarray(np.einsum("cij,ij->ci", view(rows, k + 1, axis=1)[:, usable], weights))


def _spreads(differences: Array) -> Array:
    """Return the standard deviation of each row (rows, n) without its outliers; nan where n is too small."""
    size = np.abs(differences)
    if size.shape[1] < _FEWEST:
        return np.full(len(size), np.nan)
    most = size.max(axis=1)
    if not np.isfinite(most).all():
        return np.array([_spreads(row[np.isfinite(row)][None])[0] for row in differences])
    ordered = np.sort(size, axis=1)
    sigma = middles(ordered) / 0.67449
    coarse = sigma <= 1e-9 * most  # more than half are zero to rounding: the ADC step hides the noise
    sigma[coarse] = np.sqrt(np.mean(size[coarse] ** 2, axis=1))
    sums, left = np.cumsum(np.square(ordered), axis=1), np.flatnonzero(~coarse)
    for _ in range(_ROUNDS):
        if not len(left):
            break
        before = sigma[left]
        within = np.count_nonzero(ordered[left] <= _CLIP * before[:, None], axis=1)
        sigma[left] = np.sqrt(sums[left, within - 1] / within) / _CLIPPED_STD
        left = left[np.abs(sigma[left] - before) > 3e-3 * before]
    return np.asarray(sigma)


def _coarse_steps(rows: Array) -> Array:
    """Return the ADC step of each row (c, n) where readings repeat so often that it matters, else 0; (c,)."""
    step = np.abs(np.diff(rows, axis=1))
    changes = np.count_nonzero(step > 0, axis=1)
    coarse = (changes > 0) & (changes < 0.8 * step.shape[1])
    return np.where(coarse, np.where(step > 0, step, np.inf).min(axis=1, initial=np.inf), 0.0)


def _combined(spreads: Array) -> Array:
    """Return the noise of each channel from spreads (blocks, channels, orders); nan where all are nan."""
    known = ~np.isnan(spreads)
    by_order = np.where(known.any(axis=0), medians_of(spreads, known), np.nan)
    least = np.where(np.isnan(by_order), np.inf, by_order).min(axis=1)
    chosen = np.argmax(by_order <= _SLACK * least[:, None], axis=1)  # the first that holds
    return np.where(np.isfinite(least), by_order[np.arange(len(chosen)), chosen], np.nan)
