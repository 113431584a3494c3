"""What a person reads of a study of tolerances, and of errors along a coordinate by cause."""

from collections.abc import Iterator

import numpy as np

from hallsym.report.tables import cells, grid, heads
from hallsym.uncertainty import ErrorModel
from hallsym.uncertainty.tolerances import ENOUGH, MOST_SAMPLES, Tolerance, Tolerances
from hallsym.units import fitting, parameter_unit, readable


def tolerances_text(found: Tolerances) -> str:
    """Return what `hallsym tolerances` prints: errors, ranking and Sobol indices."""
    machines = 2 * found.samples
    return "\n".join(
        [
            f"{found.model.name}: {len(found.active)} tolerances, {found.points} points of the workspace, "
            f"{found.samples} base samples, seed {found.seed}",
            "",
            f"errors of the nominal decoder without calibration, {machines} machines drawn",
            error_table(found),
            "",
            "what a tolerance is worth: fall of the rms error in % if it alone is exact",
            worth_table(found),
            "",
            "Sobol indices in %: first total, of the error over the workspace",
            index_table(found),
            "",
            *_sentences(found),
            *(f"note: {note}" for note in found.notes),
        ]
    )


def error_table(found: Tolerances) -> str:
    """Return the errors of the machines drawn, in um and urad."""
    pose, period, e = found.model.pose, found.model.period, found.errors
    rows = {
        "rms, all machines": e.rms,
        "of which common to all": e.mean,
        "rms of one machine, 95 % below": e.rms_95,
        "peak of one machine, 95 % below": e.peak_95,
    }
    body = [[label, *cells(values, pose, period)] for label, values in rows.items()]
    return grid([["", *heads(pose, period)], *body])


def worth_table(found: Tolerances) -> str:
    """Return the ranking: fall of the rms of each coordinate if one tolerance is made exact."""
    ranges = {t.name: t for t in found.tolerances}
    rows = [["tolerance", "range", *(readable(c)[2] for c in found.model.pose), "+- (95 %)"]]
    for name in found.ranking:
        j = found.active.index(name)
        wide = _percent(found.worth.exact_half[j].max())
        rows.append([name, size(ranges[name]), *map(_percent, found.worth.exact[j]), wide])
    return grid(rows, left=2)


def index_table(found: Tolerances) -> str:
    """Return first and total indices of the error, one line per tolerance, with the widest interval."""
    indices = [found.indices[c] for c in found.model.pose]
    rows = [["tolerance", *(readable(c)[2] for c in found.model.pose)]]
    for name in found.ranking:
        j = found.active.index(name)
        rows.append([name, *(f"{_percent(i.first[j])} {_percent(i.total[j]):>5}" for i in indices)])
    rows.append(["sum", *(f"{_percent(i.first.sum())} {_percent(i.total.sum()):>5}" for i in indices)])
    rows.append(["widest +- (95 %)", *(_percent(i.widest) for i in indices)])
    return grid(rows)


def size(t: Tolerance) -> str:
    """Return a range for reading: `+-50 mm`, `0.1 deg (normal)`."""
    factor, unit = parameter_unit(t.unit, bare=True)
    sign = "" if t.distribution == "normal" else "+-"
    about = f" about {t.centre * factor:.4g}" if abs(t.centre - t.nominal) > 1e-12 * abs(t.nominal) else ""
    kind = {"rectangular": "", "normal": " (1 sigma)"}.get(t.distribution, f" ({t.distribution})")
    return f"{sign}{t.width * factor:.6g} {unit}".rstrip() + about + kind


def _percent(value: float) -> str:
    return f"{100 * value + 0.0:.1f}".replace("-0.0", "0.0")


def _sentences(found: Tolerances) -> Iterator[str]:
    yield _sharpness(found)
    yield (
        "several at once: shares of the error add where first and total index agree; the rms falls to "
        "sqrt(1 - sum)"
    )
    exact = [t.name for t in found.tolerances if t.width == 0]
    if exact:
        yield f"exact: {', '.join(exact)}"


def _sharpness(found: Tolerances) -> str:
    text = f"intervals: indices of the error are within +-{_percent(found.widest)} points (95 %)"
    if found.widest <= ENOUGH:
        return f"{text}, sharp enough to rank what differs by more"
    wanted = found.samples * 2 ** int(np.ceil(2 * np.log2(found.widest / ENOUGH)))
    if wanted > MOST_SAMPLES:
        return f"{text}, too wide to rank by; {MOST_SAMPLES} samples are the most there can be"
    return (
        f"{text}, too wide to rank by: about --samples {wanted} brings them below {100 * ENOUGH:.0f} "
        "(four times the samples and the time, half the width)"
    )


# -- errors along a coordinate -----------------------------------------------------------------------------


def errors_text(found: ErrorModel) -> str:
    """Return what `hallsym tolerances --along` prints: errors by cause, and what makes how many waves."""
    return "\n".join([_along_head(found), "", along_table(found), *_waves(found)])


def span(found: ErrorModel) -> tuple[float, float, float, str, str]:
    """Return first place, end of the range, factor, unit and name of the coordinate that moves."""
    column, at = found.coordinate, found.causes[0][2].at
    low, high = float(at[0]), float(at[0] + (at[1] - at[0]) * len(at))
    factor, unit, name = readable(column, found.model.period)
    if unit != "deg":
        factor, unit = fitting(column.rpartition("_")[2], max(abs(low), abs(high)))
    return low, high, factor, unit, name


def _along_head(found: ErrorModel) -> str:
    low, high, factor, unit, name = span(found)
    shown = ((*readable(c, found.model.period), v) for c, v in found.at.items())
    rest = "".join(f", {n} = {v * f:.6g} {u}" for f, u, n, v in shown)
    return (
        f"{found.model.name}: error (decoded less true) over {name} = {factor * low:.6g} to "
        f"{factor * high:.6g} {unit}{rest}; decoder: {found.decoder}, nominal values, no noise"
    )


def along_table(found: ErrorModel) -> str:
    """Return one line per cause and coordinate of the pose."""
    *_, factor, unit, name = span(found)
    pose, period, place = found.model.pose, found.model.period, f"at {name} [{unit}]"
    rows = [["cause", "error", "mean", "rms", "largest", place, "least", place, "waves"]]
    for cause, _, errors in found.causes:
        for k, column in enumerate(pose):
            f = readable(column, period)[0]
            (high, there), (low, here) = errors.extremes(k)
            numbers = (errors.error[k].mean(), errors.rms[k], high, low)
            mean, rms, most, least = ("0" if abs(v * f) < SHOWN else f"{v * f:.4g}" for v in numbers)
            ends = [most, f"{there * factor:.4g}", least, f"{here * factor:.4g}"]
            label = cause if k == 0 else ""
            rows.append([label, *heads([column], period), mean, rms, *ends, str(errors.waves[k])])
    return grid(rows, left=2)


SHOWN = 1e-4
"""Least error shown [um, urad, mdeg]: a decoder that has converged only rounds below it."""


def _waves(found: ErrorModel) -> Iterator[str]:
    expected = found.expected_waves
    if not expected:
        return
    low, high, factor, unit, name = span(found)
    yield ""
    yield f"causes by the waves of their error per {factor * (high - low):.6g} {unit} of {name}"
    rows = [["waves", f"period [{unit}]", "effects"]]
    for n, effects in expected.items():
        if n:
            rows.append([str(n), f"{factor * (high - low) / n:.4g}", ", ".join(effects)])
    yield grid(rows, left=3)
