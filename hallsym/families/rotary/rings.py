"""A magnetised ring of P pole pairs, or a magnet on a shaft (P = 1), read by several linear Halls.

    reading_k = V_k + A_k f(angle + zero + place_k),  f(theta) = cos(P theta) + harmonics

All angles are mechanical and all waves are counted per mechanical turn: n waves per turn are n / P per period
of the field. `place_k` is the angle between Hall k and Hall 1 along the ring, modulo a period. The readings
repeat with each period: alone they give the angle within one, of 2 pi / P.

Readings in the unit of their columns (counts, V, T), angles in rad. Valid for any number of turns.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from hallsym.errors import InputError, require
from hallsym.families.mechanisms import free, started
from hallsym.families.rotary.models import POSE, REFERENCES, TURN, ZERO, phasor
from hallsym.families.rotary.waves import Wave
from hallsym.log import Meta
from hallsym.model import Family, Model, Parameter, Signals, effect
from hallsym.toml import Table, number
from hallsym.units import si_symbol

RING = Family("ring")
"""Of these models; the package puts the whole record here."""
HEADS = r"hall\d+_(count|v|t)"
"""Columns that are read as Halls over a ring."""
MOST_PAIRS, MOST_WAVES = 1000, 400


@dataclass(frozen=True)
class Head:
    """A Hall over a ring: its column, its place [rad] along the ring, and the pole pairs of the ring."""

    channel: str
    place_rad: float
    pole_pairs: int

    @property
    def label(self) -> str:
        """Name in messages and parameters: `hall2_count` is 2."""
        return self.channel.removeprefix("hall").rpartition("_")[0]

    @property
    def entry(self) -> dict[str, Any]:
        """The Hall as a saved calibration describes it."""
        return {"channel": self.channel, "place_rad": self.place_rad, "pole_pairs": self.pole_pairs}


def heads(count: int = 3, pairs: int = 1, unit: str = "count") -> tuple[Head, ...]:
    """Return Halls that share a period evenly."""
    return tuple(Head(f"hall{k + 1}_{unit}", TURN * k / count / pairs, pairs) for k in range(count))


def pole_pairs(model: Model) -> int:
    """Return the pole pairs of a model's ring."""
    return int(model.layout[0].pole_pairs)


