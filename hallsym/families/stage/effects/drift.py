"""Gains and offsets of the stage that follow data-only functions (`hallsym.families.data_functions`)."""

from collections.abc import Callable

import casadi as ca

from hallsym.families.data_functions import Columns, Read, count
from hallsym.families.parts import Make, P, add, column, free
from hallsym.families.stage.effects.parts import labels
from hallsym.model import Model, Signals


def gain_drift(effect: str, columns: Columns, read: Read) -> Make:
    """Gain times 1 + sum of g f(t), g per probe; f are data-only functions of the columns."""

    def step(s: Signals, sums: ca.SX) -> None:
        s["gain"] = s["gain"] * (1 + sums)

    return _following(effect, "transducer", columns, read, step, (1.0, "1", "relative drift of the gain"))


def offset_drift(effect: str, columns: Columns, read: Read) -> Make:
    """Reading plus sum of o f(t), o per probe."""

    def step(s: Signals, sums: ca.SX) -> None:
        s["reading"] = s["reading"] + sums

    return _following(effect, "electronics", columns, read, step, (1e-3, "m", "drift of the offset"))


def _following(
    effect: str,
    link: str,
    columns: Columns,
    read: Read,
    use: Callable[[Signals, ca.SX], None],
    described: tuple[float, str, str],
) -> Make:
    """One parameter per probe and function, `described` by limit, unit and meaning; `use` gets the sums."""

    def make(model: Model) -> Model:
        wide = model.with_columns(*columns)
        names = [[f"{effect}{j}_{k}" for k in labels(model)] for j in range(count(wide, read))]

        def step(s: Signals, p: P) -> None:
            parts = [column(p, row) * f for row, f in zip(names, read(s), strict=True)]
            use(s, sum(parts[1:], start=parts[0]))

        return add(wide, link, effect, free([n for row in names for n in row], *described), step)

    return make
