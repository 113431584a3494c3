"""Evaluate a CasADi function on whole arrays of samples.

CasADi's virtual machine runs one sample at a time. Here each instruction of the expression graph runs once
on a whole block, so that parameters stay scalars (computed once) and samples go through numpy at memory
speed. The graph stays the only source of the mathematics.
"""

from collections.abc import Callable, Sequence
from math import prod
from typing import Any

import casadi as ca
import numpy as np

UNARY: dict[int, Callable] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_NEG: np.negative,
    ca.OP_EXP: np.exp,
    ca.OP_LOG: np.log,
    ca.OP_SQRT: np.sqrt,
    ca.OP_SQ: np.square,
    ca.OP_TWICE: lambda a: a + a,
    ca.OP_SIN: np.sin,
    ca.OP_COS: np.cos,
    ca.OP_TAN: np.tan,
    ca.OP_ASIN: np.arcsin,
    ca.OP_ACOS: np.arccos,
    ca.OP_ATAN: np.arctan,
    ca.OP_SINH: np.sinh,
    ca.OP_COSH: np.cosh,
    ca.OP_TANH: np.tanh,
    ca.OP_FABS: np.abs,
    ca.OP_SIGN: np.sign,
    ca.OP_FLOOR: np.floor,
    ca.OP_CEIL: np.ceil,
    ca.OP_INV: lambda a: np.divide(1.0, a),
    ca.OP_NOT: lambda a: np.where(a == 0, 1.0, 0.0),
}
BINARY: dict[int, Callable] = {
    ca.OP_ADD: np.add,
    ca.OP_SUB: np.subtract,
    ca.OP_MUL: np.multiply,
    ca.OP_DIV: np.divide,
    ca.OP_POW: np.power,
    ca.OP_CONSTPOW: np.power,
    ca.OP_ATAN2: np.arctan2,
    ca.OP_HYPOT: np.hypot,
    ca.OP_FMIN: np.fmin,
    ca.OP_FMAX: np.fmax,
    ca.OP_FMOD: np.fmod,
    ca.OP_COPYSIGN: np.copysign,
    ca.OP_LT: lambda a, b: np.where(a < b, 1.0, 0.0),
    ca.OP_LE: lambda a, b: np.where(a <= b, 1.0, 0.0),
    ca.OP_EQ: lambda a, b: np.where(a == b, 1.0, 0.0),
    ca.OP_NE: lambda a, b: np.where(a != b, 1.0, 0.0),
    ca.OP_AND: lambda a, b: np.where((a != 0) & (b != 0), 1.0, 0.0),
    ca.OP_OR: lambda a, b: np.where((a != 0) | (b != 0), 1.0, 0.0),
    ca.OP_IF_ELSE_ZERO: lambda a, b: np.where(a != 0, b, 0.0),
}
OPERATIONS: dict[int, tuple[str, Callable | None]] = {
    **{code: ("unary", operation) for code, operation in UNARY.items()},
    **{code: ("binary", operation) for code, operation in BINARY.items()},
    **{ca.OP_CONST: ("constant", None), ca.OP_INPUT: ("input", None), ca.OP_OUTPUT: ("output", None)},
}
"""Implementation of each CasADi operation: it reads up to two registers and writes the last one."""

UFUNCS = frozenset(operation for operation in BINARY.values() if isinstance(operation, np.ufunc))

WORK, FEWEST = 4_000_000, 384
"""Largest number of values in memory at once, 32 MB, and least number of samples in a block.

A graph of many magnets and sensors holds tens of thousands of values of each sample at once."""


Columns = Sequence | np.ndarray
"""One scalar or array of samples per entry of an input."""


