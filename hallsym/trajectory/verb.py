"""`choose_curve`: one function for points, files and expressions."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hallsym.trajectory.candidate import Choice
from hallsym.trajectory.choose import of_nominal
from hallsym.trajectory.leave_one_out import of_points
from hallsym.trajectory.methods import METHODS, method_named
from hallsym.trajectory.nominal import Nominal, nominal, read_span
from hallsym.trajectory.points import Points, points_of, read_points


def choose_curve(
    source: str | Path | Nominal | Points | np.ndarray,
    tolerance: float | None = None,
    *,
    span: str | None = None,
    values: Mapping[str, float] | None = None,
    points: int | None = None,
    control: int | None = None,
    method: str | None = None,
    nodes: str | None = None,
) -> Choice:
    """Return each method's curve for `source`, and the best: within `tolerance` [m], the fewest numbers.

    `source`: an expression with its `span`, such as "t=0:2*pi", and `values` in SI; a CSV file of points; or
    points (N, 2) in m. `points`, `nodes`: how many are taken of an expression, and where. `control`: control
    points of least squares. `method`: only this one.

    >>> choice = choose_curve("x = r*t; y = r*t**2", 1e-9, span="t=0:1", values={"r": 1e-3})
    >>> choice.best.method.name, choice.curve.control_points
    ('bernstein', 3)
    """
    chosen = METHODS if method is None else (method_named(method),)
    if isinstance(source, str) and span is not None:
        source = nominal(source, read_span(span), values)
    if isinstance(source, Nominal):
        return of_nominal(source, tolerance, points=points, control=control, methods=chosen, nodes=nodes)
    if isinstance(source, str | Path):
        source = read_points(source)
    if isinstance(source, np.ndarray):
        source = points_of(source)
    return of_points(source, tolerance, control=control, methods=chosen)
