"""Effects of the stage in time: the probes feel the past, by a delay or a low-pass."""

from hallsym.families.parts import Make, P, add, column
from hallsym.families.stage.effects.parts import AXES, along, labels
from hallsym.model import Model, Parameter, Signals
from hallsym.model.derived import rate

SERIES = {"time_skew": (-1.0, 1 / 2, -1 / 6, 1 / 24), "first_order_lag": (-1.0, 1.0, -1.0, 1.0)}
"""Factors of tau^n d^n/dt^n: a delay, and 1 / (1 + tau d/dt), to fourth order in tau times frequency."""


def delayed(effect: str, shared: bool) -> Make:
    """Probes feel the past: `time_skew` delays, `first_order_lag` low-passes; one tau or one per probe."""
    factors = SERIES[effect]

    def make(model: Model) -> Model:
        columns = [rate(c, n) for n in range(1, len(factors) + 1) for c in AXES]
        names = [f"tau_{effect}"] * 3 if shared else [f"tau_{effect}_{k}" for k in labels(model)]
        names = names[:1] * len(model.layout) if shared else names
        least = 0.0 if effect == "first_order_lag" else -0.05
        new = tuple(Parameter(n, 0.0, least, 0.05, "s", "delay") for n in dict.fromkeys(names))

        def step(s: Signals, p: P) -> None:
            tau = column(p, names)
            for n, factor in enumerate(factors, start=1):
                moved = along(model, p, *(s[f"d{n}_{c}"] for c in AXES))
                s["displacement"] = s["displacement"] + factor * tau**n * moved

        return add(model, "reference" if effect == "time_skew" else "transducer", effect, new, step, *columns)

    return make
