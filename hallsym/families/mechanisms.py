"""Mechanisms that several families share, each written once: an effect of a family is one call of them.

A family states its ports (the values of its channels along the chain); a mechanism changes what passes
there. New parameters are 0 where the effect is absent.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from math import pi
from types import MappingProxyType
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from hallsym.errors import require
from hallsym.families.faults import inject_rails
from hallsym.model import Effect, Facts, Model, Parameter, Signals, effect
from hallsym.model.arguments import POSITIVE, Number, Try, beside, found, from_log, one_of, searched
from hallsym.model.derived import Computed, Stretch, campaign_time, rate
from hallsym.toml import number

P = Mapping[str, ca.SX]
"""Parameters of a step, by name."""


def free(meanings: Mapping[str, str], limit: float, unit: str) -> tuple[Parameter, ...]:
    """Return parameters (name -> meaning) that are 0 where the effect is absent, between -limit and limit."""
    return tuple(Parameter(name, 0.0, -limit, limit, unit, meaning) for name, meaning in meanings.items())


def started(model: Model, nominal: Mapping[str, Any], *others: Model) -> Model:
    """Return the model with the nominal values that a log states; a text is a fact for a reader.

    Values of parameters that only the `others` of a family have are left out. Raises `InputError` for a value
    that is no number, and for one of no parameter.
    """
    known = list(dict.fromkeys(name for m in (model, *others) for name in m.names))
    stated = {k: v for k, v in nominal.items() if k in known or not isinstance(v, str)}
    for key in stated:
        require(key in known, "A nominal value", f"that of a parameter of {model.name}", key, known)
    numbers = {k: number(v, k, "the nominal values") for k, v in stated.items()}
    return model.with_parameters({k: {"nominal": v} for k, v in numbers.items() if k in model.names})


# -- terms that each channel has a coefficient of -----------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Port:
    """The values of all channels at one place of the chain: an expression, or a wave, for each label."""

    labels: Callable[[Model], Sequence[str]]
    read: Callable[[Signals], Sequence[Any]]
    write: Callable[[Signals, Sequence[Any]], None]


def port(signal: str, labels: Callable[[Model], Sequence[str]]) -> Port:
    """Return the port of a signal that is a column with one entry per channel."""

    def write(s: Signals, values: Sequence[Any]) -> None:
        s[signal] = ca.vertcat(*values)

    return Port(labels, lambda s: ca.vertsplit(s[signal]), write)


Terms = Callable[[Signals, P], Callable[[Any, int], Sequence[Any]]]
"""`terms(signals, parameters)(value, k)`: the terms of channel k, of which each has a coefficient."""


def add_terms(
    model: Model,
    effect: str,
    link: str,
    port: Port,
    coefficients: Mapping[str, str],
    terms: Terms,
    limit: float,
    unit: str,
    *columns: str | Computed,
    by_channel: bool = True,
    only: Sequence[str] | None = None,
    shared: bool = False,
    own: Sequence[Parameter] = (),
) -> Model:
    """Return the model in which each value of `port` gains the sum of coefficient times term.

    `coefficients`: name -> meaning, one for each term, `{k}` standing for the label of the channel; they
    lie between -limit and limit, ordered by channel, else by term. `columns` are what the terms read,
    `only` the channels that have them (all by default). `shared`: all channels have the same coefficients,
    whose names say `all` in place of a channel. `own`: parameters of the terms.
    """
    labels = port.labels(model)
    used = labels if only is None else only
    owners = ["all"] if shared else used
    pairs = (
        [(n, k) for k in owners for n in coefficients]
        if by_channel
        else [(n, k) for n in coefficients for k in owners]
    )
    new = [Parameter(n.format(k=k), 0.0, -limit, limit, unit, coefficients[n].format(k=k)) for n, k in pairs]

    def step(s: Signals, p: P) -> None:
        values, of = list(port.read(s)), terms(s, p)
        for k, label in enumerate(labels):
            if label in used:
                for name, term in zip(coefficients, of(values[k], k), strict=True):
                    values[k] = values[k] + term * p[name.format(k="all" if shared else label)]
        port.write(s, values)

    return model.with_columns(*columns).with_step(link, step, effect=effect, parameters=(*new, *own))


def power(value: Any, n: int, unit: float) -> Any:
    """Return value^n / unit^(n - 1), also of a wave."""
    if isinstance(value, ca.SX):
        return value**n / unit ** (n - 1)
    out = value
    for _ in range(n - 1):
        out = out * value * (1 / unit)
    return out


ORDERS = {2: "square", 3: "cubic", 4: "fourth-power", 5: "quintic"}


def nonlinearity(
    model: Model,
    effect: str,
    link: str,
    port: Port,
    powers: Mapping[str, int],
    limit: float,
    unit: float,
    *,
    by_channel: bool = True,
    shared: bool = False,
) -> Model:
    """Each value v becomes v + sum of c v^n / unit^(n - 1), c per channel; `powers`: name of c -> n."""
    coefficients = {
        name: f"{ORDERS[n]} deviation of {{k}} from a line, relative at {unit:g}"
        for name, n in powers.items()
    }

    def terms(s: Signals, p: P) -> Callable[[Any, int], Sequence[Any]]:
        return lambda value, k: [power(value, n, unit) for n in powers.values()]

    return add_terms(
        model, effect, link, port, coefficients, terms, limit, "1", by_channel=by_channel, shared=shared
    )


def bends(
    what: str,
    link: str,
    port: Port,
    limit: float,
    unit: Callable[[Model], float],
    odd: Mapping[str, Any],
    even: Mapping[str, Any],
    *,
    by_channel: bool = True,
    by_place: bool = False,
) -> tuple[Effect, Effect]:
    """Return the effects of `nonlinearity` in odd powers and in even ones; `what`: is bent, in words.

    `odd`, `even`: about each effect. Coefficients are numbered by their power, or `by_place` from 0.
    """

    def made(name: str, words: Mapping[int, str], about: Mapping[str, Any]) -> Effect:
        def bent(model: Model, order: int) -> Model:
            powers = list(words)[: order // 2]
            names = {f"{name}{j if by_place else n}_{{k}}": n for j, n in enumerate(powers)}
            return nonlinearity(model, name, link, port, names, limit, unit(model), by_channel=by_channel)

        first = next(iter(words.values())).capitalize()
        meaning, numbers = (
            f"{first} deviation of {what} from a line.",
            {"order": one_of(words, "highest power")},
        )
        return effect(link=link, name=name, meaning=meaning, numbers=numbers, **about)(bent)

    cubic, square = {3: "cubic", 5: "cubic and quintic"}, {2: "square", 4: "square and fourth power"}
    return made("odd_nonlinearity", cubic, odd), made("even_nonlinearity", square, even)


def clipping(model: Model, port: Port, low: Sequence[float], high: Sequence[float]) -> Model:
    """Readings beyond `low` and `high`, one per channel, lose the share that is the parameter (1: hard)."""

    def beyond(value: ca.SX, k: int) -> list[ca.SX]:
        over = ca.fmax(value - high[k], 0) if np.isfinite(high[k]) else ca.SX(0)
        under = ca.fmax(low[k] - value, 0) if np.isfinite(low[k]) else ca.SX(0)
        return [under - over]

    cut = {"clipped_{k}": "share of what lies beyond the rail of {k} that is cut off (1: hard)"}
    return add_terms(model, "saturation", "electronics", port, cut, lambda s, p: beyond, 1.5, "1")


CUT = (0.002, 0.01, 0.03, 0.07)
"""Shares of the samples that a rail is tried to cut off, at either end."""


def rails(low: str, high: str, *, symmetric: bool) -> Callable[[Model, Facts], list[Try]]:
    """Return the rule that finds rails, named `low` and `high`: where readings repeat, and those of `CUT`.

    `symmetric`: both rails of a channel are as far from zero.
    """

    def tries(model: Model, facts: Facts) -> list[Try]:
        out = []
        if np.isfinite(facts.rails).any():
            below, above = np.array(facts.rails).T.tolist()
            out.append(Try({low: below, high: above}, "where readings repeat", shapes=1))
        for k, (above, below) in enumerate(zip(facts.extremes[0::2], facts.extremes[1::2], strict=True)):
            if symmetric:
                above = np.maximum(above, -below)
                below = -above
            numbers = {low: below.tolist(), high: above.tolist()}
            out.append(Try(numbers, f"rails, try {k + 1}", shapes=1, tried=len(CUT)))
        return out

    return tries


def saturation(unit: str, what: str, port: Port, separate: str) -> Effect:
    """Return the effect that readings [`unit`] stop at a rail, one per channel; `what` is read: "probe"."""
    low, high = f"low_{unit}", f"high_{unit}"
    highest = found(rails(low, high, symmetric=True), f"highest reading of each {what}")
    numbers = {low: beside(f"lowest reading of each {what}"), high: highest}

    def stop(model: Model, **rail: Sequence[float]) -> Model:
        wanted, lengths = len(model.channels), [len(rail[low]), len(rail[high])]
        require(
            lengths == [wanted] * 2, "Rails of saturation", f"{wanted} numbers each, with / between", lengths
        )
        return clipping(model, port, rail[low], rail[high])

    return effect(
        link="electronics", name="saturation", meaning="Readings stop at a rail.", inject=inject_rails,
        numbers={name: replace(n, kind=tuple[float, ...]) for name, n in numbers.items()}, separate=separate,
    )(stop)  # fmt: skip


# -- functions of time, temperature and runs that gains and offsets follow ----------------------------------


MAINS_HZ = (50.0, 60.0)
"""Frequencies of the mains [Hz]."""
MAINS_REACH_HZ = 4.0
"""Distance from these within which hum is looked for [Hz]: EN 50160 allows 47 Hz, and a clock may be off."""


class Functions(NamedTuple):
    """Functions of data: what each is, their values, the columns and the `parameters` that they read."""

    meanings: Sequence[str]
    values: Callable[[Signals, P], Sequence[ca.SX]]
    columns: Sequence[str | Computed] = ()
    parameters: Sequence[Parameter] = ()


def column(made: Computed, meaning: str) -> Functions:
    """Return a computed column as a function."""
    return Functions([meaning], lambda s, p: [s[made.name]], [made])


def following(
    model: Model,
    effect: str,
    link: str,
    port: Port,
    functions: Functions,
    limit: float,
    unit: str,
    *,
    gain: bool = False,
    names: Sequence[str] | None = None,
    by_channel: bool = True,
    only: Sequence[str] | None = None,
    shared: bool = False,
) -> Model:
    """Each value v gains the sum of c f, or of c f v for a `gain`; c per function f and channel, or `shared`.

    `names`: of c, for each function, with `{k}` for the channel; by default the effect's name and a number.
    """

    what = "relative change of the gain" if gain else "offset"
    names = names or [f"{effect}{j}_{{k}}" for j in range(len(functions.meanings))]
    coefficients = {n: f"{what} of {{k}} {f}" for n, f in zip(names, functions.meanings, strict=True)}

    def terms(s: Signals, p: P) -> Callable[[Any, int], Sequence[Any]]:
        values = functions.values(s, p)
        return lambda value, k: [value * f for f in values] if gain else values

    return add_terms(
        model, effect, link, port, coefficients, terms, limit, unit, *functions.columns,
        by_channel=by_channel, only=only, shared=shared, own=functions.parameters,
    )  # fmt: skip


def over_time(duration_s: float, degree: int, settling_s: float | None) -> Functions:
    """Return exp(-t / settling_s), or Legendre polynomials of campaign time of degree 1 to `degree`."""
    time = campaign_time()
    if settling_s is not None:
        return Functions(
            ["at the start, settling"], lambda s, p: [ca.exp(-s[time.name] / settling_s)], [time]
        )

    def legendre(s: Signals, p: P) -> list[ca.SX]:
        x = 2 * s[time.name] / duration_s - 1
        return [x, (3 * x**2 - 1) / 2, (5 * x**3 - 3 * x) / 2][:degree]

    return Functions([f"over the campaign, degree {n}" for n in range(1, degree + 1)], legendre, [time])


def with_temperature(mean_degc: float) -> Functions:
    """Return the logged temperature above its mean."""
    name = "temperature_degc"
    return Functions(["per degC"], lambda s, p: [s[name] - mean_degc], [name])


def switched(model: Model, facts: Facts) -> list[Try]:
    """Return the runs in which an external field may have been on."""
    listed = ", ".join(map(str, facts.on_runs))
    one = Try({"runs": facts.on_runs}, f"on in runs {listed}", shapes=1, tried=facts.on_runs_tried)
    return [one] if facts.on_runs else []


def in_runs(runs: Sequence[int]) -> Functions:
    """Return 1 in some runs, 0 in the others."""

    def rule(s: Stretch) -> np.ndarray:
        return np.full(len(s.data["t_s"]), np.isin(s.run, runs), dtype=float)

    return column(Computed(f"on_in_{'_'.join(map(str, runs))}", (), rule), "in the runs with the field on")


def at_frequency(
    effect: str, frequency_hz: float, harmonics: int = 1, waves: Sequence[str] = ("cos", "sin")
) -> Functions:
    """Return cosine and sine of a frequency and its harmonics over the campaign.

    The frequency is a parameter: its error grows to one of the phase over a long log.
    """
    time, name = campaign_time(), f"{effect}_hz"
    pairs = [(wave, n) for n in range(1, harmonics + 1) for wave in waves]

    def values(s: Signals, p: P) -> list[ca.SX]:
        turn = 2 * pi * p[name] * s[time.name]
        return [getattr(ca, wave)(n * turn) for wave, n in pairs]

    meanings = [f"at {n * frequency_hz:.5g} Hz, {wave} part" for wave, n in pairs]
    ends = frequency_hz - MAINS_REACH_HZ, frequency_hz + MAINS_REACH_HZ
    return Functions(
        meanings, values, [time], [Parameter(name, frequency_hz, *ends, "Hz", "frequency of the mains")]
    )


# -- effects that follow those functions, in one line for a family ------------------------------------------

Follow = Callable[..., Model]
"""`follow(model, effect, functions)`: adds functions of data to gains, or offsets, of a family; with common
coefficients of all channels `follow(model, effect, functions, shared)`."""


def _per(lead: str) -> Any:
    labels = {"all": f"{lead}all channels alike", "channel": f"{lead}channel by channel"}
    return one_of(labels, "one coefficient for all channels or for each")


LINE = searched(
    lambda facts: facts.lines_hz, "mains frequency, as the clock of the log shows it",
    label="{:.5g} Hz", tried=lambda facts: facts.lines_tried,
)  # fmt: skip


WARM = "warm up and cool down, so that temperature is not a function of time"
AGAIN = "the first run again at the end; log the temperature"


def drifts(
    gains: Follow,
    offsets: Follow,
    what: Sequence[str],
    parts: Sequence[int],
    *,
    grid: bool = False,
    per: bool = False,
    separate: Mapping[str, str] = MappingProxyType({}),
    needs: tuple[str, ...] = (),
) -> tuple[Effect, Effect, Effect, Effect]:
    """Return the drifts of gains and of offsets with temperature, then those over the campaign.

    `gains`, `offsets`: how they follow functions of data; `what`: the four in words. Over the campaign they
    follow polynomials, or an exponential: `parts` of the campaign are tried as its time constant, and it may
    lie between them (`grid`). `per`: also try common coefficients of all channels. `separate`: other
    recordings than the usual ones, by name; `needs`: of drifts over the campaign.
    """
    temperature: dict[str, Number] = {"per": _per("")} if per else {}
    temperature["mean_degc"] = from_log(lambda facts: facts.temperature or 0.0, "mean temperature of the log")
    degrees = {n: f"polynomial of degree {n}" for n in (1, 2, 3)}
    time = {
        "duration_s": from_log(lambda facts: facts.duration_s, "length of the campaign", valid=POSITIVE),
        "degree": one_of(degrees, "degree of the polynomial of time"),
        "settling_s": searched(
            lambda facts: [facts.duration_s / n for n in parts],
            "time constant of the exponential that the drift follows instead",
            label="settling, {:.3g} s", instead=True, shapes=1, grid=grid,
        ),
    } | ({"per": _per(", ")} if per else {})  # fmt: skip
    warm = {"separate": WARM, "needs": ("temperature_degc",), "label": "linear"}
    again = {"separate": AGAIN, "needs": needs}

    def made(
        name: str,
        meaning: str,
        follow: Follow,
        numbers: dict[str, Number],
        functions: Any,
        about: dict[str, Any],
    ) -> Effect:
        def drift(model: Model, per: str | None = None, **given: Any) -> Model:
            return follow(model, name, functions(**given), *([per == "all"] if "per" in numbers else []))

        way = separate.get(name, about["separate"])
        known = about | {"link": "transducer", "name": name, "meaning": meaning, "separate": way}
        return effect(**known, numbers=numbers)(drift)

    with_it, over = "the logged temperature.", "smoothly over the campaign."
    return (
        made("gain_temperature_drift", f"{what[0]} {with_it}", gains, temperature, with_temperature, warm),
        made(
            "offset_temperature_drift", f"{what[1]} {with_it}", offsets, temperature, with_temperature, warm
        ),
        made("gain_time_drift", f"{what[2]} {over}", gains, time, over_time, again),
        made("offset_time_drift", f"{what[3]} {over}", offsets, time, over_time, again),
    )


# -- delay and low-pass ------------------------------------------------------------------------------------

DELAY, LOW_PASS = (-1.0, 1 / 2, -1 / 6, 1 / 24), (-1.0, 1.0, -1.0, 1.0, -1.0, 1.0)
"""Factors of tau^n d^n/dt^n: a delay, and 1 / (1 + tau d/dt), whose series converges more slowly.

