"""What a rigid stage ties together: how the gains of its probes follow height and tilts."""

from hallsym.model import Model, Tie

ORIGIN = (-0.5, 0.5)
"""Bounds of x0 and y0, the point at which Z is measured [m]: a stage is no larger than this."""


def vertical_ties(model: Model) -> tuple[Tie, ...]:
    """Return b_k / a_k = y_k - y0 and c_k / a_k = -(x_k - x0) with the probes inside their bounds."""
    bounds = {p.name: (p.lower, p.upper) for p in model.parameters}
    x, y = (
        tuple(
            tuple(sorted(-v if probe.position[axis] < 0 else v for v in bounds[f"H{k}{'xy'[axis]}"]))
            for k, probe in enumerate(model.layout, start=1)
        )
        for axis in (0, 1)
    )
    turned = tuple((-high, -low) for low, high in x)
    return Tie("rx_rad", "z_m", y, ORIGIN), Tie("ry_rad", "z_m", turned, ORIGIN)
