"""Report of a calibration without a reference: the source of each wave of its table."""

from __future__ import annotations

from dataclasses import replace
from math import degrees
from typing import Any

import numpy as np

from hallsym.errors import counted, listed
from hallsym.estimation.self_calibration import MOTION, NONE, OPEN, SENSOR, Wave, coefficients, columns
from hallsym.estimation.without_reference import SelfFit, electrical, separated_by
from hallsym.experiment.turns import RATIOS, TURNS, TurnPlan, two_speeds
from hallsym.fleets import RingFleet
from hallsym.output import percent
from hallsym.report import picture as p
from hallsym.report.content import Block, Content, Section, Table
from hallsym.report.results.fleet import fleet_content
from hallsym.report.words import number

SHOWN = 12
"""Waves of the sensor that are listed, the largest; of the others all up to as many."""
READING = {
    SENSOR: "no ripple of the motion shows",
    MOTION: "motion, separated from the sensor",
    OPEN: "sensor and motion are not separable with this recording",
}


def self_fit_content(result: SelfFit) -> Content:
    """Return the sentence, errors on the holdout turn, waves, and recordings that separate them."""
    found, fit = result.found, result.fit
    turns = ", ".join(f"{t:.1f}" for t in found.turns)
    basis = (
        f"{fit.model.name}, {counted(found.pairs, 'pole pair')}, reference: {found.reference}; turns: {turns}"
    )
    left: list[Block] = []
    if found.left:
        names = {"nominal": "nominal transform", "ellipse": "ellipse alone", "table": "this table"}
        head = ["error on the holdout turn", "rms [electrical deg]", "less the separated motion"]
        rows = [[names[n], *(f"{degrees(v):.2f}" for v in pair)] for n, pair in found.left.items()]
        left = [Table(head, rows, "errors on the holdout turn")]
    shown: list[Wave] = []
    for verdict in (MOTION, OPEN, SENSOR):
        shown += found.verdicts(verdict)[:SHOWN]
    rows = []
    for w in shown:
        none = w not in found.kept or (w.verdict == OPEN and found.reference == NONE)
        sensor = "not in the table" if none else _size(result, w.sensor, w.std)
        motion = "" if w.motion is None else _size(result, w.motion, w.motion_std)
        rows.append([str(w.per_turn), number(w.per_turn / found.pairs), sensor, motion, READING[w.verdict]])
    rest = len(found.kept) - len([w for w in shown if w in found.kept])
    head = ["wave per turn", "per period", "sensor [el. deg]", "motion [el. deg]", "verdict"]
    waves = Table(head, rows, "amplitude of each wave in electrical degrees", wordy=(4,))
    return Content(
        f"Table of {fit.model.name} without a reference",
        result.sentence,
        [
            Section("waves", "Waves", [waves, *([f"and {counted(rest, 'wave')} more"] if rest > 0 else [])]),
            Section("notes", "Notes", [
                *(f"to separate them: {text}" for text in separated_by(found)),
                *(f"note: {note}" for note in fit.notes),
            ]),
        ],
        ["", basis, *left],
        columns=_columns(result),
        pictures={"waves": lambda log: waves_figure(result)},
        seconds=found.seconds,
    )  # fmt: skip


def _columns(found: SelfFit) -> dict[str, list[Any]]:
    """Return the waves as columns."""
    rows = [w.to_dict(found.found.pairs) for w in found.found.waves]
    return {key: [row[key] for row in rows] for key in rows[0]}


def _size(result: SelfFit, value: complex, std: float | None) -> str:
    size = electrical(result.found, value)
    return f"{size:.3f}" if std is None else f"{size:.3f} +- {electrical(result.found, std):.3f}"