At tau times angular frequency x a time constant is off by x^6 of itself, .07 % at .3 (four terms: .8 %)."""


def late(
    model: Model,
    effect: str,
    link: str,
    port: Port,
    series: Sequence[float],
    moved: Callable[[Signals, P, int], Sequence[ca.SX]],
    *,
    shared: bool,
    least: float = -0.05,
) -> Model:
    """Values are of the past: each gains the sum of factor tau^n d^n value / dt^n, one tau or one per
    channel.

    `moved(s, p, n)`: the n-th time derivative of each value, from the rates of the reference.
    """
    labels = port.labels(model)
    names = [f"tau_{effect}" if shared else f"tau_{effect}_{k}" for k in labels]
    what = "delay of the readings" if series is DELAY else "time constant of the low-pass"
    new = {
        n: Parameter(n, 0.0, least, 0.05, "s", what if shared else f"{what}, channel {k}")
        for n, k in zip(names, labels, strict=True)
    }

    def step(s: Signals, p: P) -> None:
        values = list(port.read(s))
        for n, factor in enumerate(series, start=1):
            for k, slope in enumerate(moved(s, p, n)):
                values[k] = values[k] + factor * p[names[k]] ** n * slope
        port.write(s, values)

    columns = [rate(c, n) for n in range(1, len(series) + 1) for c in model.references]
    return model.with_columns(*columns).with_step(link, step, effect=effect, parameters=tuple(new.values()))


RESET = 4.0
"""A stroke, over the width, that brings a play to one of its ends from wherever it is."""


class Travel(NamedTuple):
    """A motion `u` (n,) of one or several runs between its turning points.

    `edges`: samples of these and of both ends of each run; `strokes`: from each to the next, `last`: whether
    it is the last of a run; `stroke`, `along`: (n,) on which one each sample lies, and how far along it.
    `moved`: (n,) how far it is from the first sample of its run.
    """

    u: np.ndarray
    edges: np.ndarray
    strokes: np.ndarray
    last: np.ndarray
    stroke: np.ndarray
    along: np.ndarray
    moved: np.ndarray


def travel(u: np.ndarray, edges: Sequence[int] | None = None) -> Travel:
    """Return a motion with its turning points, which are the same for a play of any width.

    `edges`: (runs + 1,) where runs begin and the last one ends; one run by default.
    """
    limits = np.array([0, len(u)] if edges is None else edges)
    first, ends, turning = limits[:-1], limits[1:] - 1, np.zeros(len(u), dtype=bool)
    turning[1:-1] = np.diff(np.sign(np.diff(u))) != 0
    turning[first] = turning[ends] = True
    edge, stroke = np.flatnonzero(turning), np.cumsum(turning) - turning - 1
    stroke[first] += 1
    strokes, last = np.append(np.diff(u[edge]), 0.0), np.isin(edge, ends)
    moved = u - np.repeat(u[first], np.diff(limits))
    return Travel(u, edge, strokes, last, stroke, u - u[edge[stroke]], moved)


def stop_operator(motion: Travel, width: float) -> np.ndarray:
    """Return the elastic part of a play of half-width `width`, -1 to 1, starting each run from 0.

    z follows du / width and stops at +-1: between turning points it has a closed form.
    """
    _, (low, high) = _from_ends(motion, width)
    return np.clip(motion.moved / width, low, high)


def stop_operators(u: np.ndarray, edges: Sequence[int], widths: Sequence[float]) -> np.ndarray:
    """Return `stop_operator` of each row of u (m, n) and each width, (m, widths, n), from 0 at each edge.

    `edges`: (runs + 1,) where runs begin and the last one ends.
    """
    motions = [travel(row, edges) for row in u]
    return np.array([[stop_operator(motion, width) for width in widths] for motion in motions])


def stop_state(motion: Travel, width: float) -> np.ndarray:
    """Return state and d state / d width of a play with an unknown state at the start of a run, (2, n).

    From every start s in [-1, 1] the state is clip(s + U, low, high): U the travel over the width, low and
    high the states from -1 and 1. Returned is the mean over all starts; once the motion has covered 2 width,
    low and high are one and the state is known.
    """
    states, (low, high) = _from_ends(motion, width)
    by_low, by_high = _slopes(motion, width, states, np.array([low, high]))
    U = motion.moved / width
    a, b = np.clip(low - U, -1.0, 1.0), np.clip(high - U, -1.0, 1.0)
    inside = ((b + U) ** 2 - (a + U) ** 2) / 2
    mean = 0.5 * (low * (a + 1) + inside + high * (1 - b))
    slope = 0.5 * (by_low * (a + 1) - U / width * (b - a) + by_high * (1 - b))
    return np.array([mean, slope])


def _from_ends(motion: Travel, width: float) -> tuple[np.ndarray, np.ndarray]:
    """States at the edges (2, edges) and at all samples (2, n) if each run starts from -1 and from 1."""
    ends, strokes = (-1.0, 1.0), motion.strokes / width
    states = np.array([_states(np.where(motion.last, end * RESET, strokes), end) for end in ends])
    return states, np.clip(states[:, motion.stroke] + motion.along / width, -1.0, 1.0)


def _slopes(motion: Travel, width: float, states: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return the slopes (2, n) of states `z` with the width; nothing counts of what was covered before the
    play last stopped, as the `states` at the edges say."""
    at = motion.u[motion.edges]
    stopped = np.maximum.accumulate(np.where(np.abs(states) < 1.0, 0, np.arange(len(at))), axis=1)
    slopes = (at[stopped] - at) / width**2
    return np.where(np.abs(z) < 1.0, slopes[:, motion.stroke] - motion.along / width**2, 0.0)


def _states(strokes: np.ndarray, start: float) -> np.ndarray:
    """State before each stroke."""
    along = accumulate(strokes[:-1].tolist(), lambda z, by: min(max(z + by, -1.0), 1.0), initial=start)
    return np.fromiter(along, float, len(strokes))
