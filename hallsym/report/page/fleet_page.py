"""The page of a fleet: tables, and a histogram and a course of every parameter."""

from typing import Any

from hallsym.errors import counted
from hallsym.fleets import Fleet
from hallsym.fleets.row import VERDICTS
from hallsym.report.figures.fleet import distributions
from hallsym.report.page.content import Figure, Headline, Section, Table, Words, document
from hallsym.report.text.fleet import SPREAD, spread_rows

MOST_LISTED = 500
"""Devices in the list of those that differ; all stand in the table that is saved."""
MOST_NAMED = 12
"""Devices of a group that are named."""


def page_of(fleet: Fleet) -> str:
    """Return the page of a fleet."""
    model = fleet.model.name if fleet.model else "no model"
    count, good = len(fleet.rows), int(fleet.good.sum())
    verdicts = [[v, str(len(devices)), VERDICTS[v]] for v, devices in fleet.verdicts.items()]
    groups = []
    for key, names in fleet.groups.items():
        shown = [*names[:MOST_NAMED], *["..."] * (len(names) > MOST_NAMED)]
        groups.append([key, str(len(names)), ", ".join(shown)])
    outlying = list(fleet.outlying.items())[:MOST_LISTED]
    drawn: list[Any] = []
    if fleet.spreads:
        picture = distributions(fleet)
        drawn = [Words(picture.words), Figure(picture.panels, look="two")]
    heads = ["verdict", "devices", "meaning"], ["device", "why"], ["diagnosis", "devices", "which"]
    sections = [
        Section("verdicts", "Verdicts", [Table(heads[0], verdicts, "devices by verdict", wordy=(2,))]),
        Section("spread", "Spread of the parameters", [Table(SPREAD, spread_rows(fleet), "by parameter")]),
        Section("outlying", "Devices to look at", [Table(heads[1], outlying, "by device", wordy=(1,))]),
        Section("groups", "Devices of the same diagnosis", [Table(heads[2], groups, "groups", wordy=(2,))]),
        Section("distributions", "Distributions", drawn),
    ]
    headline = Headline("good" if good == count else "open", f"{good} of {count} good.", f"Model: {model}.")
    return document(f"Fleet of {counted(count, 'device')}: {model}", headline, sections, "")