@cache
def rings3(layout: tuple[Head, ...] | None = None) -> Model:
    """Return a ring read by Halls, three unless the machine states others: offset, amplitude, place of each.

    Parameters V_k, A_k [unit of the readings], place_k [rad] of all Halls but the first, and zero [rad].
    """
    halls = heads() if layout is None else tuple(layout)
    pairs = halls[0].pole_pairs if halls else 1
    if len(halls) < 2 or not all(h.pole_pairs == pairs and re.fullmatch(HEADS, h.channel) for h in halls):
        raise InputError(
            "A ring is read by two Halls at least, hall1_count, hall2_count, ... (or in v, t), over the same "
            f"pole pairs; instead received {', '.join(h.channel for h in halls) or 'nothing'}."
        )
    labels = [h.label for h in halls]

    def field(s: Signals, p: Mapping[str, ca.SX]) -> None:
        s["pairs"] = pairs
        s["cosine"], s["sine"] = Wave({pairs: (ca.SX(1), ca.SX(0))}), Wave({pairs: (ca.SX(0), ca.SX(1))})

    def transducer(s: Signals, p: Mapping[str, ca.SX]) -> None:
        for k in labels:
            seen = s["cosine"] if k == labels[0] else s["cosine"].ahead(p[f"place_{k}"])
            s[f"v_{k}"] = seen * p[f"A{k}"] + p[f"V{k}"]
        s["gain"] = ca.vertcat(*(p[f"A{k}"] for k in labels))

    def read(s: Signals, p: Mapping[str, ca.SX]) -> None:
        own = [s[f"v_{k}"] for k in labels]
        if "table" not in s:
            s["reading"] = ca.vertcat(*(v.ahead(p["zero"]).of(s, POSE[0]) for v in own))
            return
        u = s[POSE[0]] + p["zero"]
        u = u + s["table"].at(u)
        s["reading"] = ca.vertcat(*(v.at(u) for v in own))

    def begin(v: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
        """The angle within a period from the plane of the readings, by least squares over all Halls."""
        phases = [pairs * p[f"place_{k}"] if k != labels[0] else ca.SX(0) for k in labels]
        rows = ca.vertcat(*(
            ca.horzcat(p[f"A{k}"] * ca.cos(a), -p[f"A{k}"] * ca.sin(a))
            for k, a in zip(labels, phases, strict=True)
        ))  # fmt: skip
        rest = v - ca.vertcat(*(p[f"V{k}"] for k in labels))
        normal, right = rows.T @ rows, rows.T @ rest  # its determinant is positive: only ratios count
        c = normal[1, 1] * right[0] - normal[0, 1] * right[1]
        s = normal[0, 0] * right[1] - normal[1, 0] * right[0]
        return ca.atan2(s, c) / pairs - p["zero"]

    period = TURN / pairs
    unit = {h.channel: si_symbol(h.channel) for h in halls}
    parameters = [
        Parameter(f"{letter}{h.label}", float(letter == "A"), low, 1e6, unit[h.channel], f"{what} {h.label}")
        for h in halls
        for letter, low, what in (("V", -1e6, "offset of Hall"), ("A", 1e-6, "amplitude of Hall"))
    ]
    for h in halls[1:]:
        gap = h.place_rad - halls[0].place_rad
        about = f"angle along the ring from Hall {labels[0]} to Hall {h.label}"
        parameters.append(
            Parameter(f"place_{h.label}", gap, gap - period / 2, gap + period / 2, "rad", about)
        )
    zero = Parameter("zero", 0.0, -period, period, "rad", ZERO.meaning)
    return Model(
        name="rings3",
        family=RING,
        pose=POSE,
        references=REFERENCES,
        state=(),
        channels=tuple(h.channel for h in halls),
        parameters=(*parameters, zero),
        steps=(("mechanics", field), ("transducer", transducer), ("electronics", read)),
        layout=halls,
        closed_form=closed_form,
        period=dict.fromkeys((*POSE, *REFERENCES, "zero"), period),
        amplitudes=tuple(f"A{k}" for k in labels),
        begin=begin,
        typical=tuple((k * period / 16,) for k in range(16)),
    )


def closed_form(model: Model, coefficients: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return parameters from the mean and the fundamental of each reading: exact without harmonics."""
    found, pairs, first = model.named(model.nominal), pole_pairs(model), 0.0
    for k, head in enumerate(model.layout):
        wave = phasor(coefficients, pairs, k)
        level = coefficients.get("1")
        found[f"V{head.label}"] = 0.0 if level is None else float(level[k])
        found[f"A{head.label}"] = max(abs(wave), 1e-6)
        if k == 0:
            first = float(np.angle(wave))
            found["zero"] = first / pairs
        else:
            nominal = found[f"place_{head.label}"]
            phase = np.angle(wave * np.exp(-1j * (first + pairs * nominal)))
            found[f"place_{head.label}"] = nominal + float(phase) / pairs
    return np.array([found[name] for name in model.names])


def from_meta(make: Callable[..., Model], meta: Meta) -> Model:
    """Return the model for the Halls that a machine, a calibration or the columns of a log state.

    `[encoder] pole_pairs` and `[[probes]] channel, place_rad` of a machine file or of meta.json; a place that
    is not stated shares the period evenly. Columns hall1_..., hall2_..., ... of a log else.
    """
    stated = Table(meta.raw, "the machine").table("encoder", ("pole_pairs",))
    columns = sorted((c for c in meta.columns if re.fullmatch(HEADS, c)), key=lambda c: (len(c), c))
    entries = meta.probes or [{"channel": c} for c in columns or [h.channel for h in heads()]]
    pairs = stated.whole("pole_pairs", entries[0].get("pole_pairs", meta.nominal.get("pole_pairs", 1)))
    require(pairs <= MOST_PAIRS, "pole_pairs of a ring", f"at most {MOST_PAIRS}", pairs)
    layout = []
    for k, entry in enumerate(entries):
        place = entry.get("place_rad", TURN * k / len(entries) / pairs)
        place = number(place, "place_rad", f"Hall {entry.get('channel')}")
        layout.append(Head(str(entry.get("channel")), place, pairs))
    return started(make(tuple(layout)), {k: v for k, v in meta.nominal.items() if k != "pole_pairs"})


# -- effects ---------------------------------------------------------------------------------------------


@effect(link="field", diagnosed=False)
def turn_waves(model: Model, count: int = 12, step: int = 1) -> Model:
    """A table of the angle over the mechanical turn, whatever its cause.

    It holds `count` waves per turn: `step`, 2 `step`, ... The field that is read at an angle is that of angle
    + sum_n t_nc cos(n angle) + t_ns sin(n angle), angles from the encoder's own zero. Exact for any size that
    keeps the sum growing. With the pole pairs as `step` the table is one of the period, which needs no
    counting of periods.
    """
    fitting = count >= 1 and step >= 1 and count * step <= MOST_WAVES
    require(fitting, "count times step of turn_waves", f"1 to {MOST_WAVES}", count * step)
    orders = range(step, count * step + 1, step)
    meanings = {
        f"t{n}{part}": f"{n} waves per turn of the angle that is read" for n in orders for part in "cs"
    }
    new = free(meanings, 1.0 / pole_pairs(model), "rad")

    def bent(s: Signals, p: Mapping[str, ca.SX]) -> None:
        s["table"] = Wave({n: (p[f"t{n}c"], p[f"t{n}s"]) for n in orders})

    return model.with_step("field", bent, effect="turn_waves", parameters=new)


@effect(link="mechanics", separate="a turn with the ring mounted at each of several other angles")
def eccentricity(model: Model) -> Model:
    """The ring is off the axis: field strength and pitch at the Halls change once per turn.

    Waves P - 1 and P + 1 per turn of the field, each with a free amplitude and phase.
    """
    pairs = pole_pairs(model)
    names = [f"eccentricity_{n}_{part}" for n in (pairs - 1, pairs + 1) for part in ("c", "s")]
    names = [name for name in names if name != "eccentricity_0_s"]

    def step(s: Signals, p: Mapping[str, ca.SX]) -> None:
        for n in (pairs - 1, pairs + 1):
            c, d = p[f"eccentricity_{n}_c"], p.get(f"eccentricity_{n}_s", ca.SX(0))
            s["cosine"] = s["cosine"] + Wave({n: (c, d)})
            s["sine"] = s["sine"] + Wave({n: (-d, c)})

    new = free(dict.fromkeys(names, "field of the ring off the axis, relative to the fundamental"), 0.5, "1")
    return model.with_step("mechanics", step, effect="eccentricity", parameters=new)
