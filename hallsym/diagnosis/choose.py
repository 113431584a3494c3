"""Effects by name alone: their numbers (a width, an instant, a frequency, a rail) are found from a log."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from hallsym.diagnosis.facts import facts_of
from hallsym.diagnosis.scores import Screen, candidates
from hallsym.diagnosis.selection import refitted
from hallsym.diagnosis.setup import Setup, prepare
from hallsym.diagnosis.survey import survey
from hallsym.errors import InputError
from hallsym.families import adapted, build, default_model, effect_named
from hallsym.log import Log
from hallsym.model import Effect, Model


def model_on(
    log: Log,
    model: str | Model | None = None,
    effects: Sequence[str] = (),
    *,
    parameters: Mapping[str, Mapping[str, Any]] | None = None,
    own: Mapping[str, Callable[[Model], Model]] | None = None,
    holdout: Sequence[int] | None = None,
    drop_bad: bool = False,
    on_progress: Callable[[str], None] | None = None,
) -> Model:
    """Return `model` with effects in the order given; open numbers are estimated from `log`.

    Arguments as for `fit`. An open number is found as a diagnosis finds it: by scores on the runs
    outside the holdout, the model so far fitted to them.

    Raises `InputError` for an effect that the log does not show at all, such as hum without a line.
    """
    if not isinstance(model, Model):
        model = build(model or default_model(log.meta), meta=log.described)
    names = {
        p.name for p in (*model.parameters, *model.offsets)
    }  # what its effects add is changed at the end
    model = adapted(model, (), {name: entry for name, entry in (parameters or {}).items() if name in names})
    for text in effects:
        effect = effect_named(text, model, own)
        if ":" in text or not effect.lacking(text):
            model = effect.added(model, text)
        else:
            setup = prepare(log, model, holdout=holdout, drop_bad=drop_bad, on_progress=on_progress)
            model = _shown(setup.part, effect)
    return adapted(model, (), parameters or {}, own)


def _shown(setup: Setup, effect: Effect) -> Model:
    """The model of a fit with one effect, in the variant that explains most of its residual."""
    base, runs = setup.base, setup.runs
    seen = survey(base, runs)
    facts = facts_of(base, seen)
    tried, trouble = candidates(base, [effect], facts)
    screen = Screen(base, tried, runs)
    screen.weigh(seen.autocorrelation, louder=seen.fast)
    exact = refitted(base, screen, runs, lambda s: s.p_value < setup.policy.certain)
    if not exact:
        reason = trouble.get(effect.name, "nothing in the residual looks like it")
        raise InputError(
            f"Effect {effect.name} cannot be found in {setup.log.name}: {reason}; give its numbers as "
            f"{effect.name}:{effect.lacking(effect.name)[0]}=..., or leave it out."
        )
    return exact[0].score.variant.make(setup.fit.model)
