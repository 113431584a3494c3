"""What `hallsym fleet` prints: verdicts, the spread of every parameter, devices that differ, groups."""

from hallsym.errors import counted
from hallsym.fleets import Fleet
from hallsym.fleets.row import VERDICTS
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
    parts.append(grid(rows, words=True))
    if fleet.spreads:
        parts += ["", grid([SPREAD, *spread_rows(fleet)])]
    if fleet.outlying:
        parts += ["", f"{counted(len(fleet.outlying), 'device')} to look at:"]
        named = list(fleet.outlying.items())
        parts += [f"  {device}: {why}" for device, why in named[:MOST_NAMED]]
        parts += [f"  and {len(named) - MOST_NAMED} more"] if len(named) > MOST_NAMED else []
    if any(row.get("diagnosis") for row in fleet.rows):
        parts += ["", "devices of the same diagnosis:"]
        parts += [f"  {counted(len(devices), 'device')}: {key}" for key, devices in fleet.groups.items()]
    return "\n".join(parts)


SPREAD = (
    "parameter", "mean (1 sigma)", "spread (1 sigma)", "95 % of the spread", "1 sigma of one fit", "unit",
    "devices", "outlying",
)  # fmt: skip


def spread_rows(fleet: Fleet) -> list[list[str]]:
    """Return mean, spread between devices with its interval and uncertainty of one fit of every parameter."""
    rows = []
    for s in fleet.spreads:
        factor, unit = parameter_unit(s.unit)
        low, high = (f"{factor * v:.3g}" for v in s.interval)
        rows.append([
            s.name, concise(factor * s.mean, factor * s.mean_std), f"{factor * s.std:.3g}",
            f"{low} .. {high}", f"{factor * s.typical_std:.2g}", unit, str(s.devices), str(len(s.outlying)),
        ])  # fmt: skip
    return rows
