"""Results in a session: what their commands print, tables, pictures and files, as methods.

Who shows a result, and who decodes samples by it, the top of the package states (`hallsym/__init__.py`):
results know no report.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hallsym.errors import InputError
from hallsym.files import write_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ABOVE: dict[str, Callable[[], Any]] = {}


def shown_by(load: Callable[[], Any]) -> None:
    """Say who shows results: `load()` returns what has `summary`, `brief`, `table`, `figure` and `html`."""
    _ABOVE["shows"] = load


def decoded_by(load: Callable[[], Any]) -> None:
    """Say who decodes samples by a calibration: `load()` returns what has `predicted` and `residuals_on`."""
    _ABOVE["decodes"] = load


def decoding() -> Any:
    """Return who decodes samples by a calibration."""
    return _ABOVE["decodes"]()


class Shown:
    """A result that a session can print, tabulate, draw and save."""

    def summary(self) -> str:
        """Return what the command of this result prints."""
        return str(_ABOVE["shows"]().summary(self))

    def to_dataframe(self) -> Any:
        """Return the table of this result as a `pandas.DataFrame`, in SI; its units stand in a column.

        Raises `InputError` where pandas is not installed (`pip install 'hallsym[pandas]'`).
        """
        try:
            import pandas
        except ImportError as error:
            raise InputError(
                "A data frame needs pandas, which is not installed; run: pip install 'hallsym[pandas]'."
            ) from error
        return pandas.DataFrame(_ABOVE["shows"]().table(self))

    def plot(self, log: Any = None) -> Figure:
        """Return a picture of this result as a matplotlib `Figure`.

        `log`: where the picture is of one and the result was read from a file, which does not hold it.
        """
        figure: Figure = _ABOVE["shows"]().figure(self, log)
        return figure

    def to_dict(self) -> dict[str, Any]:
        """Return the record of this result."""
        raise NotImplementedError

    def save(self, path: str | Path) -> None:
        """Write the record as JSON; a file that was there is replaced only by a complete new one."""
        write_json(path, self.to_dict())

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the answer, its table, its picture."""
        return str(_ABOVE["shows"]().html(self))

    def __repr__(self) -> str:
        """Return a few lines."""
        return str(_ABOVE["shows"]().brief(self))
