"""Two results beside each other: which key differs, what it was, what it is.

Tolerances are about ten times what was measured between processors (OPENBLAS_CORETYPE=Nehalem; two processes
on one machine give the same bits):

- "fit": a value by 1e-9 of its size or 1e-6 standard deviations, which is what the tests of solvers call the
  same optimum; standard uncertainties 1e-7; errors, noise and cost 1e-8; zero deviations 1e-8 or 1e-14.
- "diagnosis": names, verdict, groups and their order exactly; numbers 1e-3; shares and intervals .01 (shares
  of a single coordinate or link .05, a link of no weight may or may not be tried); p-values half a decade;
  the standard deviations between two effects 1e-6 at least: of equal effects they are the root of rounding.
- "code": as it is. It is made with OpenBLAS held to kernels that every x86-64 runs: by other kernels the
  last bit of a constant in 6 of 21 folders differs.
"""

import re
from collections.abc import Iterator, Mapping
from math import log10
from typing import Any

NUMBER = re.compile(r"-?\d+\.?\d*(?:e[+-]?\d+)?")
LEAST_P = 1e-15


def allowed(kind: str, path: str, old: float, holder: Any) -> float:
    """Return what a number may differ by; `holder`: the object or list that holds it."""
    if kind == "fit":
        return _of_fit(path, old, holder)
    return _of_diagnosis(path, old, holder) if kind == "diagnosis" else 0.0


def _of_fit(path: str, old: float, holder: Any) -> float:
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


def _of_diagnosis(path: str, old: float, holder: Any) -> float:
    if re.search(r"\.parameters\.\w+\.value$", path):
        return max(1e-3 * abs(old), 1e-2 * (holder.get("std") or 0.0))
    if path.startswith("shares["):
        return 0.05
    if path.endswith(".sigma_now"):
        return max(1e-6, 1e-3 * abs(old))
    if re.search(r"(share|held_out|shrinkage|shrinkage\.value|interval\[\d+\]|share_closed)$", path):
        return 0.01
    if isinstance(holder, list):
        return 1e-3 * max(abs(v) for v in holder if isinstance(v, int | float))
    if path.endswith((".mean", ".model", ".above")):
        return 1e-3 * max(abs(old), *(abs(holder.get(k) or 0.0) for k in ("rms", "noise", "amplitude")))
    return 1e-3 * abs(old)


def differences(old: Any, new: Any, kind: str, path: str = "", holder: Any = None) -> Iterator[str]:
    """Yield one line for each key that differs by more than what is allowed."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in sorted(old.keys() ^ new.keys()):
            yield f"{path}: key {key!r} is {'gone' if key in old else 'new'}"
        for key in (k for k in old if k in new):
            yield from differences(old[key], new[key], kind, f"{path}.{key}".lstrip("."), old)
    elif isinstance(old, list) and isinstance(new, list):
        if len(old) != len(new):
            yield f"{path}: {len(old)} entries were {old}; now {len(new)}: {new}"
        for k, (one, other) in enumerate(zip(old, new, strict=False)):
            yield from differences(one, other, kind, f"{path}[{k}]", old)
    elif not _same(old, new, kind, path, holder):
        yield f"{path}: was {old!r}, is {new!r}"


def _same(old: Any, new: Any, kind: str, path: str, holder: Any) -> bool:
    if _is_number(old) and _is_number(new):
        if path.endswith("p_value") and kind == "diagnosis":
            return abs(log10(max(old, LEAST_P)) - log10(max(new, LEAST_P))) <= 0.5
        return abs(new - old) <= allowed(kind, path, old, holder)
    if isinstance(old, str) and isinstance(new, str) and path.endswith("text") and kind == "diagnosis":
        pairs = zip(NUMBER.findall(old), NUMBER.findall(new), strict=False)  # effects as text
        return NUMBER.sub("#", old) == NUMBER.sub("#", new) and all(
            abs(float(a) - float(b)) <= 1e-3 * abs(float(a)) for a, b in pairs
        )
    return old == new and isinstance(old, bool) == isinstance(new, bool)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
