"""The steps of a decoupler on arrays of samples: statement by statement as C runs them, so the same bits."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from hallsym.codegen.decoupler import Bits, Decoupler, Lookup, Step, Whole
from hallsym.codegen.operations import NAMES, Graph, graph
from hallsym.model.arrays import BINARY, UNARY

OPERATIONS: Mapping[str, Callable[..., np.ndarray]] = {
    NAMES[code]: run for code, run in (UNARY | BINARY).items()
}
"""Each operation of a graph on arrays, in the type that they have."""


def on_arrays(d: Decoupler, real: type = float) -> Callable[..., list[np.ndarray]]:
    """Return `run(inputs, coefficients and zeros)`: pose (n_pose, s), and what flags look at, if any.

    `inputs` (n_inputs, s) and the constants (n,) or (n, 1) are of the type `real`.
    """
    names = [*d.inputs, *(e.name for e in (*d.table, *d.zeros))]
    symbols = [d.symbols[name].name() for name in names]
    graphs = {step.name: graph([step.expression]) for step in d.steps}
    results = [step.name for step in d.steps[-len(d.pose) :]]

    def run(inputs: Sequence, constants: Sequence) -> list[np.ndarray]:
        values = dict(zip(symbols, (*inputs, *constants), strict=True))
        for step in d.steps:
            values[step.name] = _taken(step, _computed(graphs[step.name], values, real), real)
        shape = np.broadcast_shapes(*(np.shape(row) for row in inputs))
        groups = (results, [flag.step for flag in d.flags])
        return [
            np.array([np.broadcast_to(values[name], shape) for name in group], dtype=real)
            for group in groups
            if group
        ]

    return run


def _computed(found: Graph, values: Mapping[str, np.ndarray], real: type) -> np.ndarray:
    made: list[np.ndarray] = []
    for o in found.operations:
        if o.op == "input":
            made.append(values[o.symbol])
        elif o.op == "const":
            made.append(real(o.value))
        else:
            made.append(OPERATIONS[o.op](*(made[k] for k in o.args)))
    return made[found.results[0]]


def _taken(step: Step, value: np.ndarray, real: type) -> np.ndarray:
    """Return what a step makes of its value; whole numbers and their bits are exact in any type."""
    if isinstance(step, Whole):
        return np.floor(value)
    if isinstance(step, Bits):
        upper = np.floor(value * 2.0**-step.first)
        return value - upper * 2.0**step.first if step.below else upper
    if isinstance(step, Lookup):
        entries: np.ndarray = np.array(step.array.values, dtype=real)
        return entries[(value.astype(np.int64) + step.ahead) % len(entries)]
    return value
