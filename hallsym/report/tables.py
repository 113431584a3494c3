"""What every text is made of: aligned tables, values with their uncertainty, rows of errors."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from hallsym.units import readable


def grid(rows: Sequence[Sequence[str]], *, left: int = 1, rule_after: int = 1) -> str:
    """Return rows as aligned text: the first `left` columns left-aligned, a rule after the header."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = [
        "  ".join(
            c.ljust(w) if k < left else c.rjust(w) for k, (c, w) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
    lines.insert(rule_after, "-" * (sum(widths) + 2 * (len(widths) - 1)))
    return "\n".join(lines)


def concise(value: float, std: float | None) -> str:
    """Return value with its standard uncertainty in parentheses, on the last two digits: `0.86712(41)`."""
    if std is None or not np.isfinite(std) or std <= 0:
        return f"{value:.6g}"
    decimals = 1 - int(np.floor(np.log10(std)))
    if round(std, decimals) >= 10 ** (2 - decimals):  # .0999 rounds up to .10: two digits, not three
        decimals -= 1
    if decimals <= 0:
        return f"{value:.0f}({std:.0f})"
    return f"{value:.{decimals}f}({round(std * 10**decimals):d})"


def error_rows(
    pose: Sequence[str],
    rows: Mapping[str, Mapping[str, Mapping[str, float]] | None],
    floor: Mapping[str, float] | None,
    source: str = "",
    turning: Collection[str] | None = None,
) -> str:
    """Return a table of rmse and peak per pose coordinate, one line per entry of `rows`.

    `source`: whether the noise floor is stated or estimated, where that is to be said. `turning`: coordinates
    that go round, see `hallsym.units.readable`.
    """
    shown = [readable(c, turning) for c in pose]
    head = ["errors", *(f"{what} {name} [{unit}]" for what in ("rmse", "peak") for _, unit, name in shown)]
    body = [
        [
            label,
            *(
                _fixed(row[what][c] * factor)
                for what in ("rmse", "peak")
                for c, (factor, _, _) in zip(pose, shown, strict=True)
            ),
        ]
        for label, row in rows.items()
        if row is not None
    ]
    if floor:
        noise = [_fixed(floor[c] * factor) for c, (factor, _, _) in zip(pose, shown, strict=True)]
        body.append([f"noise floor, {source}" if source else "noise floor", *noise, *[""] * len(noise)])
    return grid([head, *body])


def _fixed(value: float) -> str:
    return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.3e}"
