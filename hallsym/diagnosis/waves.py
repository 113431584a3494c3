"""The error of an encoder by waves per turn: as designed, with the model, and with the effects found.

What makes 1, 2 or 4 waves a turn is the first question of anybody who mounts an encoder, and the model's own
offsets, amplitudes and phase take up most of it before a diagnosis asks what is left.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hallsym.diagnosis.base import Base
from hallsym.diagnosis.errors import errors_of
from hallsym.diagnosis.record import Waves
from hallsym.estimation.decoding import columns_of
from hallsym.log.batches import batches
from hallsym.log.derived import extended
from hallsym.log.phase import designed

FIRST = 12
"""Waves per turn up to which all are looked at, beside those that an effect is known by."""
SHOWN = 0.03
"""Part of the largest amplitude from which on a wave is shown."""
PER_WAVE = 2
"""Samples per wave that are needed at least."""


def waves(known: Mapping[int, tuple[str, ...]], model: Base, after: Base | None) -> tuple[Waves, ...]:
    """Return what waves the error of an encoder has; none for a family whose pose does not turn.

    `known`: waves per turn -> effects that make them. `model`, `after`: without and with what was found.
    """
    if not known:
        return ()
    plain = replace(model, p=designed(model.model, model.p))
    orders = [n for n in sorted({*range(1, FIRST + 1), *known}) if PER_WAVE * n <= model.log.rows]
    sizes = [_amplitudes(base, orders) for base in (plain, model, after) if base is not None]
    largest = max(float(s.max(initial=0.0)) for s in sizes)
    out = []
    for k, n in enumerate(orders):
        own, left = float(sizes[0][k]), float(sizes[1][k])
        rest = float(sizes[2][k]) if after else None
        if max(own, left, rest or 0.0) >= SHOWN * largest > 0:
            out.append(Waves(n, own, left, rest, known.get(n, ())))
    return tuple(out)


def _amplitudes(base: Base, orders: Sequence[int]) -> np.ndarray:
    """Amplitudes of some waves of the decoded error [rad], fitted together, over all samples of the log."""
    model, decode = base.model, errors_of(base)
    (reference,) = model.references
    size = 1 + 2 * len(orders)
    M, b = np.zeros((size, size)), np.zeros(size)
    for batch in batches(extended(base.log, model, base.sigma, base.values), columns_of(model)):
        weights = batch.weights(base.keep)
        for block, at in batch.parts():
            turn = np.outer(orders, block.data[reference])
            x = np.vstack([np.ones(turn.shape[1]), np.cos(turn), np.sin(turn)])
            wx = x if weights is None else x * weights[at]
            M += wx @ x.T
            b += wx @ decode(block)[0]
    found = np.linalg.lstsq(M, b, rcond=1e-9)[0]
    return np.asarray(np.hypot(*found[1:].reshape(2, -1)))
