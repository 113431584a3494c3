"""A long log decimated: fewer samples of every run, as far as motion and mains stay resolved."""

import numpy as np

from hallsym.diagnosis.recordings import PER_PERIOD
from hallsym.diagnosis.residuals import Base
from hallsym.diagnosis.survey import SEGMENT
from hallsym.families.mechanisms import MAINS_HZ, MAINS_REACH_HZ
from hallsym.log import Log
from hallsym.log.quality.runs import FEWEST_SAMPLES


def thinned(base: Base, rows: int) -> tuple[Log, int]:
    """Return every m-th sample of each run of `base.log`, and m.

    They are about `rows`, or as many as motion and mains need.
    """
    every = _every(base, rows)
    return _kept(base, every, base.log.rows), every


def decimated(base: Base, rows: int) -> tuple[Log, str]:
    """Return about `rows` samples of `base.log`; those that the fit left out are left out here too.

    Samples are left out as far as motion and mains stay resolved, and then the ends of long runs. The text
    says what was left out, "" for nothing.
    """
    log, every = base.log, _every(base, rows)
    long = log.rows > rows * every
    most = max(rows * every // len(log.runs), SEGMENT * every) if long else log.rows
    said = [f"every {every}. sample"] if every > 1 else []
    if long:
        said.append(f"the first {most} samples of each run")
    return _kept(base, every, most), " of ".join(said)


def _kept(base: Base, every: int, most: int) -> Log:
    """Return every so many samples of the first `most` of each run that the fit has not left out."""
    log = base.log
    if every == 1 and most >= log.rows and base.keep is None:
        return log
    seen = dict.fromkeys(log.runs, 0)
    parts: dict[str, list[np.ndarray]] = {c: [] for c in log.columns}
    for block in log.blocks():
        n = len(block.data["t_s"])
        index = seen[block.run] + np.arange(n)
        seen[block.run] += n
        keep = (index % every == 0) & (index < most)
        if base.keep is not None:
            keep &= base.keep(block) > 0
        for column in log.columns:
            values = np.full(n, block.run) if column == "run" else block.data[column]
            parts[column].append(values[keep])
    columns = {c: np.concatenate(v) for c, v in parts.items()}
    return Log.from_arrays(columns, log.noise, log.meta, log.name)


def _every(base: Base, rows: int) -> int:
    """Return how many samples one stands for where `rows` are wanted."""
    known, every = 1, -(-base.log.rows // rows)
    beyond = every + 1
    while beyond - known > 1:
        known, beyond = (every, beyond) if _resolved(base, every) else (known, every)
        every = (known + beyond) // 2
    return known


def _resolved(base: Base, every: int) -> bool:
    """Return whether every so many samples show motion, turns of what turns, and mains.

    A sine of `PER_PERIOD` samples a period has second differences of (2 sin(pi / PER_PERIOD))^2 of itself;
    six times the variance of the noise is in them too.
    """
    model, step, count = base.model, list[float](), 0
    moved, bent, turned = np.zeros((3, len(model.pose)))
    period = np.array([model.period.get(c, np.inf) for c in model.pose])
    for block in base.log.blocks(("t_s", *model.references), 1 << 16):
        t, x = block.data["t_s"][::every], np.array([block.data[c] for c in model.references])
        if len(t) < FEWEST_SAMPLES:
            continue
        x = np.array([v if np.isinf(p) else np.unwrap(v, period=p) for v, p in zip(x, period, strict=True)])
        turned += (np.diff(x) ** 2).mean(axis=1) * len(t)  # at the full rate, where no turn is lost
        x = x[:, ::every]
        step.append(float(np.median(np.diff(t))))
        moved += x.var(axis=1) * len(t)
        bent += (np.diff(x, 2) ** 2).sum(axis=1) * len(t) / (len(t) - 2)
        count += len(t)
    if not count:
        return False
    noise = np.array([base.sigma.get(c, 0.0) ** 2 for c in model.references])
    weights = base.pose_weights**2
    most = (2 * np.sin(np.pi / PER_PERIOD)) ** 4
    return bool(
        weights @ (bent / count - 6 * noise) <= most * (weights @ (moved / count - noise).clip(0.0))
        and (every * np.sqrt((turned / count - 2 * noise).clip(0.0)) * PER_PERIOD <= period).all()
        and 2 * (MAINS_HZ[-1] + MAINS_REACH_HZ) * np.median(step) <= 1
    )
