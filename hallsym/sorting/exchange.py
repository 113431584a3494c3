"""Choose sets of sensors whose gains make the least error: neighbours in gain, then exchanges.

The error of a set with gains d (k,) is d' Q d. Where Q treats all places alike, it is the variance within the
set, and sets of neighbours are optimal: two sets that overlap lose by being put apart. Of all such stretches
those of least cost are chosen. Any other Q starts there; sensors then change places within a set and between
sets as long as the error falls.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np

from hallsym.units import Array

SWEEPS, REST = 4000, 200
"""Most sweeps of exchanges, and sweeps in which the error must fall by `GAINED` for them to go on."""
GAINED = 1e-3
FELT, TINY = 0.01, 1e-6
"""Part of a set's error, and of the mean one at first, by which a swap of two places must lower it."""
MOST_ORDERS = 720
"""Most orders of a set that are tried one by one (six places); longer sets are arranged by exchanges."""
STEPS = 60
"""Bisections of the price of a set."""


def cost(d: Array, square: Array) -> Array:
    """Return d' Q d of sets with gains d (m, k), (m,)."""
    return np.einsum("mi,ij,mj->m", d, square, d)


def neighbours(gain: Array, size: int, sets: int) -> Array:
    """Return indices (sets, size) of disjoint stretches of the sorted gains with least variance in all."""
    order = np.argsort(gain, kind="stable")
    g = gain[order] - gain.mean()
    sums, squares = (np.r_[0.0, np.cumsum(x)] for x in (g, g * g))
    inside = squares[size:] - squares[:-size] - (sums[size:] - sums[:-size]) ** 2 / size
    inside = np.maximum(inside, 0.0)
    starts = _stretches(inside, size, sets)
    return order[starts[:, None] + np.arange(size)]


def _stretches(inside: Array, size: int, sets: int) -> Array:
    """Starts of `sets` disjoint stretches of least total: a price for each set, found by bisection."""
    low, high = -1.0, float(inside.max()) * (size + 1) * max(sets, 1) + 1.0
    best: Array | None = None
    for _ in range(STEPS):
        price = (low + high) / 2
        starts = _cheapest(inside, size, price)
        if len(starts) >= sets:
            high, best = price, starts
        else:
            low = price
        if len(starts) == sets:
            break
    if best is None or len(best) < sets:
        best = np.arange(sets) * size
    return best[np.sort(np.argsort(inside[best], kind="stable")[:sets])]


def _cheapest(inside: Array, size: int, price: float) -> Array:
    """Starts of the disjoint stretches of least cost, each paid `price`; of equal ones the more."""
    last = len(inside) + size - 1
    worth = (inside - price).tolist()
    total, taken = [0.0] * (last + 1), [False] * (last + 1)
    for end in range(1, last + 1):
        total[end] = total[end - 1]
        if end >= size:
            with_it = total[end - size] + worth[end - size]
            if with_it < total[end] or (with_it == total[end] and end % size == 0):
                total[end], taken[end] = with_it, True
    starts, end = [], last
    while end > 0:
        if taken[end]:
            starts.append(end - size)
            end -= size
        else:
            end -= 1
    return np.array(starts[::-1], int)


def arranged(index: Array, gain: Array, square: Array) -> Array:
    """Return the sets (m, k) with their sensors in the best order of places, or in one no swap improves."""
    size = index.shape[1]
    orders = list(permutations(range(size))) if size <= 6 else []
    if orders and len(orders) <= MOST_ORDERS:
        d = gain[index]
        costs = np.stack([cost(d[:, order], square) for order in orders])
        return np.take_along_axis(index, np.array(orders)[costs.argmin(axis=0)], axis=1)
    index = index.copy()
    least = TINY * float(cost(gain[index], square).mean())
    for _ in range(SWEEPS):
        d = gain[index]
        gap, force = d[:, None, :] - d[:, :, None], d @ square
        own = np.diag(square)
        change = 2 * gap * (force[:, :, None] - force[:, None, :]) + gap**2 * (
            own[:, None] + own - 2 * square
        )
        flat = change.reshape(len(d), -1)
        best = flat.argmin(axis=1)
        better = np.flatnonzero(flat[np.arange(len(d)), best] < -np.maximum(FELT * cost(d, square), least))
        if not len(better):
            break
        i, j = np.divmod(best[better], size)
        index[better, i], index[better, j] = index[better, j], index[better, i]
    return index


def exchanged(
    index: Array, gain: Array, square: Array, rng: np.random.Generator, enough: float = 0.0
) -> Array:
    """Return the sets after exchanges between them, and with unused sensors, while their error falls.

    `enough`: the mean of d' Q d below which less is not felt.
    """
    index = arranged(index, gain, square)
    spare = np.setdiff1d(np.arange(len(gain)), index)
    before = float(cost(gain[index], square).sum())
    least = max(TINY * before, enough * len(index))
    for sweep in range(1, (SWEEPS if before > least else 0) + 1):
        _between(index, gain, square, rng, sweep)
        _replaced(index, spare, gain, square, rng)
        if sweep % REST == 0:
            index = arranged(index, gain, square)
            now = float(cost(gain[index], square).sum())
            if now >= (1 - GAINED) * before or now <= least:
                break
            before = now
    return index


def _between(index: Array, gain: Array, square: Array, rng: np.random.Generator, sweep: int) -> None:
    """Pair the sets, at random or as neighbours in gain, and make the best exchange of each pair."""
    sets = len(index)
    if sets < 2:
        return
    order = (
        rng.permutation(sets) if sweep % 2 else np.roll(np.argsort(gain[index].mean(axis=1)), sweep // 2 % 2)
    )
    a, b = order[: sets // 2 * 2 : 2], order[1 : sets // 2 * 2 : 2]
    da, db, own = gain[index[a]], gain[index[b]], np.diag(square)
    fa, fb = da @ square, db @ square
    gap = db[:, None, :] - da[:, :, None]
    change = 2 * gap * (fa[:, :, None] - fb[:, None, :]) + gap**2 * (own[:, None] + own)
    flat = change.reshape(len(a), -1)
    best = flat.argmin(axis=1)
    better = np.flatnonzero(flat[np.arange(len(a)), best] < 0)
    i, j = np.divmod(best[better], index.shape[1])
    a, b = a[better], b[better]
    index[a, i], index[b, j] = index[b, j], index[a, i]


def _replaced(index: Array, spare: Array, gain: Array, square: Array, rng: np.random.Generator) -> None:
    """Offer each set an unused sensor and take it where it lowers the error."""
    count = min(len(spare), len(index))
    if not count:
        return
    sets, offered = rng.permutation(len(index))[:count], rng.permutation(len(spare))[:count]
    d = gain[index[sets]]
    gap = gain[spare[offered]][:, None] - d
    change = 2 * gap * (d @ square) + gap**2 * np.diag(square)
    best = change.argmin(axis=1)
    better = np.flatnonzero(change[np.arange(count), best] < 0)
    i, sets, offered = best[better], sets[better], offered[better]
    index[sets, i], spare[offered] = spare[offered], index[sets, i]
