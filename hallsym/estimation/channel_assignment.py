"""Which channel is which: order and signs of the readings against the layout of the probes."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from hallsym.estimation.likelihood import Cost
from hallsym.estimation.responses import responses_of
from hallsym.log import Log, Noise
from hallsym.log.phase import continuous
from hallsym.log.quality.explain import Explanation
from hallsym.log.quality.gains import judge_gains
from hallsym.log.table import TableLike, View
from hallsym.model import Model

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


def wiring_of(explanations: Sequence[Explanation]) -> Wiring | None:
    """Return the wiring that explains a log's slopes; None where only other columns or units explain them."""
    for found in explanations:
        if found.only_channels and all(c.factor == 1 for c in found.channels):
            return tuple((c.source, c.sign) for c in found.channels)
    return None


def find_wiring(log: Log, cost: Cost) -> Wiring | None:
    """Return which channel and sign each nominal channel is read from; None where they are in order."""
    seen = responses_of(cost)
    return None if seen is None else wiring_of(judge_gains(log, seen).whole)
