"""The error of a periodic coordinate by waves per period: as designed, with the model, with its effects.

What makes 1, 2 or 4 waves per turn is the first question of anybody who mounts a sensor, and the model's
own offsets, amplitudes and phase absorb most of it before a diagnosis asks what is left.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hallsym.diagnosis.base import Base
from hallsym.diagnosis.decoded_errors import errors_of
from hallsym.diagnosis.record import Waves
from hallsym.estimation.decoding import columns_of
from hallsym.log.batches import batches
from hallsym.log.derived import extended
from hallsym.log.phase import designed

FIRST = 12
"""Waves per period up to which all are looked at, beside those that an effect is known by."""
SHOWN = 0.03
"""Part of the largest amplitude of a coordinate from which on a wave is shown."""
PER_WAVE = 2
"""Samples per wave that are needed at least."""
COVERED = 0.01
"""Least eigenvalue of the mean products of 1 and the first `LONG` waves where a log covers the period."""
LONG = 3


def waves(model: Base, after: Base | None) -> tuple[Waves, ...]:
    """Return the waves of the error of each periodic coordinate; none for a pose that has no such coordinate.

    `model`, `after`: without and with what was found.
    """
    pose, known = model.model.pose, model.model.family.waves
    plain = replace(model, p=designed(model.model, model.p))
    bases = [base for base in (plain, model, after) if base is not None]
    orders = [n for n in sorted({*range(1, FIRST + 1), *known}) if PER_WAVE * n <= model.log.rows]
    periodic = [k for k, c in enumerate(pose) if c in model.model.period]
    sizes = [_amplitudes(base, periodic, orders) for base in bases] if periodic else []
    out = []
    for j, k in enumerate(periodic):
        largest = max(float(s[j].max(initial=0.0)) for s in sizes)
        for n, amplitudes in zip(orders, np.array([s[j] for s in sizes]).T.tolist(), strict=True):
            if max(amplitudes) >= SHOWN * largest > 0:
                own, left, *rest = amplitudes
                name = pose[k] if len(pose) > 1 else ""
                out.append(Waves(n, own, left, rest[0] if rest else None, known.get(n, ()), name))
    return tuple(out)


def _amplitudes(base: Base, periodic: Sequence[int], orders: Sequence[int]) -> np.ndarray:
    """Amplitudes of waves of the decoded error of each periodic coordinate over its own period, SI.

    Shape (periodic, orders); fitted together, over all samples of the log. 0 where the log does not cover the
    period.
    """
    model, decode = base.model, errors_of(base)
    columns = [model.references[k] for k in periodic]
    size = 1 + 2 * len(orders)
    M, b = np.zeros((len(columns), size, size)), np.zeros((len(columns), size))
    for batch in batches(extended(base.log, model, base.sigma, base.values), columns_of(model)):
        weights = batch.weights(base.keep)
        for block, at in batch.parts():
            errors = decode(block)
            for j, (k, c) in enumerate(zip(periodic, columns, strict=True)):
                turn = np.outer(orders, 2 * np.pi / model.period[c] * block.data[c])
                x = np.vstack([np.ones(turn.shape[1]), np.cos(turn), np.sin(turn)])
                wx = x if weights is None else x * weights[at]
                M[j] += wx @ x.T
                b[j] += wx @ errors[k]
    out = np.zeros((len(columns), len(orders)))
    for j in range(len(columns)):
        long = [0, *(1 + n + k * len(orders) for k in (0, 1) for n in range(min(LONG, len(orders))))]
        if np.linalg.eigvalsh(M[j][np.ix_(long, long)])[0] > COVERED * M[j, 0, 0]:
            out[j] = np.hypot(*np.linalg.lstsq(M[j], b[j], rcond=1e-9)[0][1:].reshape(2, -1))
    return out
