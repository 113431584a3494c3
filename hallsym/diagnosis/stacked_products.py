"""Products of columns: all rows of a candidate, of whatever channel, in one product.

A parameter of one channel has one row, so a candidate of a sensor array has as many rows as parameters; each
pair of channels on its own would be thousands of products of one row.
"""

from typing import Any

import numpy as np

from hallsym.diagnosis.products import Products


def stacked_products(
    work: Any, near: np.ndarray, rows: list[np.ndarray], D: np.ndarray
) -> tuple[Products, Products]:
    """Return products under the precision of `work`, and mapped to the pose by D; where D is empty no others.

    `work`: the `Accumulator`. `near`: (own, K, blocks, samples) of zeros, parameters and residual, `rows`:
    (rows, blocks, samples) of each channel, `D`: (n_pose, K, blocks, samples).
    """
    first, blocks, precision = work.z + work.n, near.shape[2], work.precision
    white, decoded = np.tensordot(work.whiten, near, axes=(1, 1)).swapaxes(0, 1), _decoded(D, near)
    out = work.nil(blocks), work.nil(blocks)
    for M, columns in zip(out, (white, decoded), strict=True):
        M.border[:, :, work.near] = _gram(columns)
    if not any(map(len, rows)):
        return out
    metric = np.tensordot(precision, near, axes=(1, 1)).swapaxes(0, 1)
    mapped = np.einsum("ikbs,oibs->okbs", D, decoded)
    for M, columns in zip(out, (metric, mapped), strict=True):
        for k, block in enumerate(rows):
            if len(block):
                across = columns[:, k].transpose(1, 0, 2) @ block.transpose(1, 2, 0)
                M.border[:, :, first + work.slopes.column[k]] += across
    for c, key in enumerate(work.slopes.span):
        _add_own(work, rows, c, precision, D, *(work.own_of(M, key) for M in out))
    return out


def _decoded(D: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Return (own, n_pose, blocks, samples): what the columns `near` are as an error of the pose."""
    out = np.empty((len(near), len(D), *near.shape[2:]))
    for k, column in enumerate(near):
        np.einsum("ikbs,kbs->ibs", D, column, out=out[k])
    return out


def _gram(columns: np.ndarray) -> np.ndarray:
    """Return the products (blocks, own, own) of columns (own, rows, blocks, samples) with each other."""
    flat = columns.transpose(2, 0, 1, 3).reshape(columns.shape[2], len(columns), -1)
    return np.array([own @ own.T for own in flat])


def _add_own(
    work: Any,
    rows: list[np.ndarray],
    c: int,
    precision: np.ndarray,
    D: np.ndarray,
    white: np.ndarray,
    out: np.ndarray,
) -> None:
    """Add the products of the rows of candidate c with each other, (blocks, k, k) twice."""
    parts = [work.slopes.parts[k][c] for k in range(len(rows))]
    channel = np.repeat(np.arange(len(rows)), [part.stop - part.start for part in parts])
    if not len(channel):
        return
    stack = np.concatenate([block[part] for block, part in zip(rows, parts, strict=True)]).swapaxes(0, 1)
    column = np.concatenate([work.slopes.column[k][part] for k, part in enumerate(parts)])
    known, place = np.unique(column, return_inverse=True)
    at = known - list(work.slopes.span.values())[c].start
    if len(channel) ** 2 > len(known) * len(rows) * (len(known) + len(rows)):
        _add_dense(stack, channel, place, at, precision, D, white, out)
        return
    one = (place == np.arange(len(known))[:, None]).astype(float)  # (columns, rows)
    gram = (stack @ stack.swapaxes(1, 2)) * precision[channel[:, None], channel]
    white[:, at[:, None], at] += one @ gram @ one.T
    for spread in D[:, channel].swapaxes(1, 2):
        moved = one @ (spread * stack)
        out[:, at[:, None], at] += moved @ moved.swapaxes(1, 2)


def _add_dense(
    stack: np.ndarray,
    channel: np.ndarray,
    place: np.ndarray,
    at: np.ndarray,
    precision: np.ndarray,
    D: np.ndarray,
    white: np.ndarray,
    out: np.ndarray,
) -> None:
    """Add the products of rows (blocks, rows, samples) whose parameters act on most channels each."""
    blocks, _, samples = stack.shape
    for b in range(blocks):
        full = np.zeros((len(at), len(precision), samples))
        full[place, channel] = stack[b]
        metric = (precision @ full).reshape(len(at), -1)
        white[b][at[:, None], at] += full.reshape(len(at), -1) @ metric.T
        moved = np.einsum("iks,cks->cis", D[:, :, b], full, optimize=True).reshape(len(at), -1)
        out[b][at[:, None], at] += moved @ moved.T
