"""What a rigid stage ties together: how the gains of its probes follow height and tilts."""

from hallsym.model import Model, Tie

ORIGIN = (-0.5, 0.5)
"""Bounds of x0 and y0, the point at which Z is measured [m]: a stage is no larger than this."""


def vertical_ties(model: Model) -> tuple[Tie, ...]:
    """Return b_k / a_k = y_k - y0 and c_k / a_k = -(x_k - x0) with the probes inside their bounds."""
    bounds = {p.name: (p.lower, p.upper) for p in model.parameters}

    def places(axis: int) -> tuple[tuple[float, float], ...]:
        found = []
        for k, probe in enumerate(model.layout, start=1):
            low, high = bounds[f"H{k}{'xy'[axis]}"]
            found.append((-high, -low) if probe.position[axis] < 0 else (low, high))
        return tuple(found)

    turned = tuple((-high, -low) for low, high in places(0))
    return Tie("rx_rad", "z_m", places(1), ORIGIN), Tie("ry_rad", "z_m", turned, ORIGIN)
