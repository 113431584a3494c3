"""Which channel is which: order and signs of the readings against the layout of the probes."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import scipy

from hallsym.errors import InputError
from hallsym.estimation.likelihood import Cost
from hallsym.estimation.start import LinearFit
from hallsym.log import Log, Noise
from hallsym.log.phase import continuous
from hallsym.log.table import TableLike, View
from hallsym.model import Model

MISWIRED = 0.5
"""Distance between wirings, in sines of angles, that cannot be misalignment."""

Wiring = tuple[tuple[str, int], ...]
"""For each nominal channel: the channel that carries it and its sign."""


class _Rewired(View):
    """The table of a log whose channels are taken from other channels, with a sign."""

    def __init__(self, table: TableLike, sources: dict[str, tuple[str, int]]) -> None:
        super().__init__(table)
        self.sources = sources

    def counts_per_turn(self, column: str) -> float | None:
        """Return the counts of a turn of the column's source; None of an inverted one, which is below 0."""
        source, sign = self.sources.get(column, (column, 1))
        return self.table.counts_per_turn(source) if sign > 0 else None

    def pieces(self, columns: Sequence[str], size: int) -> Iterator[dict[str, np.ndarray]]:
        wanted = tuple(dict.fromkeys(self.sources.get(c, (c, 1))[0] for c in columns))
        for piece in self.table.pieces(wanted, size):
            yield {c: self._taken(piece, c) for c in columns}

    def _taken(self, piece: dict[str, np.ndarray], column: str) -> np.ndarray:
        source, sign = self.sources.get(column, (column, 1))
        return piece[source] if sign > 0 else -piece[source]


def rewired(log: Log, channels: Sequence[str], wiring: Wiring | None) -> Log:
    """Return the log with `channels[k]` read from `wiring[k]`: another channel, perhaps inverted."""
    if wiring is None:
        return log
    sources = dict(zip(channels, wiring, strict=True))
    sigmas = dict(log.noise.sigmas)
    sigmas |= {c: log.noise.sigmas[s] for c, (s, _) in sources.items() if s in log.noise.sigmas}
    return replace(log, table=_Rewired(log.table, sources), noise=Noise(sigmas))


def composed(first: Wiring | None, then: Wiring | None, channels: Sequence[str]) -> Wiring | None:
    """Return the wiring of a log that was wired as `first` and, on that, as `then`."""
    if first is None or then is None:
        return first or then
    at = {c: first[k] for k, c in enumerate(channels)}
    return tuple((at[source][0], sign * at[source][1]) for source, sign in then)


def as_read(log: Log, model: Model, wiring: Wiring | None = None) -> Log:
    """Return the log as `model` reads it: wired as a fit found it, columns that repeat made continuous."""
    return continuous(rewired(log, model.channels, wiring), model)


def find_wiring(cost: Cost, linear: LinearFit) -> tuple[Wiring, float]:
    """Return which channel and sign fits each nominal channel best, and by how much it beats the identity.

    Compares each channel's response to the axes that moved, freed of its gain, with the nominal one.
    """
    features, model = cost.summary.features, cost.summary.model
    index = [j for j in range(features.size) if features.label(j) in model.pose and linear.moved[j]]
    nominal = cost.coefficients.first(model.nominal)[0][0]
    weight = 1.0 / np.maximum(np.abs(nominal[index]).max(axis=1, keepdims=True), 1e-12)
    expected = _directions(nominal[index] * weight)
    found = _directions(linear.coefficients[index] * weight)
    distance = np.linalg.norm(
        expected[:, :, None, None] - found[:, None, :, None] * np.array([1.0, -1.0]), axis=0
    )
    rows, columns = scipy.optimize.linear_sum_assignment(distance.min(axis=2))
    signs = np.where(distance[rows, columns].argmin(axis=1) == 0, 1, -1)
    best = distance.min(axis=2)[rows, columns].sum()
    k = np.arange(len(model.channels))
    wiring = tuple((model.channels[c], int(s)) for c, s in zip(columns, signs, strict=True))
    return wiring, float(distance[k, k, 0].sum() - best)


def check_wiring(cost: Cost, linear: LinearFit, where: str) -> None:
    """Raise `InputError` when channels look exchanged or inverted."""
    wiring, gain = find_wiring(cost, linear)
    if gain < MISWIRED:
        return
    channels = cost.summary.model.channels
    swapped = [c for c, (source, _) in zip(channels, wiring, strict=True) if source != c]
    flipped = [source for source, sign in wiring if sign < 0]
    what = []
    if swapped:
        what.append(f"channels {' and '.join(swapped)} look swapped")
    if flipped:
        what.append(f"the sign of {' and '.join(flipped)} looks inverted")
    raise InputError(
        f"In {where} {' and '.join(what)} against the layout of {cost.summary.model.name}; check the wiring, "
        "give the machine's probes in meta.json, or let the fit resolve it with --resolve-wiring."
    )


def _directions(slopes: np.ndarray) -> np.ndarray:
    return slopes / np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)
