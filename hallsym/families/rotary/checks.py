"""Pre-fit checks of an encoder's log, and claims on its fit: turns, zero, ellipse."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hallsym.log import UNRELATED, Fault
from hallsym.log.phase import unwrapped
from hallsym.model import Inspection, Model

# -- sums over a log that tell how an encoder follows its reference: turns and sectors -------------------

BINS = 72
"""Sectors of a turn: 5 deg each."""
MANY = 65536
"""Samples from which the middle and the extent of a voltage are found."""
EDGE = 0.02
"""Share of the samples at either end that may be spikes."""


@dataclass(frozen=True, eq=False)
class Seen:
    """Sums over a log, of angles and references in radians.

    `runs`: of each run samples and sums of exp(i (angle - reference)) and exp(i (angle + reference)), (3,).
    `sectors`: which ones of a turn the reference and the angle were in, (2, BINS). `moved`: travel of the
    reference up and down. `even`: sum of exp(2 i |step|) over its steps: short where they are of all lengths.
    """

    runs: Mapping[int, np.ndarray]
    sectors: np.ndarray
    moved: np.ndarray
    even: complex

    def follows(self, k: int, *, each: bool) -> float:
        """Return the length of the mean of exp(i (angle - k reference)), of runs by themselves or of all."""
        sums = np.transpose(list(self.runs.values()))
        return float((np.abs(sums[k]).sum() if each else abs(sums[k].sum())) / sums[0].real.sum())


def seen_of(model: Model, log: Any) -> Seen:
    """Go over a log once (twice for voltages, whose middle and extent come first)."""
    scales = _scales(model, log) if len(model.channels) == 2 else []
    (column,), runs = model.references, dict[int, np.ndarray]()
    sectors, moved, even = np.zeros((2, BINS), dtype=bool), np.zeros(2), 0j
    for block in log.blocks((*model.channels, column)):
        values, reference = [block.data[c] for c in model.channels], block.data[column]
        if scales:
            values = [np.arctan2(*((v - a) / half for v, (a, half) in zip(values, scales, strict=True)))]
        angle = values[0]
        waves = np.exp(1j * np.array([0 * angle, angle - reference, angle + reference]))
        runs[block.run] = runs.get(block.run, 0) + waves.sum(axis=1)
        for bins, turned in zip(sectors, (reference, angle), strict=True):
            bins[np.floor(turned * (BINS / (2 * np.pi))).astype(int) % BINS] = True
        steps = np.diff(unwrapped(reference, 2 * np.pi))
        even += complex(np.exp(2j * np.abs(steps)).sum())
        moved += np.maximum(steps, 0.0).sum(), np.maximum(-steps, 0.0).sum()
    return Seen(runs, sectors, moved, even)


def _scales(model: Model, log: Any) -> list[tuple[float, float]]:
    """Middle and half of the extent of each voltage, spikes aside: near enough to count turns by."""
    every, found = max(1, log.rows // MANY), []
    for block in log.blocks(model.channels):
        found.append(np.array([block.data[c][::every] for c in model.channels]))
    low, high = np.quantile(np.concatenate(found, axis=1), [EDGE, 1 - EDGE], axis=1)
    return [(float(a + b) / 2, float(b - a) / 2 or 1.0) for a, b in zip(low, high, strict=True)]


# -- what is said of an encoder's log ------------------------------------------------------------------------

TOGETHER = 0.75
"""An encoder follows its reference within a run if the mean of exp(i (angle - reference)) is longer: 43 deg
of scatter, far beyond any offset, gain or clipping."""
GAP_NOTE, GAP_REFUSE = 30.0, 120.0
"""Widest part of a turn [deg] without a sample: above the one a note, above the other a refusal."""
FOLLOWS = 0.5
"""An encoder follows its reference if the mean of exp(i (angle - reference)) is longer than this."""
CLEARLY, LEAST_ZERO = 3.0, 1.0
"""Least difference of the offsets of runs for a note: in scatters of the angle within a run, and in deg."""
ORDERED = 0.3
"""Length of the mean of exp(2 i |step|) below which rows follow no motion."""


def inspect(model: Model, log: Any, *, fitted: bool = True) -> Inspection:
    """Return an encoder's direction, notes on what its log does not determine, and claims on the log.

    `fitted` False: the log is only judged, for which a part of a turn is enough.
    """
    seen, (column,) = seen_of(model, log), model.references
    own = bool(model.offsets)  # a zero for each run
    straight, alone = (max(seen.follows(k, each=each) for k in (1, -1)) for each in (own, True))
    homed = straight < FOLLOWS < alone and len(seen.runs) > 1
    (gap, other), notes = map(_gap, seen.sectors), list[str]()
    if fitted and gap > GAP_REFUSE and other > GAP_REFUSE:
        text = (
            f"Column {column} of {log.name} covers only {360 - gap:.0f} deg of a turn; offset, gain and "
            "phase show once and twice per turn, so record at least one full turn, or check its unit."
        )
        notes.append(Fault(text, "part_of_a_turn", (column,)))
    if not homed and alone < (TOGETHER if gap < GAP_REFUSE else FOLLOWS):
        text = (
            f"The encoder in {log.name} does not follow {column} (their difference is spread over the turn); "
            "it does not belong to these readings: check file, clock, columns and units."
        )
        notes.append(Fault(text, UNRELATED, (column,)))
    forward = homed or bool(notes) or seen.follows(1, each=own) >= seen.follows(-1, each=own)
    guessed = fitted and "t_s" not in log.columns and column not in log.noise
    if guessed and abs(seen.even) < ORDERED * (log.rows - len(seen.runs)):
        text = (
            f"Rows of {log.name} are in no order ({column} moves by anything from one to the next), so the "
            f"noise cannot be estimated: sort them by {column}, or state the noise with --noise."
        )
        notes.append(Fault(text, "order", (column,)))
    if gap > GAP_NOTE:
        notes.append(f"No sample lies in {gap:.0f} deg of the turn: results for that part are extrapolated.")
    if seen.moved.min() < 0.05 * seen.moved.sum():
        lost = "hysteresis looks like another zero and is not observable; record both directions to tell it."
        if "t_s" in log.columns:
            lost = (
                "latency and hysteresis look like another zero and are not observable (latency is, as far as "
                "the speed changes); record both directions to tell them."
            )
        notes.append(f"{column} turns in one direction only: {lost}")
    notes += [] if own else _homed(seen, column, 1 if forward else -1, homed)
    if not forward:
        channel = model.channels[0]
        swapped = ", or the two voltages are swapped" if len(model.channels) == 2 else ""
        notes.append(
            f"The encoder turns against {column} (its other side faces the reference{swapped}); {channel} is "
            "taken with its sign reversed."
        )
    return Inspection(tuple(notes), () if forward else model.channels[:1])


def _homed(seen: Seen, column: str, sign: int, homed: bool) -> Iterator[str]:
    """Report offsets of runs that clearly differ: a claim if the encoder follows within runs only."""
    first = next(iter(seen.runs))
    offsets = {run: np.angle(k[sign] / seen.runs[first][sign]) for run, k in seen.runs.items()}
    length = [abs(k[sign]) / k[0].real for k in seen.runs.values()]
    spread = float(np.sqrt(max(-2 * np.log(max(np.median(length), 1e-9)), 0.0)))
    far = max(offsets, key=lambda run: abs(offsets[run]))
    if not homed and abs(offsets[far]) < max(CLEARLY * spread, np.radians(LEAST_ZERO)):
        return
    text = (
        f"The zero of {column} differs between runs, by {np.degrees(abs(offsets[far])):.3g} deg in run {far} "
        f"beside run {first}: if it was homed anew, --effect zero_deviation gives each run its own; latency, "
        "another scale of the reference or inverted voltages make differences too."
    )
    yield Fault(text, "homed", (column,)) if homed else text


def _gap(bins: np.ndarray) -> float:
    """Widest run of empty sectors around the turn [deg]."""
    at = np.flatnonzero(bins)
    return float(np.diff([*at, at[0] + BINS]).max() - 1) * 360.0 / BINS if len(at) else 360.0


# -- what is said of its fit ---------------------------------------------------------------------------------

UNEQUAL = 3.0
"""Ratio of the amplitudes of two plates beyond any encoder: sensitivities of one lot are within a tenth, and
a plate at twice the distance from the magnet sees half the field."""
NEAR = 1.2
"""Factor within which a ratio is a power of ten."""


def implausible(fit: Any) -> Iterator[Fault]:
    """Yield the claim that the ellipse of two voltages is longer than that of any encoder."""
    if not {"Ay", "Ax"} <= set(fit.model.names) or len(fit.model.channels) != 2:
        return
    sizes = np.abs([fit.value("Ay"), fit.value("Ax")])
    ratio = float(sizes.max() / sizes.min())
    if ratio < UNEQUAL:
        return
    power = 10.0 ** np.round(np.log10(ratio))
    # of the two the one that is farther from 1 V is the scaled one: only their ratio counts
    k = int(np.argmax(np.abs(np.log(sizes))))
    factor = 1 / power if k == int(np.argmax(sizes)) else power
    # an amplitude makes up for a scale: what else the fit leaves is another mistake, and its ratio tells none
    alone = 1 / NEAR < ratio / power < NEAR and not (fit.goodness and fit.goodness.material)
    correction = f"scale {fit.model.channels[k]} {factor:.9g}" if alone else None
    remedy = f" undo it with --correct '{correction}'." if correction else ""
    yield Fault(
        f"The amplitudes of {' and '.join(fit.model.channels)} differ by a factor of {ratio:.3g}, an ellipse "
        f"that no encoder makes: are both in the same unit?{remedy}",
        "scale", fit.model.channels, correction=correction,
    )  # fmt: skip
