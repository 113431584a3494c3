"""What `hallsym fleet` prints: verdicts, the spread of every parameter, devices that differ, groups."""

from hallsym.errors import counted
from hallsym.fleets import Fleet
from hallsym.fleets.row import VERDICTS
from hallsym.fleets.spread import Spread
from hallsym.report.tables import concise, grid
from hallsym.units import parameter_unit

MOST_NAMED = 20
"""Outlying devices that are listed; all stand in the table."""


def fleet_text(fleet: Fleet) -> str:
    """Return what `hallsym fleet` prints."""
    model = fleet.model.name if fleet.model else "no model"
    parts = [f"{counted(len(fleet.rows), 'device')} of {model} in {fleet.seconds:.1f} s", ""]
    rows = [["verdict", "devices", ""]]
    rows += [[v, str(len(devices)), VERDICTS[v]] for v, devices in fleet.verdicts.items()]
    parts.append(_with_words(rows))
    if fleet.spreads:
        parts += ["", spread_text(fleet)]
    for spread in fleet.spreads:
        parts += [_trend(spread, k) for k, t in enumerate(spread.trends) if t.significant]
    if fleet.outlying:
        parts += ["", f"{counted(len(fleet.outlying), 'device')} to look at:"]
        named = list(fleet.outlying.items())
        parts += [f"  {device}: {why}" for device, why in named[:MOST_NAMED]]
        parts += [f"  and {len(named) - MOST_NAMED} more"] if len(named) > MOST_NAMED else []
    if any(row.get("diagnosis") for row in fleet.rows):
        parts += ["", "devices of the same diagnosis:"]
        parts += [f"  {counted(len(devices), 'device')}: {key}" for key, devices in fleet.groups.items()]
    return "\n".join(parts)


def _with_words(rows: list[list[str]]) -> str:
    lines = grid([row[:2] for row in rows]).split("\n")
    words = [rows[0][2], "", *(row[2] for row in rows[1:])]
    return "\n".join(f"{line}  {word}".rstrip() for line, word in zip(lines, words, strict=True))


def spread_text(fleet: Fleet) -> str:
    """Return the table of spreads: mean, spread between devices with its interval, uncertainty of one fit."""
    rows = [["parameter", "mean", "spread (1 sigma)", "95 %", "of one fit", "unit", "devices"]]
    for s in fleet.spreads:
        factor, unit = parameter_unit(s.unit)
        low, high = (f"{factor * v:.3g}" for v in s.interval)
        rows.append([
            s.name, concise(factor * s.mean, factor * s.mean_std), f"{factor * s.std:.3g}",
            f"{low} .. {high}", f"{factor * s.typical_std:.2g}", unit, str(s.devices),
        ])  # fmt: skip
    return grid(rows)


def _trend(spread: Spread, k: int) -> str:
    trend = spread.trends[k]
    factor, unit = parameter_unit(spread.unit)
    slope = concise(factor * trend.slope, factor * trend.std)
    return f"{spread.name} follows {trend.column}: {slope} {unit} per 1 of it (p = {trend.chance:.1e})"
