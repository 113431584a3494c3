"""Two results beside each other: which key differs, what it was, what it is.

Tolerances were measured. Two processes on one machine give the same bits, with one BLAS thread or two.
With the kernels of another processor (OPENBLAS_CORETYPE=Nehalem) fitted values agree to 1e-9 of their size or
to 5e-8 standard deviations, their uncertainties and zero deviations to 3e-9 (to 2e-8 where zero deviations
almost cancel a parameter), error tables to 7e-10, the numbers of a diagnosis to 3e-6 (what a proposed
recording would tell: 3e-5). What is allowed here is about ten times that:

- "fit": a value by 1e-9 of its size or 1e-6 standard deviations, which is what the tests of solvers call the
  same optimum; standard uncertainties 1e-7; errors, noise and cost 1e-8; zero deviations 1e-8 or 1e-14.
- "diagnosis": names, verdict, groups and their order exactly; numbers 1e-3; shares and intervals .01 (shares
  of a single coordinate or link .05, a link of no weight may or may not be tried); p-values half a decade.
- "json": 1e-6 of every number, and sensitivities 1e-12; "close": 1e-8; "exact": as it is.

Generated C is made with OpenBLAS held to kernels that every x86-64 runs: by other kernels the last bit of a
constant in 6 of 21 folders differs.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from math import log10
from typing import Any

Allowed = Callable[[str, float, Any], float]
"""`(path, old value, what holds it) -> greatest difference`."""

LEAST_P = 1e-15


def fit(path: str, old: float, holder: Any) -> float:
    """Return what a number of a fit may differ by."""
    if re.search(r"(parameters\.\w+|combinations\[\d+\])\.value$", path):
        std = holder.get("std")
        return max(1e-9 * abs(old), 1e-6 * std if isinstance(std, float) else 0.0)
    if path.startswith("zero_deviations"):
        return max(1e-8 * abs(old), 1e-14)
    if path.endswith(".std"):
        return 1e-7 * abs(old)
    if path == "covariance.correlation":
        return 1e-5 * max(1.0, abs(old))
    return 1e-8 * abs(old)


def diagnosis(path: str, old: float, holder: Any) -> float:
    """Return what a number of a diagnosis may differ by; p-values are compared by their logarithm."""
    if re.search(r"\.parameters\.\w+\.value$", path):
        return max(1e-3 * abs(old), 1e-2 * (holder.get("std") or 0.0))
    if path.startswith("shares["):
        return 0.05
    if re.search(r"(share|held_out|shrinkage|shrinkage\.value|interval\[\d+\]|share_closed)$", path):
        return 0.01
    if isinstance(holder, list):
        return 1e-3 * max(abs(v) for v in holder if isinstance(v, int | float))
    if path.endswith((".mean", ".model", ".above")):
        return 1e-3 * max(abs(old), *(abs(holder.get(k) or 0.0) for k in ("rms", "noise", "amplitude")))
    return 1e-3 * abs(old)


def relative(tolerance: float) -> Allowed:
    """Return a tolerance that is relative to the number, or to the largest of its list."""

    def allowed(path: str, old: float, holder: Any) -> float:
        size = abs(old)
        if isinstance(holder, list):
            size = max(abs(v) for v in holder if isinstance(v, int | float))
        zero = 1e-12 if path.endswith(".sensitivity") else 1e-18  # of a pose to what it does not depend on
        return tolerance * size + zero

    return allowed


ALLOWED: Mapping[str, Allowed] = {
    "fit": fit, "diagnosis": diagnosis, "json": relative(1e-6), "close": relative(1e-8),
    "exact": lambda path, old, holder: 0.0,
}  # fmt: skip


def differences(old: Any, new: Any, kind: str, path: str = "", holders: Any = (None, None)) -> Iterator[str]:
    """Yield one line for each key that differs by more than what is allowed."""
    where = path or "the result"
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in old.keys() - new.keys():
            yield f"{where}: key {key!r} is gone (it was {_short(old[key])})"
        for key in new.keys() - old.keys():
            yield f"{where}: key {key!r} is new ({_short(new[key])})"
        for key in (k for k in old if k in new):
            yield from differences(old[key], new[key], kind, f"{path}.{key}".lstrip("."), (old, new))
    elif isinstance(old, list) and isinstance(new, list):
        if len(old) != len(new):
            yield f"{where}: {len(old)} entries were {_short(old)}; now {len(new)}: {_short(new)}"
        for k, (one, other) in enumerate(zip(old, new, strict=False)):
            yield from differences(one, other, kind, f"{path}[{k}]", (old, new))
    elif _is_number(old) and _is_number(new):
        yield from _numbers(old, new, kind, where, holders[0])
    elif isinstance(old, str) and isinstance(new, str) and path.endswith("text") and kind == "diagnosis":
        if not _same_recipe(old, new):
            yield f"{where}: was {old!r}, is {new!r}"
    elif old != new or isinstance(old, bool) != isinstance(new, bool):
        yield f"{where}: was {_short(old)}, is {_short(new)}"


def _numbers(old: float, new: float, kind: str, path: str, holder: Any) -> Iterator[str]:
    if path.endswith("p_value") and kind == "diagnosis":
        decades = abs(log10(max(old, LEAST_P)) - log10(max(new, LEAST_P)))
        if decades > 0.5:
            yield f"{path}: was {old!r}, is {new!r} ({decades:.2g} decades apart, 0.5 are allowed)"
        return
    allowed = ALLOWED[kind](path, old, holder)
    if not abs(new - old) <= allowed:
        yield f"{path}: was {old!r}, is {new!r} (apart by {abs(new - old):.3g}, {allowed:.3g} is allowed)"


NUMBER = re.compile(r"-?\d+\.?\d*(?:e[+-]?\d+)?")


def _same_recipe(old: str, new: str) -> bool:
    """Effects as text: the same names, numbers to 1e-3."""
    if NUMBER.sub("#", old) != NUMBER.sub("#", new):
        return False
    pairs = zip(NUMBER.findall(old), NUMBER.findall(new), strict=True)
    return all(abs(float(a) - float(b)) <= 1e-3 * abs(float(a)) for a, b in pairs)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) < 160 else f"{text[:157]}..."
