"""What figures and pages show, reduced from a log of any length: typed records that know no renderer."""

from hallsym.report.data.cells import Cells, Tally
from hallsym.report.data.correlation import Correlation, blocks, correlation_of
from hallsym.report.data.decoded import Decoded, Decoder, decoded
from hallsym.report.data.gather import Gathered, Version, compared, gather, version_of
from hallsym.report.data.parameters import ParameterRow, parameter_rows
from hallsym.report.data.residuals import Residuals, ResidualTally
from hallsym.report.data.series import RunSeries, run_series
from hallsym.report.data.survey import (
    MOST_SETTINGS,
    Group,
    Survey,
    held_out,
    look_over,
    representative,
    settings,
    worst_first,
)
from hallsym.report.data.trace import COLUMNS, Trace

__all__ = [
    "COLUMNS",
    "MOST_SETTINGS",
    "Cells",
    "Correlation",
    "Decoded",
    "Decoder",
    "Gathered",
    "Group",
    "ParameterRow",
    "ResidualTally",
    "Residuals",
    "RunSeries",
    "Survey",
    "Tally",
    "Trace",
    "Version",
    "blocks",
    "compared",
    "correlation_of",
    "decoded",
    "gather",
    "held_out",
    "look_over",
    "parameter_rows",
    "representative",
    "run_series",
    "settings",
    "version_of",
    "worst_first",
]
