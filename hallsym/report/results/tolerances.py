"""Report of a study of tolerances, and of errors along a coordinate by cause."""

from collections.abc import Iterator
from itertools import cycle

import numpy as np

from hallsym.errors import few
from hallsym.output import percent
from hallsym.records import named
from hallsym.report import picture as p
from hallsym.report.content import Block, Content, Section, Table
from hallsym.report.tables import cells, heads
from hallsym.report.words import each, largest, name, number, scale
from hallsym.uncertainty import ErrorModel
from hallsym.uncertainty.tolerances import ENOUGH, MOST_SAMPLES, Tolerance, Tolerances
from hallsym.units import fitting, parameter_unit, readable, typeset


def tolerances_content(found: Tolerances) -> Content:
    """Return the report of a study of tolerances: what to tighten first, errors, ranking, Sobol indices."""
    basis = (
        f"{found.model.name}: {len(found.active)} tolerances, {found.points} points of the workspace, "
        f"{found.samples} base samples, seed {found.seed}"
    )
    return Content(
        f"Tolerances of {found.model.name}",
        _tighten(found),
        [
            Section("worth", "What a tolerance is worth", [worth_table(found)]),
            Section("indices", "Sobol indices", [
                index_table(found),
                *_sentences(found),
                *(f"note: {note}" for note in found.notes),
            ]),
        ],
        [basis, error_table(found)],
        columns={"tolerance": found.active, **named(found.model.pose, found.worth.exact.T)},
    )  # fmt: skip


def _tighten(found: Tolerances) -> str:
    """Return which tolerance to tighten first, and what that is worth."""
    worth = found.worth.exact
    j, k = np.unravel_index(int(np.argmax(worth)), worth.shape)
    first, what = found.active[int(j)], name(found.model.pose[int(k)])
    said = f"Tighten {first} first: it lowers the {what} error by {percent(worth[j, k])}"
    half = found.worth.exact_half[j, k]
    others = [
        found.active[i]
        for i in np.flatnonzero(worth[:, k] + found.worth.exact_half[:, k] > worth[j, k] - half)
    ]
    unsure = [other for other in others if other != first]
    return f"{said} if it is exact" + (f"; {few(unsure)} may be worth as much." if unsure else ".")


def error_table(found: Tolerances) -> Table:
    """Return the errors of the machines drawn, in um and urad."""
    pose, period, e = found.model.pose, found.model.period, found.errors
    rows = {
        "rms, all machines": e.rms,
        "of which common to all": e.mean,
        "rms of one machine, 95 % below": e.rms_95,
        "peak of one machine, 95 % below": e.peak_95,
    }
    body = [[label, *cells(values, pose, period)] for label, values in rows.items()]
    caption = f"errors of the nominal decoder without calibration, {2 * found.samples} machines drawn"
    return Table(["errors", *heads(pose, period)], body, caption, titled=True)


def worth_table(found: Tolerances) -> Table:
    """Return the ranking: fall of the rms of each coordinate if one tolerance is made exact."""
    ranges = {t.name: t for t in found.tolerances}
    head = ["tolerance", "range", *map(name, found.model.pose), "+- (95 %)"]
    rows = []
    for one in found.ranking:
        j = found.active.index(one)
        wide = _percent(found.worth.exact_half[j].max())
        rows.append([one, size(ranges[one]), *map(_percent, found.worth.exact[j]), wide])
    caption = "fall of the rms error in % if one tolerance alone is exact"
    return Table(head, rows, caption, left=2, titled=True)


def index_table(found: Tolerances) -> Table:
    """Return first and total indices of the error, one line per tolerance, with the widest interval."""
    indices = [(name(c), found.indices[c]) for c in found.model.pose]
    head = ["tolerance", *(f"{what} {kind}" for what, _ in indices for kind in ("first", "total"))]
    rows = []
    for one in found.ranking:
        j = found.active.index(one)
        rows.append([one, *(_percent(v) for _, i in indices for v in (i.first[j], i.total[j]))])
    rows.append(["sum", *(_percent(v.sum()) for _, i in indices for v in (i.first, i.total))])
    rows.append(["widest +- (95 %)", *(v for _, i in indices for v in (_percent(i.widest), ""))])
    caption = "Sobol indices in % of the error over the workspace: first (alone), total"
    return Table(head, rows, caption, titled=True)


def size(t: Tolerance) -> str:
    """Return a range for reading: `+-50 mm`, `0.1 deg (normal)`."""
    factor, unit = parameter_unit(t.unit, bare=True)
    sign = "" if t.distribution == "normal" else "+-"
    moved = abs(t.centre - t.nominal) > 1e-12 * abs(t.nominal)
    about = f" about {number(t.centre * factor, 4)}" if moved else ""
    kind = {"rectangular": "", "normal": " (1 sigma)"}.get(t.distribution, f" ({t.distribution})")
    return f"{sign}{number(t.width * factor, 6)} {unit}".rstrip() + about + kind


def _percent(value: float) -> str:
    return f"{100 * value + 0.0:.1f}".replace("-0.0", "0.0")


def _sentences(found: Tolerances) -> Iterator[str]:
    yield _sharpness(found)
    yield (
        "several exact at once: add their first indices, if first and total agree; the rms falls to "
        "sqrt(1 - sum) of its value"
    )
    exact = [t.name for t in found.tolerances if t.width == 0]
    if exact:
        yield f"exact: {', '.join(exact)}"


