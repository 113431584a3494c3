"""Fit a model to a log.

The path of a fit, file by file:

- `task`: one log as it is fitted: checked, reduced, judged, the `Fit` that comes of it and its values.
- `factors`: the log, read once, becomes one small triangle per run, whose own offsets are eliminated.
- `likelihood`: the cost of those runs with exact derivatives.
- `claims`: mistakes of the recording that explain the residual.
- `identifiable`: which parameters the data determine, and which are therefore fixed.
- `optimum`: a closed-form start, global search, Newton, IPOPT; Gauss-Newton by passes over the log.
- `outliers`, `decoding`: samples that are left out; errors of the decoded pose.
- `goodness_of_fit`: the residual noise, its size and autocorrelation, the noise floor and the verdict;
  `covariance`: standard uncertainties, and those that show between runs.
- `calibration`: the record that is printed and saved; `evaluate`: a calibration on another log.
- `self_calibration`: an encoder without a reference, as mathematics; `without_reference`: as a calibration.

`fit` puts these in order and is what users call; `several` fits logs of one device together.
"""

from hallsym.estimation.calibration import Fit, calibration_schema, load_fit
from hallsym.estimation.decoding import ErrorTable
from hallsym.estimation.evaluate import Evaluation, evaluate
from hallsym.estimation.fit import LOSSES, fit
from hallsym.estimation.optimum import SOLVERS, refit
from hallsym.estimation.without_reference import SelfFit, fit_without_reference

__all__ = [
    "LOSSES", "SOLVERS", "ErrorTable", "Evaluation", "Fit", "SelfFit", "calibration_schema", "evaluate",
    "fit", "fit_without_reference", "load_fit", "refit",
]  # fmt: skip
