"""Self-test of the integer decoupler: its bits, vectors of the model in double, the largest error met."""

import numpy as np

from hallsym.codegen.entries import short
from hallsym.codegen.parts import flag_bit
from hallsym.codegen.project import template
from hallsym.codegen.q31_source import IntegerSource
from hallsym.codegen.source import BANNER
from hallsym.codegen.turns import MASK
from hallsym.codegen.vectors import BATCH, COUNT, mix

HASHED = (4096, 100_000)
"""Samples in the hash of the self-test, and in the long one."""
MOST = 2**31 - 1


def emulate(source: IntegerSource, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return pose (n_pose, s) and status (s,) as integers, for integers (n_inputs, s)."""
    p, d = source.program, source.program.d
    low, high = _ends(source)
    if p.angles & set(d.inputs):
        inputs = inputs.astype(np.int64) & MASK
    outside = (inputs > high) | (inputs < low)
    held = np.clip(inputs.astype(np.int64), low, high)
    status = (outside * (1 << np.arange(len(inputs)))[:, None]).sum(axis=0)
    found = p.run({short(c): row for c, row in zip(d.inputs, held, strict=True)})
    for k, flag in enumerate(d.flags):
        status = status | np.where(found[flag.name] < p.table[p.flags[flag.name][1]][0], flag_bit(k), 0)
    return np.array([found[c] for c in d.pose]), status


def _ends(source: IntegerSource) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest integers of the inputs, (n_inputs, 1) each."""
    p, d = source.program, source.program.d
    ends = [(0, MASK) if c in p.angles else [int(v / p.unit(c)) for v in d.ends(c)] for c in d.inputs]
    return np.array(ends)[:, :1], np.array(ends)[:, 1:]


def _model(source: IntegerSource, inputs: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Return the pose [SI] of the model in double, on the branch of the integers `pose`."""
    p, d = source.program, source.program.d
    found = pose * np.array([[p.unit(c)] for c in d.pose])
    return found - d.difference(found, d.exact(inputs * np.array([[p.unit(c)] for c in d.inputs])))


def errors(source: IntegerSource, samples: int = 100_000, seed: int = 0) -> dict[str, float]:
    """Return the largest error against the model in double, over random integers in the box."""
    p, d = source.program, source.program.d
    low, high = _ends(source)
    share = np.random.default_rng(seed).random((len(low), samples))
    inputs = np.round(low + (high - low) * share).astype(np.int64)
    pose, status = emulate(source, inputs)
    inputs, pose = inputs[:, status == 0], pose[:, status == 0]
    found = pose * np.array([[p.unit(c)] for c in d.pose])
    off = np.abs(found - _model(source, inputs, pose)).max(axis=1)
    return dict(zip(d.pose, off.tolist(), strict=True))


def stated(source: IntegerSource, count: int) -> int:
    """Return the hash of status and pose over numbered samples, as test/selftest.c computes it."""
    d, total = source.program.d, 0
    width = np.uint32(len(d.pose) + 1)
    for first in range(0, count, BATCH):
        n = np.arange(first, min(first + BATCH, count), dtype=np.uint32)
        raw = mix(n * np.uint32(len(d.inputs)) + np.arange(1, len(d.inputs) + 1, dtype=np.uint32)[:, None])
        inputs = raw.view(np.int32) >> ((mix(n) & np.uint32(3)).astype(np.int32))
        pose, status = emulate(source, inputs)
        for k, row in enumerate((status, *pose)):
            words = (row & 0xFFFFFFFF).astype(np.uint32)
            total += int(mix(words ^ mix(n * width + np.uint32(k))).astype(np.uint64).sum())
    return total & 0xFFFFFFFF


def vectors(source: IntegerSource) -> str:
    """Return inputs, the pose that the model gives for them in double, status, bounds and hashes."""
    p, d = source.program, source.program.d
    low, high = _ends(source)
    rng = np.random.default_rng(1)
    share = np.hstack([rng.choice([0.0, 1.0], (len(low), 8)), rng.random((len(low), COUNT - 8))])
    given = [np.round(low + (high - low) * share).astype(np.int64)]
    for k in range(len(low) if not p.angles & set(d.inputs) else 0):
        beyond = np.repeat(given[0][:, 9 + k : 10 + k], 4, axis=1)
        beyond[k] = (-MOST - 1, low[k, 0] - 1, high[k, 0] + 1, MOST)
        given.append(beyond)
    inputs = np.hstack(given)
    if d.listed:
        units = np.array([p.unit(c) for c in d.inputs])
        listed = np.round(np.array(d.listed) / units).astype(np.int64).T
        inputs = np.hstack([inputs, listed & MASK if p.angles & set(d.inputs) else listed])
    found, status = emulate(source, inputs)
    pose = _model(source, np.clip(inputs, low, high), found)
    weak = status >= flag_bit(len(d.flags) - 1) if d.flags else np.zeros(len(status), bool)
    pose = np.where(weak, found * np.array([[p.unit(c)] for c in d.pose]), pose)
    binary = [c in p.angles for c in d.inputs]
    rows = [
        f"    {{{{{', '.join(map(_integer, inputs[:, k], binary))}}}, "
        f"{{{', '.join(f'{v:.12e}' for v in pose[:, k])}}}, 0x{int(status[k]):X}UL}},"
        for k in range(inputs.shape[1])
    ]
    bounds = ", ".join(f"{p.bounds[c][2] + 1e-15:.3e}" for c in d.pose)
    short_hash, long_hash = (stated(source, n) for n in HASHED)
    return "\n".join(
        [
            BANNER.rstrip(),
            "/* Inputs, the pose [SI] of the model in double, status. Bounds of the error; hashes. */",
            f"#define DECOUPLER_VECTORS {len(rows)}U",
            "",
            f"static const double decoupler_bounds[{len(d.pose)}] = {{{bounds}}};",
            f"const uint32_t decoupler_hash_short = 0x{short_hash:08X}UL;",
            f"const uint32_t decoupler_hash_long = 0x{long_hash:08X}UL;",
            "",
            "static const vector_t decoupler_vectors[DECOUPLER_VECTORS] = {",
            *rows,
            "};",
            "",
        ]
    )


def _integer(value: int, unsigned: bool) -> str:
    if unsigned:
        return f"{value}U"
    return f"({value + 1} - 1)" if value == -MOST - 1 else str(value)


def selftest(source: IntegerSource) -> str:
    """Return the self-test."""
    p, d = source.program, source.program.d
    width = f"{len(d.pose) + 1}U"
    sample = [
        f"    in->{p.member(c)} = {'(uint32_t)' if c in p.angles else ''}input(n, {k + 1}U);"
        for k, c in enumerate(d.inputs)
    ]
    words = [
        f"        total += mix((uint32_t)out.{p.member(c)} ^ mix((n * {width}) + {k + 1}U));"
        for k, c in enumerate(d.pose)
    ]
    compare = [
        f"        failed |= differs((double)out.{p.member(c)} * {p.unit(c)!r}, wanted->pose[{k}], "
        f"decoupler_bounds[{k}], &result.worst);"
        for k, c in enumerate(d.pose)
    ]
    return (
        template("selftest_q31.c")
        .replace("@POSE@", str(len(d.pose)))
        .replace("@INPUTS@", str(len(d.inputs)))
        .replace("@WIDTH@", width)
        .replace("@SAMPLE@", "\n".join(sample))
        .replace("@WORDS@", "\n".join(words))
        .replace("@COMPARE@", "\n".join(compare))
    )


def main(source: IntegerSource) -> str:
    """Return the program that runs the self-test and says what it found."""
    p, d = source.program, source.program.d
    rest = [round(v / p.unit(c)) for c, v in zip(d.inputs, d.rest or [0.0] * len(d.inputs), strict=True)]
    if not d.rest or p.angles & set(d.inputs):
        rest = [1000] * len(d.inputs)
    given = [
        f"    in.{p.member(c)} = {_integer(v, c in p.angles)};" for c, v in zip(d.inputs, rest, strict=True)
    ]
    known = {p.member(c): _integer(4096, c in p.angles) for c in d.pose}
    return (
        template("main_q31.c")
        .replace("@REST@", "\n".join(given))
        .replace("@KNOWN@", "\n".join(f"    pose.{c} = {v};" for c, v in known.items()))
        .replace("@BACK@", " && ".join(f"(out.{c} == {v})" for c, v in known.items()))
    )