def ring_fleet_content(found: RingFleet) -> Content:
    """Return drive and heads, rings to look at, rings best first."""
    jig, fleet, pairs = found.jig, found.fleet, found.pairs
    heads = [str(h + 1) for h in jig.heads]
    places = ", ".join(f"{degrees(p):.3f}" for p in jig.places)
    basis = (
        f"{counted(len(fleet.rows), 'ring')}; Halls {', '.join(heads)} see one "
        f"field, at {places} mechanical deg from Hall {heads[0]}"
    )
    ripple = [
        [str(n), f"{degrees(abs(c) * pairs):.3f} +- {degrees(s * pairs):.3f}"]
        for n, c, s in zip(jig.orders, jig.ripple, found.ripple_std, strict=True)
    ]
    said = fleet_content(fleet)
    left = [(str(r["device"]), float(r["left_rad"])) for r in fleet.rows if r.get("left_rad") is not None]
    rings: list[Block | str] = []
    if left:
        middle, most = map(degrees, np.percentile([v for _, v in left], [50, 95]))
        rings.append(
            f"error on the holdout turn, less the drive's ripple: median {middle:.2f}, 95 % {most:.2f} "
            "electrical deg"
        )
        ends = [left[0], left[len(left) // 2], left[-1]]
        words = ("best", "median", "worst")
        rings += [f"  {w}: {d}, {degrees(v):.2f}" for w, (d, v) in zip(words, ends, strict=True)]
    drive = Table(["ripple of the drive, per turn", "[electrical deg]"], ripple, "ripple of the drive")
    return replace(
        said,
        answer=found.sentence,
        first=["", basis, drive, *said.first],
        sections=[*said.sections, Section("rings", "Rings", rings)],
    )


def turns_content(found: TurnPlan) -> Content:
    """Return the plan of turns: open waves, turns, speeds."""
    places = ", ".join(number(degrees(p), 4) for p in found.places)
    where = f"Halls at {places} deg (mechanical) over {counted(found.pairs, 'pole pair')}"
    answer = f"{where} leave none of the waves 1 to {len(found.seen)} per turn open."
    if found.open:
        named = listed([str(n) for n in found.open])
        answer = (
            f"{where} leave {'wave' if len(found.open) == 1 else 'waves'} {named} per turn open: n p is near "
            "a multiple of 360 deg for all of them. Only the motion separates these: a rotor that coasts at "
            "two speeds, or one Hall more at another angle. Reversing does not."
        )
    weak = np.argsort(found.seen)[:6]
    rows = [[str(n + 1), "open" if n + 1 in found.open else f"{1 / found.seen[n]:.1f}"] for n in sorted(weak)]
    ratios = ", ".join(f"{two_speeds(r):.2f} at ratio {r:g}" for r in RATIOS)
    blocks: list[Block | str] = [
        Table(
            ["weakest waves per turn", "error over that of a difference of two Halls"], rows, "weakest waves"
        ),
        f"torque ripple by two speeds, error over that of one: {ratios}",
    ]
    if found.density is None:
        blocks.append("turns: not known before a recording; give one with --after LOG --accuracy 0.01deg")
    else:
        errors = [[str(n), f"{degrees(found.error(n) or 0.0):.4f}"] for n in TURNS]
        blocks.append(Table(["turns", "rms of the table [mechanical deg]"], errors, "turns"))
        if found.target is not None:
            target = number(degrees(found.target), 4)
            if found.turns:
                blocks.append(f"{target} deg needs {counted(found.turns, 'turn')}, and one to judge it.")
            else:
                answer = f"{_out_of_reach(found, target)} {answer}"
    by_wave = {"per_turn": [n + 1 for n in range(len(found.seen))], "seen": found.seen.tolist()}
    return Content("Plan of turns", answer, [Section("turns", "Turns", blocks)], columns=by_wave)


def _out_of_reach(found: TurnPlan, target: str) -> str:
    """Return why no number of turns gives an accuracy, and which one is within reach."""
    lasting = np.zeros(1) if found.lasting is None else found.lasting
    k = int(np.argmax(lasting))
    share = percent(float(lasting[k] / found.least) ** 2)
    return (
        f"No number of turns gives {target} deg: {number(degrees(found.least), 3)} deg stay, of which wave "
        f"{k + 1} per turn makes {share}, since the Halls tell the ripple of the motion from the table no "
        "better; another place of a Hall, one Hall more, or Halls of less noise lower it."
    )


# -- picture: the table over the turn, and wave by wave -------------------------------------------------


def waves_figure(result: SelfFit) -> p.Picture:
    """Return the table over the turn with the ripple left out, and the amplitude and verdict of each wave."""
    found = result.found
    degrees = np.degrees(1.0) * found.pairs
    orders, every = (np.array([w.per_turn for w in waves]) for waves in (found.kept, found.waves))
    angle = np.linspace(0, 2 * np.pi, max(720, 8 * int(every.max())))
    table = degrees * columns(angle, orders) @ coefficients(found.table)
    turn: list[p.Layer] = [p.line(np.degrees(angle), table, p.AFTER, "table")]
    motion = np.array([w.motion if w.verdict == MOTION and w.motion else 0j for w in found.waves])
    if motion.any():
        ripple = degrees * columns(angle, every) @ coefficients(motion)
        turn.append(p.line(np.degrees(angle), ripple, p.BEFORE, "motion, left out"))
    errors = degrees * np.array([np.nan if w.std is None else w.std for w in found.kept])
    size, pale = degrees * np.abs(found.table), p.Look(p.BLUE, p.PALE_BLUE)
    waves = [
        p.boxes(orders - 0.4, orders + 0.4, 0.0, size, pale, f"table ({SENSOR})"),
        p.line(orders, errors, p.GREY, "standard error"),
    ]
    for verdict, look in (
        (MOTION, p.Look(p.ORANGE, p.ORANGE, marker="v", size=6.0)),
        (OPEN, p.Look(p.INK, marker="x", size=6.0)),
    ):
        own = found.verdicts(verdict)
        if own:
            size = [degrees * abs((w.motion if verdict == MOTION else w.sensor) or 0) for w in own]
            waves.append(p.points([w.per_turn for w in own], size, look, verdict))
    drawn = (
        (p.Axis("mechanical angle [deg]", 0.0, 360.0, most=8), p.Axis("correction [electrical deg]"), turn),
        (
            p.Axis("waves per mechanical turn", 0.0, every.max() + 1.0, most=8),
            p.Axis("amplitude [electrical deg]", low=0.0),
            waves,
        ),
    )
    return p.Picture([p.Panel(*parts, height=150.0) for parts in drawn], across=1)
