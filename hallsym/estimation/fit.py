"""Fit a model to a log: run statistics, starts, global search, refinement, uncertainty, error tables.

The path is the same for every family: one pass over the log gives run statistics; a closed form and SHTLBO
give starting points; IPOPT refines them inside the bounds; a second pass tabulates errors.
"""

from collections.abc import Callable, Mapping, Sequence
from time import perf_counter
from typing import Any

import numpy as np

from hallsym.errors import InputError, nearest
from hallsym.estimation.calibration import Fit
from hallsym.estimation.decoding import knows_rails, logged_columns
from hallsym.estimation.linearised import exact
from hallsym.estimation.optimum import SOLVERS
from hallsym.estimation.result import result_of, zero_notes
from hallsym.estimation.several import fit_several
from hallsym.estimation.task import Asked, Progress, Task, held_out, model_of, prepared
from hallsym.families import plain
from hallsym.log import as_log, clean_log
from hallsym.model import Model

LOSSES = ("auto", "none", "reject", "tukey")


def fit(
    log: Any,
    model: str | Model | None = None,
    *,
    solver: str = "hybrid",
    holdout: Sequence[int] | None = None,
    loss: str = "auto",
    parameters: Mapping[str, Mapping[str, float]] | None = None,
    effects: Sequence[str] = (),
    own: Mapping[str, Callable[[Model], Model]] | None = None,
    resolve_wiring: bool = False,
    drop_bad: bool = False,
    seed: int = 0,
    start: np.ndarray | None = None,
    per_log: Sequence[str] = (),
    holdout_logs: Sequence[Any] = (),
    quick: bool = False,
    on_progress: Progress | None = None,
) -> Fit:
    """Calibrate `model` on `log` and return values, uncertainties and errors.

    `log`: a `Log`, the path of one, a dict of arrays, or a data frame of any library that speaks Arrow
    (pandas, polars, pyarrow, DuckDB). Its columns end with their unit, `x_ref_um`, or state it,
    `x_ref [um]`; SI inside. Of the stage they are

        run                               a whole number that a reset or a break ends
        t_s                               time
        hall_a_m, hall_b_m, hall_c_m      readings, as the displacement that each probe claims
        z_m, rx_rad, ry_rad               vertical pose
        x_ref_m, y_ref_m, rz_ref_rad      the reference

    of an encoder `v_sin_v, v_cos_v` or `angle_rad` (`angle_count`) beside `angle_ref_rad`; `hallsym info
    MODEL` lists those of any model. Names that are other ones are mapped by `hallsym.read_log(log,
    columns={"hall_a_um": "HallA"})`.

    Returns a `Fit`: `values`, `std`, `half_width` (n,) in the order of `model.names`; `value(name)`;
    `covariance` (n, n); `errors.rows()` with rmse and peak of the decoded pose, before and after, on fitted
    and holdout runs; `goodness`; `notes`. `summary()` is what the command prints, `to_dataframe()` the
    parameters, `plot()` a picture, `save(path)` the calibration.

    >>> import hallsym
    >>> fit = hallsym.fit(hallsym.bundled_campaign(), "stage31", solver="direct")
    >>> f"{1e6 * fit.errors.rows()['fitted']['rmse']['x_m']:.2f} um"
    '1.36 um'

    `model`: a name or a Model; the log's own `base_model`, else what its columns suggest. `solver`: "hybrid"
    (SHTLBO and a closed form, refined by IPOPT), "direct" (closed form alone) or a global method for the
    hybrid; Newton's method ends all, or IPOPT where that does not converge.
    `holdout`: runs that take no part in the fit; the log's own by default. Their zero deviations are
    estimated from themselves. `loss`: "auto" takes out isolated spikes if there are any and says so, "reject"
    always looks for them, "tukey" weighs every sample by Tukey's biweight, "none" is plain least squares.
    `parameters`: changed nominal values and bounds. `effects`: effects to add, by name, with their numbers or
    without (`hysteresis:half_width_m=6e-05`; `hallsym.diagnosis.choose.model_on` finds them on a log). `own`:
    the user's effects by name. `start`: (n,) values to begin from instead of the closed form.

    `quick`: one pass over a log whose run statistics show nothing amiss, without error tables (`errors` is
    None), the lower bound of the cost and a test of the colour of the noise; any other log is fitted as
    without it.

    `log` may be a list of logs of one device, each with its runs and its noise: they share all parameters but
    those named in `per_log` (`"eta_A"`, or a pattern such as `"eta_*"`), of which each log has its own.
    `holdout_logs`: logs that take no part. `fit.by_log` are then the fits log by log, `fit.joint` the
    parameters of all logs with their covariance; `values` are those of the last log.

    A model that has no run statistics (memory, rates, a term of higher order in the zeros) is fitted from the
    optimum of the model without its effects by Gauss-Newton steps, one pass over the log each.

    Raises `InputError` for a log that cannot be what the model needs.
    """
    began, say = perf_counter(), on_progress or (lambda _: None)
    _choice(solver, SOLVERS, "solver")
    _choice(loss, LOSSES, "loss")
    alone = not (isinstance(log, list | tuple) or len(holdout_logs) or len(per_log))
    logs = [as_log(one) for one in (log if isinstance(log, list | tuple) else [log])]
    if not logs:
        raise InputError("There is no log to fit; give one at least.")
    judged = [as_log(one) for one in holdout_logs]
    models = [model_of(one, model, effects, parameters, own) for one in (*logs, *judged)]
    asked = Asked(
        solver, holdout, loss, resolve_wiring, drop_bad, seed, start, quick and alone, say,
    )  # fmt: skip
    if not alone or exact(models[0]):
        return fit_several(logs, judged, models, per_log, asked, alone=alone, began=began)
    log, model = logs[0], models[0]
    say("checking the log")
    log, told, mounted = prepared(log, model, drop_bad=drop_bad)
    notes = list(told)
    held = held_out(log, log.meta.holdout if holdout is None else holdout)
    first = None
    if exact(base := plain(model)):
        # the model without effects has no rails: it is fitted to the samples off them
        explains_rails = knows_rails(model)
        free = clean_log(log, logged_columns(model)) if explains_rails else log
        first = fit(
            free, base, solver=solver, holdout=held, loss=loss, resolve_wiring=resolve_wiring,
            drop_bad=explains_rails, seed=seed,
            on_progress=on_progress,
        )  # fmt: skip
        zeros = zero_notes(first.model, tuple(first.zeros), np.array(list(first.zeros.values())))
        notes += [note for note in first.notes if note not in (*zeros, *free.notes)]
    said = tuple(dict.fromkeys((*mounted.notes, *notes)))
    return result_of(Task(log, model, held, asked).by_passes(first, said, mounted.wiring), began)


def _choice(name: str, known: Sequence[str], what: str) -> None:
    if name not in known:
        raise InputError(
            f"Input {what} must be one of {', '.join(known)}; instead received {name!r}"
            f"{nearest(name, list(known))}."
        )
