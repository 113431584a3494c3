"""The recording that would separate confusable effects, simulated from the members' own fitted models.

Of every pair of a group, one member generates the readings of each possible recording, without noise; the
other is fitted to these and to the log at once. The whitened residual of that fit is how far the recording
tells the two apart.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from hallsym.diagnosis.base import Base
from hallsym.diagnosis.normal_equations import normal_equations
from hallsym.diagnosis.policy import POLICY, Policy
from hallsym.diagnosis.record import Separation
from hallsym.diagnosis.recordings import BETWEEN, Range, Recording, range_of, recordings
from hallsym.diagnosis.refit import Refitted, inverse
from hallsym.errors import InputError
from hallsym.estimation.decoding import columns_of
from hallsym.log import Log
from hallsym.log.derived import extended
from hallsym.model.arrays import on_arrays


def separation(
    names: Sequence[str],
    fits: Sequence[Refitted],
    distance: float,
    variance: float,
    advice: str,
    policy: Policy = POLICY,
) -> Separation:
    """Return the recording that would separate the members of a group.

    `fits`: the members, each fitted on the log. `distance`: whitened squared distance between what they leave
    on it. `variance`: of a slow average of the whitened residual (noise times inflation), by which squared
    distances are divided to count in sigma. `advice`: of the catalogue, for effects that cannot be simulated
    or are not separated by any of the recordings. Of the recordings that separate nearly as well as the best
    one, the plainest is proposed.
    """
    needed = policy.separated**2 * variance
    plain = Separation(
        group=tuple(names),
        recording=advice,
        distance=distance,
        needed=needed,
        factor=float((needed / max(distance, 1e-12)) ** 0.5),
        sigma_now=float((distance / variance) ** 0.5),
    )
    if not fits[0].base.timed:
        return plain  # no clock, no motion to propose
    try:
        tried, squared = simulated(fits)
    except (InputError, KeyError, ValueError, np.linalg.LinAlgError):
        return plain
    sigma = np.sqrt(squared / variance)
    plain = replace(plain, tried={r.text: float(s) for r, s in zip(tried, sigma, strict=True)})
    best = int(np.argmax(sigma >= policy.nearly_best * sigma.max()))
    gain = float(squared[best])
    runs = max(int(np.ceil(max(needed - distance, 0.0) / gain)), 1) if gain > 0 else policy.most_runs + 1
    if runs > policy.most_runs:
        return plain
    each = tried[best].run.duration_s
    return replace(
        plain,
        recording=tried[best].text,
        simulated=True,
        sigma=float(sigma[best]),
        run_s=each,
        runs=runs,
        seconds=runs * each,
    )


def simulated(fits: Sequence[Refitted]) -> tuple[list[Recording], np.ndarray]:
    """Return recordings, and the whitened squared distance that a run of each adds for the closest pair."""
    span = range_of(fits[0].base)
    tried = recordings(span)
    least = np.full(len(tried), np.inf)
    for a, b in combinations(fits, 2):
        one = _told(span, tried, a, b)
        other = _told(span, tried, b, a)
        least = np.minimum(least, np.minimum(one, other))
    return tried, least


def _told(span: Range, tried: Sequence[Recording], a: Refitted, b: Refitted) -> np.ndarray:
    """Return the squared distance of b from the readings of a, b refitted to the log and the run at once."""
    log = recorded(span, tried, a.base)
    n = len(b.base.free)
    known = b.tangents.likelihood[b.fitted].sum(axis=0)[:n, :n]
    zeros = np.zeros(len(b.base.model.zeros))
    there = replace(b.base, log=log, zeros=dict.fromkeys(log.runs, zeros), keep=None, apart=frozenset())
    M = normal_equations(there, {}).likelihood[1:]
    out = []
    for run in M:
        both = inverse(known + run[:n, :n])
        out.append(max(float(run[n, n] - run[:n, n] @ both @ run[:n, n]), 0.0))
    return np.array(out)


def recorded(span: Range, tried: Sequence[Recording], base: Base) -> Log:
    """Return the log of what `base` reads in each recording, without noise.

    The clock goes on where the log ended: a stub at its start keeps the origin of campaign time.
    """
    columns: dict[str, list[np.ndarray]] = {}
    start = span.end_s + BETWEEN
    stub = replace(tried[0].run, duration_s=span.step_s * 32)
    for number, (run, begin, warm) in enumerate(
        [(stub, span.start_s, None), *((r.run, 0.0, r.temperature) for r in tried)]
    ):
        begin = begin if number == 0 else start  # each could be the next one
        t = np.arange(max(32, round(run.duration_s / span.step_s))) * span.step_s
        here = {c: run.position(c, t) for c in (*base.model.pose, *span.vertical)}
        _append(columns, base, span, number, begin + t, here, warm(t) if warm else None)
    plain = {c: np.concatenate(v) for c, v in columns.items()}
    return with_readings(plain, base)


def _append(
    columns: dict[str, list[np.ndarray]],
    base: Base,
    span: Range,
    number: int,
    t: np.ndarray,
    here: Mapping[str, np.ndarray],
    warm: np.ndarray | None,
) -> None:
    model = base.model
    row = dict(zip(model.references, (here[c] for c in model.pose), strict=True))
    row |= {c: here[c] for c in span.vertical} | {"run": np.full(len(t), number), "t_s": t}
    if span.temperature is not None:
        row["temperature_degc"] = np.full(len(t), span.temperature) if warm is None else warm
    for c, values in row.items():
        columns.setdefault(c, []).append(values)


def with_readings(columns: dict[str, np.ndarray], base: Base) -> Log:
    """Add the readings that the model of `base` gives; columns that it computes come from the motion."""
    model = base.model
    blank = np.zeros(len(columns["run"]))
    bare = Log.from_arrays({**columns, **dict.fromkeys(model.channels, blank)}, noise=base.log.noise)
    read, zeros = on_arrays(model.reading), np.zeros(len(model.zeros))
    parts: list[np.ndarray] = []
    for block in extended(bare, model, base.sigma, base.values).blocks(columns_of(model)):
        pose, state = ([block.data[c] for c in names] for names in (model.references, model.state))
        (reading,) = read(base.p, zeros, pose, state)
        parts.append(np.broadcast_to(reading, (len(model.channels), len(pose[0]))))
    readings = np.hstack(parts)
    return Log.from_arrays(
        {**columns, **dict(zip(model.channels, readings, strict=True))}, noise=base.log.noise
    )