def on_arrays(function: ca.Function) -> Callable[..., list[np.ndarray]]:
    """Return `run(*inputs) -> outputs`, `function` evaluated on arrays of samples.

    Each input of `function`, a column of length n, is given as a sequence of n entries, scalars or arrays
    that broadcast together. Each output comes back as one array of shape `(rows, *samples)` (entries that
    depend on no sample are broadcast). Matrix outputs are flattened column by column, as CasADi stores them.
    Values that are not finite are returned without a warning, as CasADi does. `out`: arrays of that shape to
    write the outputs to.

    Raises `NotImplementedError` at once when the graph holds an operation without an array form.
    """
    program, size = _compile(function), function.sz_w()
    rows = [function.nnz_out(k) for k in range(function.n_out())]
    if not all(function.sparsity_out(k).is_dense() for k in range(function.n_out())):
        raise NotImplementedError(f"on_arrays needs dense outputs; densify {function.name()} first")

    @np.errstate(divide="ignore", over="ignore", invalid="ignore")
    def evaluate(inputs: Sequence[Sequence], out: Sequence[np.ndarray]) -> None:
        work: list = [None] * size  # and no graph, which takes as much memory as the program
        for kind, op, a, b, target in zip(*program, strict=True):
            if kind == "binary":
                work[target] = op(work[a], work[b])
            elif kind == "result":
                register, number, row = target
                work[register] = op(work[a], work[b], out=out[number][row, ...])
            elif kind == "unary":
                work[target] = op(work[a])
            elif kind == "input":
                work[target] = inputs[a][b]
            elif kind == "constant":
                work[target] = op
            else:
                out[b][target] = work[a]

    most = max(FEWEST, WORK // max(1, size + sum(rows)))

    def run(*inputs: Sequence, out: list[np.ndarray] | None = None) -> list[np.ndarray]:
        shape = np.broadcast_shapes(*{shape for column in inputs for shape in _shapes(column)})
        out = [np.empty((n, *shape)) for n in rows] if out is None else out
        rows_at_once = max(1, most // max(1, prod(shape[1:])))
        if not shape or shape[0] <= rows_at_once:
            evaluate(inputs, out)
            return out
        for low in range(0, shape[0], rows_at_once):
            here = slice(low, low + rows_at_once)
            own = [
                [v[here] if np.ndim(v) == len(shape) and len(v) > 1 else v for v in column]
                for column in inputs
            ]
            evaluate(own, [values[:, here] for values in out])
        return out

    return run


BACKWARDS = 4
"""Directions forwards that cost as much as one backwards, at most (Griewank and Walther 2008)."""


def jacobian(values: ca.SX, variables: ca.SX) -> ca.SX:
    """Return d values / d variables in the mode, forwards or backwards, that likely needs fewer operations.

    CasADi takes the mode with fewer directions, and visits every operation once for each. Each channel of an
    array of sensors has operations of its own: backwards each is taken by itself, so that they are visited
    once together.
    """
    if max(np.bincount(ca.jacobian_sparsity(values, variables).row()), default=0) < BACKWARDS:
        return ca.jacobian(values, variables)
    rows = (ca.jacobian(value, variables, {"allow_forward": False}) for value in ca.vertsplit(values))
    return ca.vertcat(*rows)


def on_vectors(function: ca.Function) -> Callable[..., list[np.ndarray]]:
    """Return `run(*inputs) -> outputs`, a function of dense vectors called thousands of times.

    Numbers go in and out through one buffer: a call of the function itself takes ten times as long for
    matrices of the size of a fit. Outputs are new arrays of the function's shapes.
    """
    bound: Any = function.buffer()
    inputs = [np.zeros(function.nnz_in(k)) for k in range(function.n_in())]
    outputs = [np.zeros(function.nnz_out(k)) for k in range(function.n_out())]
    shapes = [function.size_out(k) for k in range(function.n_out())]
    if not all(function.sparsity_out(k).is_dense() for k in range(function.n_out())):
        raise NotImplementedError(f"on_vectors needs dense outputs; densify {function.name()} first")
    for k, values in enumerate(inputs):
        bound[0].set_arg(k, memoryview(values.data))
    for k, values in enumerate(outputs):
        bound[0].set_res(k, memoryview(values.data))

    def run(*given: np.ndarray) -> list[np.ndarray]:
        for values, new in zip(inputs, given, strict=True):
            values[:] = np.ravel(new)
        bound[1]()  # the buffer, bound[0], lives as long as this function does
        return [
            values.reshape(shape, order="F").copy() for values, shape in zip(outputs, shapes, strict=True)
        ]

    return run


def _compile(function: ca.Function) -> tuple[list, ...]:
    """Return lists over all instructions: kind, operation, two registers read and the register written.

    Numbers of registers are shared objects: a graph has hundreds of thousands of instructions, and the graphs
    of a diagnosis take most of its memory.
    """
    kinds, operations, first, second, targets = program = tuple[list, ...]([] for _ in range(5))
    # no tuple per instruction: so many slow down the garbage collector
    of = list(range(1 + max(function.sz_w(), function.nnz_in(), function.nnz_out())))
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        if code not in OPERATIONS:
            raise NotImplementedError(f"operation {code} of {function.name()} has no array form")
        kind, operation = OPERATIONS[code]
        *read, target = *function.instruction_input(k), *function.instruction_output(k)
        if kind == "output" and kinds[-1] == "binary" and targets[-1] == read[0] and operations[-1] in UFUNCS:
            kinds[-1], targets[-1] = "result", (targets[-1], read[1], target)  # written to its place at once
            continue
        kinds.append(kind)
        operations.append(float(function.instruction_constant(k)) if kind == "constant" else operation)
        first.append(of[read[0]] if read else 0)
        second.append(of[read[1]] if len(read) > 1 else 0)
        targets.append(of[target])
    return program


def _shapes(column: Sequence) -> set[tuple[int, ...]]:
    """Return the shapes of the entries of an input."""
    return {column.shape[1:]} if isinstance(column, np.ndarray) else {getattr(v, "shape", ()) for v in column}


def median(values: np.ndarray) -> float:
    """Return the median of numbers (n,), nan where there is none or one of them is nan.

    >>> median(np.array([3.0, 1.0, 2.0, 10.0]))
    2.5
    """
    return float(medians(values[None])[0]) if len(values) else np.nan


def medians(rows: np.ndarray) -> np.ndarray:
    """Return the median of each row (c, n), n at least 1; nan where one of its numbers is nan.

    >>> medians(np.array([[3.0, 1.0, 2.0, 10.0], [1.0, 1.0, 1.0, 9.0]]))
    array([2.5, 1. ])
    """
    return middles(np.sort(rows, axis=1))


def middles(ordered: np.ndarray) -> np.ndarray:
    """Return the median of each row (c, n) of ascending numbers; nan where one of them, the last, is nan."""
    half, odd = ordered.shape[1] // 2, ordered.shape[1] % 2
    middle = ordered[:, half] if odd else 0.5 * (ordered[:, half - 1] + ordered[:, half])
    return np.where(np.isnan(ordered[:, -1]), np.nan, middle)


def medians_of(values: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Return the medians over the first axis of the values that are kept (same shape); 0 where none is."""
    ordered, count = np.sort(np.where(kept, values, np.inf), axis=0), kept.sum(axis=0)
    middle = np.maximum(np.array([(count - 1) // 2, count // 2]), 0)
    found = np.take_along_axis(ordered, middle, axis=0).mean(axis=0)
    return np.where(count > 0, found, 0.0)


def estimator(slopes: np.ndarray, weight: np.ndarray | None = None) -> np.ndarray:
    """Return (J^T W J)^-1 J^T W for J = `slopes` (..., n_channels, m) and the weights (n_channels,) W."""
    JW = np.swapaxes(slopes, -1, -2) * (1.0 if weight is None else weight)
    try:
        return np.linalg.solve(JW @ slopes, JW)
    except np.linalg.LinAlgError:  # where no reading sees a coordinate
        return np.asarray(np.linalg.pinv(JW @ slopes) @ JW)
