"""The table of methods that a person reads."""

from __future__ import annotations

from hallsym.trajectory.candidate import Candidate, Choice


def choice_text(choice: Choice) -> str:
    """Return the choice as a table of methods, the chosen one marked, and what it means."""
    head = ("", "method", "nodes", "points", "control", "numbers", "max error [um]")
    rows = [_row(choice, c) for c in choice.candidates]
    widths = [max(len(row[k]) for row in [head, *rows]) for k in range(len(head))]
    lines = [_line(head, widths)]
    lines.append("-" * len(lines[0]))
    lines += [_line(row, widths) + (f"  {c.reason}" if c.reason else "") for row, c in
              zip(rows, choice.candidates, strict=True)]  # fmt: skip
    best = choice.best
    within = (
        "" if choice.tolerance_m is None else f", within the tolerance of {1e6 * choice.tolerance_m:.4g} um"
    )
    why = "the most exact" if choice.tolerance_m is None else "fewest numbers to store"
    how = "bounded over the whole range" if choice.kind == "bounded" else "estimated by leaving points out"
    lines.append("")
    lines.append(
        f"{best.method.words}, {best.nodes} nodes: {best.control_points} control points, error "
        f"{_um(best)} um ({how}){within}; {why}."
    )
    if best.rotation_rad is not None:
        lines.append(f"largest error of an angle: {1e6 * best.rotation_rad:.4g} urad")
    lines += [f"note: {note}" for note in choice.notes]
    return "\n".join(lines)


def _row(choice: Choice, c: Candidate) -> tuple[str, ...]:
    mark = ">" if c is choice.best else ("" if choice.tolerance_m is None or choice.meets(c) else "x")
    if c.curve is None:
        return mark, c.method.name, c.nodes, str(c.points or "-"), "-", "-", "-"
    return mark, c.method.name, c.nodes, str(c.points), str(c.control_points), str(c.numbers), _um(c)


def _um(c: Candidate) -> str:
    """Four digits, fewer where lower and upper bound differ by so much that they say nothing."""
    loose = c.at_least_m is not None and c.at_least_m < 0.5 * c.error_m
    return f"{'< ' if loose else ''}{1e6 * c.error_m:.{2 if loose else 4}g}"


def _line(cells: tuple[str, ...], widths: list[int]) -> str:
    left = [cell.ljust(w) for cell, w in zip(cells[:3], widths[:3], strict=True)]
    return "  ".join(
        [*left, *(cell.rjust(w) for cell, w in zip(cells[3:], widths[3:], strict=True))]
    ).rstrip()
