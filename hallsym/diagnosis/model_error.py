"""What a diagnosis hands to the budget of a position: the rest as standard uncertainty, and the models."""

import numpy as np

from hallsym.diagnosis.confusable import Confusable
from hallsym.diagnosis.record import Gap
from hallsym.diagnosis.refit import Refitted
from hallsym.diagnosis.remainder import ModelLeft, NotExcluded, Unexplained
from hallsym.diagnosis.setup import Setup
from hallsym.diagnosis.validation import Validation
from hallsym.families import added_effects


def model_error(
    setup: Setup, found: Validation, gap: Gap, metric: float, rest: Unexplained | None, alike: Confusable
) -> ModelLeft:
    """Return what the model leaves beyond the noise, and the models that the log does not exclude.

    `gap`, `metric`: the error that is left on the holdout runs. `rest`: its shape, where it is unexplained.
    """
    floor = found.floor_by_output
    known = metric <= found.floor.metric * (1 + setup.policy.negligible)
    above = {c: float(np.sqrt(max(v**2 - floor[c] ** 2, 0.0))) for c, v in gap.rmse.items()}
    counts = rest is not None and _placed(setup, rest)
    share = (rest.of_it or 0.0) if rest is not None and counts else 0.0
    left = float(np.sqrt(max(1 - share, 0.0)))
    return ModelLeft(
        rest={c: 0.0 if known else v * left for c, v in above.items()},
        shape_counts=counts,
        candidates=_candidates(found, alike.fits),
    )


def _placed(setup: Setup, rest: Unexplained) -> bool:
    """Return whether the rest goes with a coordinate that a position has: of its pose or its state."""
    if rest.curve is None or not rest.curve.line:
        return False
    model = setup.base.model
    return rest.curve.column.removeprefix("d0_") in (*model.references, *model.state)


def _candidates(found: Validation, fits: tuple[Refitted, ...]) -> tuple[NotExcluded, ...]:
    """Return the named model and those the log does not exclude, each with its probability by BIC."""
    if not fits:
        return ()
    models = found.fit, *fits
    bic = np.array([f.bic(len(f.base.free), found.inflation) for f in models])
    weight = np.exp(-0.5 * (bic - bic.min()))
    return tuple(
        NotExcluded(tuple(added_effects(f.base.model)), f.base.values, float(w))
        for f, w in zip(models, weight / weight.sum(), strict=True)
    )
