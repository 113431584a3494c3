"""What a table of methods does not say by itself."""

from __future__ import annotations

from collections.abc import Sequence

from hallsym.trajectory.candidate import Candidate


def beyond_the_points(best: Candidate) -> tuple[str, ...]:
    """Say where the ends of the range are worse than what lies between the points."""
    if best.between_m is None or best.error_m < 1.05 * best.between_m:
        return ()
    return (
        f"between the first and the last point the error is {1e6 * best.between_m:.4g} um; the ends of the "
        f"range lie beyond them, where it grows to {1e6 * best.error_m:.4g} um.",
    )


def of_accuracy(rows: Sequence[Candidate]) -> tuple[str, ...]:
    """Say what the high relative accuracy of the solution is worth for these points."""
    found = {(c.method.name, c.nodes): c for c in rows if c.curve is not None}
    notes = []
    hra, lu = found.get(("bernstein", "equidistant")), found.get(("bernstein-lu", "equidistant"))
    both = hra and lu and hra.points == lu.points and (lu.at_least_m or 0) > 0.5 * lu.error_m
    if both and hra and lu and hra.error_m > 0.9 * lu.error_m:
        rest = "solving the equations more exactly than their points are rounded cannot help."
        notes.append(
            f"high relative accuracy gains nothing over LU here ({1e6 * hra.error_m:.3g} um and "
            f"{1e6 * lu.error_m:.3g} um): {rest}"
        )
    notes += moved_by_the_origin(rows)
    return tuple(notes)


def moved_by_the_origin(rows: Sequence[Candidate]) -> list[str]:
    """Say which trigonometric curves have an even number of control points, which is an odd order."""
    made = [c for c in rows if c.curve is not None and c.method.name.startswith("trigonometric")]
    even = sorted({c.control_points for c in made if c.control_points % 2 == 0})
    if not even:
        return []
    counts = " and ".join(map(str, even))
    return [
        f"trigonometric curves of an even number of control points ({counts}) do not contain constants: they "
        "change when the origin moves."
    ]
