"""Reports: words, figures and pages, all drawn from the same typed results.

`hallsym.report(fit, "page.html")` writes the page of a result: the module itself is called.
"""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import Any


class _Called(ModuleType):
    """The package as a function: `hallsym.report` is both."""

    def __call__(self, result: Any, path: str | Path, log: Any = None) -> Path:
        """Write one self-contained HTML page of a result and return its path.

        `result`: a `Fit`, the path of a saved one, or any other result. `log`: the one that was fitted, or
        another one of the same machine, as `hallsym.fit` takes it; not needed for a fit just made.

        Raises `InputError` for a calibration without a log, and for a page that cannot be written.
        """
        from hallsym.files import atomic_write
        from hallsym.report.views import page_of

        target = Path(path)
        atomic_write(target, page_of(result, log))
        return target


sys.modules[__name__].__class__ = _Called
