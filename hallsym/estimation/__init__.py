"""Fit a model to a log.

The path of a fit, file by file:

- `task`: one log as it is fitted: checked, reduced, judged, and the `Fit` that comes of it.
- `factors`: the log, read once, becomes one small triangle per run, whose own offsets are eliminated.
- `likelihood`: the cost of those runs with exact derivatives.
- `plausible`: checks that reference and channels belong together.
- `identifiable`: which parameters the data determine, and which are therefore fixed.
- `optimum`: a closed-form start, global search, Newton, IPOPT; Gauss-Newton by passes over the log.
- `outliers`, `decoding`: samples that are left out; errors of the decoded pose.
- `residual_noise`: the residual noise, its size and autocorrelation; `goodness_of_fit`: its size in multiples
  of the stated noise; `covariance`: standard uncertainties, and those that show between runs.
- `calibration`: the record that is printed and saved; `evaluate`: a calibration on another log.

`fit` puts these in order and is what users call; `several` fits logs of one device together.
"""

from hallsym.estimation.calibration import (
    MANY,
    CombinationEstimate,
    Fit,
    calibration_schema,
    coverage_factor,
    load_fit,
)
from hallsym.estimation.covariance import Uncertainty, uncertainty
from hallsym.estimation.decoding import (
    ErrorTable,
    columns_of,
    decoder,
    decoding_gain,
    error_tables,
    logged_columns,
    nominal_variance,
)
from hallsym.estimation.evaluate import Evaluation, evaluate
from hallsym.estimation.factors import exact, inverse, pseudo_inverse, solve, summarise
from hallsym.estimation.fit import LOSSES, fit
from hallsym.estimation.goodness_of_fit import KNOWN, WORTH_REPORTING, GoodnessOfFit, limit_of, noise_floor
from hallsym.estimation.identifiable import (
    Determination,
    determine,
    feature_scale,
    least_information,
    scales,
    structural_directions,
    structural_null,
)
from hallsym.estimation.likelihood import Coefficients, Cost, cost_near, cost_of, zeros_of
from hallsym.estimation.optimum import SOLVERS, refit
from hallsym.estimation.outliers import column_spikes, reject_spikes, residuals, tukey
from hallsym.estimation.plausible import as_read, rewired
from hallsym.estimation.residual_noise import Residual, autoregressive, noise_at, noise_left, residual_noise
from hallsym.estimation.task import lower_bound, noise_of
from hallsym.families import added_effects

__all__ = [
    "KNOWN",
    "LOSSES",
    "MANY",
    "SOLVERS",
    "WORTH_REPORTING",
    "Coefficients",
    "CombinationEstimate",
    "Cost",
    "Determination",
    "ErrorTable",
    "Evaluation",
    "Fit",
    "GoodnessOfFit",
    "Residual",
    "Uncertainty",
    "added_effects",
    "as_read",
    "autoregressive",
    "calibration_schema",
    "column_spikes",
    "columns_of",
    "cost_near",
    "cost_of",
    "coverage_factor",
    "decoder",
    "decoding_gain",
    "determine",
    "error_tables",
    "evaluate",
    "exact",
    "feature_scale",
    "fit",
    "inverse",
    "least_information",
    "limit_of",
    "load_fit",
    "logged_columns",
    "lower_bound",
    "noise_at",
    "noise_floor",
    "noise_left",
    "noise_of",
    "nominal_variance",
    "pseudo_inverse",
    "refit",
    "reject_spikes",
    "residual_noise",
    "residuals",
    "rewired",
    "scales",
    "solve",
    "structural_directions",
    "structural_null",
    "summarise",
    "tukey",
    "uncertainty",
    "zeros_of",
]
