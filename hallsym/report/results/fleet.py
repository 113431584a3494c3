"""Report of a fleet: verdicts, the spread of every parameter, devices that differ, groups."""

from hallsym.errors import counted
from hallsym.fleets import Fleet
from hallsym.fleets.row import VERDICTS
from hallsym.report.content import Block, Content, Section, Table
from hallsym.report.figures.fleet import distributions
from hallsym.report.results.shared import few
from hallsym.report.tables import concise
from hallsym.report.words import number
from hallsym.units import parameter_unit

MOST_LISTED = 20
"""Devices to look at that are listed; all stand in the table that is saved, and in the page's file."""
SPREAD = (
    "parameter", "mean (1 sigma)", "spread (1 sigma)", "spread, 95 % interval", "1 sigma of one fit", "unit",
    "devices", "outlying",
)  # fmt: skip


def fleet_content(fleet: Fleet) -> Content:
    """Return the report of a fleet."""
    model = fleet.model.name if fleet.model else "no model"
    count, good = len(fleet.rows), int(fleet.good.sum())
    verdicts = [[v, str(len(devices)), VERDICTS[v]] for v, devices in fleet.verdicts.items()]
    listed = list(fleet.outlying.items())
    rest = len(listed) - MOST_LISTED
    outlying: list[Block | str] = [
        Table([f"{counted(len(listed), 'device')} to look at", "why"], listed[:MOST_LISTED], wordy=(1,),
              caption="devices that differ from the others or could not be fitted"),
        *([f"and {rest} more, in the table that -o writes"] if rest > 0 else []),
    ]  # fmt: skip
    groups = [[key, str(len(names)), few(names)] for key, names in fleet.groups.items()]
    groups = groups if any(row.get("diagnosis") for row in fleet.rows) else []
    also = f", {len(listed)} to look at" if listed else ""
    return Content(
        f"Fleet of {counted(count, 'device')}: {model}",
        f"{good} of {counted(count, 'device')} of {model} {'is' if count == 1 else 'are'} good{also}.",
        [
            Section("spread", "Spread of the parameters", [Table(SPREAD, _spreads(fleet), "by parameter")]),
            Section("outlying", "Devices to look at", outlying),
            Section(
                "groups", "Devices of the same diagnosis",
                [Table(["devices of the same diagnosis", "devices", "which"], groups, "groups", wordy=(2,))],
            ),
        ],
        [Table(["verdict", "devices", "meaning"], verdicts, "devices by verdict", wordy=(2,))],
        state="good" if good == count else "open",
        columns=fleet.table(),
        picture=lambda log: distributions(fleet),
        seconds=fleet.seconds,
    )  # fmt: skip


def _spreads(fleet: Fleet) -> list[list[str]]:
    """Return mean, spread between devices with its interval and uncertainty of one fit of every parameter."""
    rows = []
    for s in fleet.spreads:
        factor, unit = parameter_unit(s.unit)
        low, high = (number(factor * v) for v in s.interval)
        rows.append([
            s.name, concise(factor * s.mean, factor * s.mean_std), number(factor * s.std),
            f"{low} .. {high}", number(factor * s.typical_std, 2), unit, str(s.devices), str(len(s.outlying)),
        ])  # fmt: skip
    return rows
