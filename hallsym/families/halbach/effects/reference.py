"""Effects of Halbach arrays at the reference: its scale, and motions that it reads in another axis."""

from hallsym.families.halbach import links
from hallsym.families.mechanisms import P, free
from hallsym.model import Model, Signals, effect


def _off(model: Model, effect: str, terms: dict[str, tuple[str, str, str]], limit: float, unit: str) -> Model:
    """Logged coordinate = true + e column: `terms`: parameter -> coordinate, column, meaning."""

    def step(s: Signals, p: P) -> None:
        for name, (coordinate, column, _) in terms.items():
            links.move(s, coordinate, -p[name] * s[column])

    new = free({name: meaning for name, (_, _, meaning) in terms.items()}, limit, unit)
    return model.with_step("reference", step, effect=effect, parameters=new)


def _lengths(model: Model) -> list[str]:
    return [c for c in model.pose if c.endswith("_m")]


@effect(
    link="reference",
    label="a factor per length",
    separate="more periods; a known length beside the reference",
)
def reference_scale_error(model: Model) -> Model:
    """Scale factor of a reference axis."""
    terms = {
        f"scale_{c[0]}": (c, c, f"share by which the reference of {c[0]} is long") for c in _lengths(model)
    }
    return _off(model, "reference_scale_error", terms, 0.1, "1")


@effect(
    link="reference",
    label="each length with the other motions",
    separate="one coordinate moved while the rest stands still, beside a second reference",
)
def reference_abbe_error(model: Model) -> Model:
    """The reference reads other motions: tilt times an Abbe arm, an axis that is not square."""
    turns = [c for c in model.pose if c.endswith("_rad")]
    lengths = _lengths(model)
    pairs = [(c, t) for c in lengths for t in (turns or [o for o in lengths if o != c])]
    terms = {
        f"abbe_{c[0]}_{t.split('_')[0]}": (c, t, f"error of the reference of {c[0]} per {t.split('_')[0]}")
        for c, t in pairs
    }
    return _off(model, "reference_abbe_error", terms, 1.0, "m/rad" if turns else "1")