def _sharpness(found: Tolerances) -> str:
    text = f"intervals: all are within +-{_percent(found.widest)} points (95 %)"
    if found.sharp:
        return f"{text}, sharp enough to rank what differs by more"
    if found.wanted > MOST_SAMPLES:
        return f"{text}, too wide to rank by; {MOST_SAMPLES} samples are the most there can be"
    return (
        f"{text}, too wide to rank by: about --samples {found.wanted} brings them below {100 * ENOUGH:.0f} "
        "(four times the samples and the time, half the width)"
    )


# -- errors along a coordinate -----------------------------------------------------------------------------


def errors_content(found: ErrorModel) -> Content:
    """Return errors along a coordinate by cause, and the causes of each number of waves."""
    *_, together = found.causes
    cause, _, errors = together
    sizes = dict(zip(found.model.pose, np.abs(errors.error).max(axis=1), strict=True))
    *_, moving = span(found)
    return Content(
        f"Errors of {found.model.name} along {moving}",
        f"The largest error over {moving} is {each(sizes, found.model.period)} ({cause}).",
        [Section("waves", "Waves", _waves(found))],
        [_along_head(found), along_table(found)],
        columns={found.coordinate: errors.at}
        | {f"{cause}: {c}": e.error[k] for cause, _, e in found.causes for k, c in enumerate(sizes)},
        pictures={"errors": lambda log: errors_along(found)},
    )


def _along_head(found: ErrorModel) -> str:
    low, high, factor, unit, name = span(found)
    shown = ((*readable(c, found.model.period), v) for c, v in found.at.items())
    rest = "".join(f", {n} = {number(v * f, 6)} {u}" for f, u, n, v in shown)
    return (
        f"{found.model.name}: error (decoded less true) over {name} = {number(factor * low, 6)} to "
        f"{number(factor * high, 6)} {unit}{rest}; decoder: {found.decoder}, nominal values, no noise"
    )


def along_table(found: ErrorModel) -> Table:
    """Return one line per cause and coordinate of the pose."""
    *_, factor, unit, name = span(found)
    pose, period, place = found.model.pose, found.model.period, f"at {name} [{unit}]"
    head = ["cause", "error", "mean", "rms", "largest", place, "least", place, "waves"]
    rows = []
    for cause, _, errors in found.causes:
        for k, column in enumerate(pose):
            f = readable(column, period)[0]
            (high, there), (low, here) = errors.extremes(k)
            numbers = (errors.error[k].mean(), errors.rms[k], high, low)
            mean, rms, most, least = ("0" if abs(v * f) < SHOWN else number(v * f, 4) for v in numbers)
            ends = [most, number(there * factor, 4), least, number(here * factor, 4)]
            label = cause if k == 0 else ""
            rows.append([label, *heads([column], period), mean, rms, *ends, str(errors.waves[k])])
    return Table(head, rows, "error by cause", left=2)


SHOWN = 1e-4
"""Least error shown [um, urad, deg]: a decoder that has converged only rounds below it."""


def _waves(found: ErrorModel) -> list[Block | str]:
    expected = found.expected_waves
    if not expected:
        return []
    low, high, factor, unit, name = span(found)
    per = f"{number(factor * (high - low), 6)} {unit} of {name}"
    rows = [
        [str(n), number(factor * (high - low) / n, 4), ", ".join(effects)]
        for n, effects in expected.items()
        if n
    ]
    head, caption = ["waves", f"period [{unit}]", "effects"], f"causes by the waves of their error per {per}"
    return [Table(head, rows, caption, left=3, titled=True)]


COLOURS = (p.BLUE, p.ORANGE, p.GREEN, p.PINK, p.INK, p.YELLOW, p.SKY)
DASHES = ("-", "--", "-.", ":", (0, (6, 1, 1, 1, 1, 1)), (0, (1, 3)))
"""Of causes; not equally many, so that pairs repeat late."""


def span(found: ErrorModel) -> tuple[float, float, float, str, str]:
    """Return first place, end of the range, factor, unit and name of the coordinate that moves."""
    column, (low, high) = found.coordinate, found.causes[0][2].ends
    factor, unit, name = readable(column, found.model.period)
    if unit != "deg":
        factor, unit = fitting(column.rpartition("_")[2], max(abs(low), abs(high)))
    return low, high, factor, unit, name


def errors_along(found: ErrorModel) -> p.Picture:
    """Return the error of each coordinate of the pose over the one that moves, a line per cause."""
    pose, causes = found.model.pose, found.causes
    styles = zip(cycle(COLOURS), cycle(DASHES), causes, strict=False)
    looks = [p.Look(c, dash=dash) for c, dash, _ in styles]
    if len(causes) > 1:
        looks[-1] = p.Look(p.INK, width=1.4)  # all together
    *_, factor, unit, moving = span(found)
    panels = []
    for k, column in enumerate(pose):
        y_factor, y_unit = scale(
            column, largest(np.array([e.error[k] for *_, e in causes])), found.model.period
        )
        layers: list[p.Layer] = [p.level(0.0, p.Look(p.FAINT, width=0.6))]
        layers += [
            p.line(factor * e.at, y_factor * e.error[k], look, cause)
            for (cause, *_, e), look in zip(causes, looks, strict=True)
        ]
        at = factor * causes[0][-1].at
        x = p.Axis(f"{moving} [{typeset(unit)}]", at.min(), at.max(), most=8)
        y = p.Axis(f"error of {name(column)} [{y_unit}]")
        panels.append(p.Panel(x, y, layers))
    return p.Picture(panels, across=1)
