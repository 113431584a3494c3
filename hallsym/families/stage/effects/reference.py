"""Effects of the stage at the reference: what the logged pose is off by, every probe seems to feel."""

from collections.abc import Sequence

import casadi as ca

from hallsym.families.parts import Make, P, add, free
from hallsym.families.stage.effects.parts import along
from hallsym.model import Model, Signals
from hallsym.model.derived import Computed, run_time


def _reference(
    effect: str, terms: Sequence[tuple[int, str]], limit: float, unit: str, *columns: Computed
) -> Make:
    """Logged pose coordinate i = true + e column: each probe is expected to feel less by that much."""

    def make(model: Model) -> Model:
        names = [f"{effect}_{model.pose[i]}_{c}" for i, c in terms]

        def step(s: Signals, p: P) -> None:
            error = [ca.SX(0)] * 3
            for name, (i, c) in zip(names, terms, strict=True):
                error[i] = error[i] + p[name] * s[c]
            s["displacement"] = s["displacement"] - along(model, p, *error)

        return add(
            model, "reference", effect, free(names, limit, unit, "error of the reference"), step, *columns
        )

    return make


def reference_abbe_error(terms: Sequence[tuple[int, str]]) -> Make:
    """The reference reads tilt (or lift) times an Abbe arm: pairs of pose index and vertical column."""
    return _reference("reference_abbe_error", terms, 1.0, "m/rad")


def reference_scale_error() -> Make:
    """Each axis of the reference is off by a factor; eta, H and theta absorb it."""
    terms = [(0, "x_m"), (1, "y_m"), (2, "rz_rad")]
    return _reference("reference_scale_error", terms, 0.1, "1")


def reference_drift(degree: int = 1) -> Make:
    """The reference creeps within every run along a polynomial of its time, one per axis."""
    columns = [run_time(n) for n in range(1, degree + 1)]
    terms = [(k, c.name) for c in columns for k in range(3)]
    return _reference("reference_drift", terms, 1e-3, "m/s", *columns)
