"""What is wrong with a recording that a known calibration is judged on: what a fit of it would say."""

from collections.abc import Mapping

import numpy as np

from hallsym.estimation.decoding import knows_rails, logged_columns
from hallsym.estimation.gauss_newton import cost_near, zeros_of
from hallsym.estimation.lateness import lateness
from hallsym.estimation.linearised import exact
from hallsym.estimation.task import Task
from hallsym.families import plain
from hallsym.log import Log, clean_log
from hallsym.model import Model


def recording_notes(log: Log, model: Model, p: np.ndarray, noise: Mapping[str, float]) -> tuple[str, ...]:
    """Return notes on units, signs, runs and delays of a log, as a fit of `model` gives them.

    `log`: as the model reads it. `p`: (n,) values of the calibration. `noise`: standard deviations by column.
    Raises `InputError` where a fit refuses the log.
    """
    base = model if exact(model) else plain(model)
    if not exact(base):
        return ()
    free = clean_log(log, logged_columns(base)) if knows_rails(model) else log
    task = Task(free, base, (), "direct", "none", 0, lambda _: None, None)
    judged = task.judged(task.begin(task.summary()))
    judged.refuse()
    if base is not model:
        return judged.notes
    cost = cost_near(log, model, p, noise)
    late = lateness(log, model, p, zeros_of(cost, p), cost)
    return judged.notes if late is None else (*judged.notes, late)
