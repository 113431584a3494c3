"""Whether several logs can be of one device: model, nominal values, device name, gains of their channels."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hallsym.errors import InputError
from hallsym.estimation.task import Begun
from hallsym.log import Log
from hallsym.log.quality.findings import name_of
from hallsym.model import Model
from hallsym.units import UNITS

LIKE_A_UNIT = 0.1
"""Relative distance of a ratio of gains from that of two units within which another unit is what it shows."""
LEAST_RATIO = 5.0
"""Ratio of gains below which two logs of one device may differ: a repair, an air gap, a temperature."""


def labels(logs: Sequence[Log]) -> tuple[str, ...]:
    """Return a short name of each log: that of its file or folder, else its place, 1 first; all different."""
    out: list[str] = []
    for k, log in enumerate(logs):
        path = log.path
        name = str(k + 1) if path is None else path.parent.name if path.stem == "log" else _stem(path)
        name = name.replace("[", "(").replace("]", ")") or str(k + 1)
        out.append(name if name not in out else f"{name} {k + 1}")
    return tuple(out)


def _stem(path: Path) -> str:
    return path.name.partition(".")[0]


def check_same(logs: Sequence[Log], models: Sequence[Model]) -> None:
    """Raise `InputError` where the models of two logs, or their devices by name, are not the same."""
    first, known = logs[0], models[0]
    for log, model in zip(logs[1:], models[1:], strict=True):
        both = f"{name_of(first)} and {name_of(log)}"
        if (model.name, model.effects, model.channels) != (known.name, known.effects, known.channels):
            raise InputError(
                f"{both} have different models, {known.name} ({', '.join(known.channels)}) and "
                f"{model.name} ({', '.join(model.channels)}); fit those of one device, or give --model."
            )
        if None not in (a := (first.meta.device, log.meta.device)) and a[0] != a[1]:
            raise InputError(
                f"{both} are of different devices, {a[0]!r} and {a[1]!r} by their meta.json; fit each by "
                "itself, or all with 'hallsym fleet'."
            )
        differ = [
            p.name for p, q in zip(known.parameters, model.parameters, strict=True)
            if (p.nominal, p.lower, p.upper) != (q.nominal, q.lower, q.upper)
        ]  # fmt: skip
        if differ or known.layout != model.layout:
            what = f"the nominal value or bounds of {differ[0]}" if differ else "the places of the probes"
            raise InputError(
                f"{both} state another machine: {what} differ in their meta.json; correct one, or give "
                "--machine, which holds for all."
            )


def check_gains(logs: Sequence[Log], model: Model, begun: Sequence[Begun]) -> None:
    """Raise `InputError` where a channel of one log is that of the first one in another unit."""
    for log, own in zip(logs[1:], begun[1:], strict=True):
        for channel, ratio in zip(model.channels, _ratios(own, begun[0]), strict=True):
            if (factor := unit_factor(float(ratio), channel)) is not None:
                raise InputError(
                    f"Units differ between files: {channel} of {name_of(log)} is {factor:.4g} times that of "
                    f"{name_of(logs[0])}, the ratio of two units; correct the unit with --column, or fit "
                    "each log by itself."
                )


def unit_factor(ratio: float, column: str) -> float | None:
    """Return the ratio of two units of the column's kind that a ratio of gains is; None for no such ratio.

    >>> unit_factor(998.0, "v_sin_v")
    1000.0
    """
    if not ratio > 0 or 1 / LEAST_RATIO < ratio < LEAST_RATIO:
        return None
    own = column.rpartition("_")[2]
    scales = {unit.factor for unit in UNITS.values() if unit.si == own} | {1.0}
    factors = sorted({a / b for a in scales for b in scales if a != b}, key=lambda f: abs(np.log(ratio / f)))
    if not factors or abs(ratio / factors[0] - 1) > LIKE_A_UNIT:
        return None
    return float(factors[0])


def _ratios(begun: Begun, first: Begun) -> np.ndarray:
    """Return each channel's linear coefficients over those of the first log, (K,), in size."""
    merged, known = first.merged, first.linear
    features = merged.summary.features
    both = begun.linear.moved & known.moved
    both &= np.array([features.label(j) != "1" for j in range(features.size)])
    size = np.sqrt(np.einsum("jj->j", merged.grams[0]))[:, None]
    own, other = (np.linalg.norm((one.coefficients * size)[both], axis=0) for one in (begun.linear, known))
    return own / np.maximum(other, 1e-300)
