"""What else writes C of a decoder: SymPy, CasADi, a hand. Each as a source, and how to call it."""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

import hallsym
from hallsym.codegen import decouple, generate
from hallsym.codegen.operations import Operation, graph

CASADI = "{name}(arg, res, 0, work, 0);"


@dataclass(frozen=True)
class Rival:
    """C of one function: `source` defines `name`, which `call` calls with `in` and `out`, arrays of `real`.

    `before`: a declaration, and after `@` what stands before the call; `table`: bytes of it that the decoder
    reads.
    """

    label: str
    name: str
    source: str
    call: str
    real: str = "float"
    before: str = ""
    table: int = 0


def numbers(values: Sequence[float], real: str) -> str:
    """Return an initializer."""
    digits, suffix = (9, "f") if real == "float" else (17, "")
    texts = (f"{value:.{digits}g}" for value in values)
    return ", ".join(f"{text if '.' in text or 'e' in text else text + '.0'}{suffix}" for text in texts)


# -- CasADi --------------------------------------------------------------------------------------------------


def casadi(fit: hallsym.Fit, real: str, parameters: bool = False) -> Rival:
    """CasADi's own generator on the model's decoder: parameters as constants, or as inputs."""
    model, name = fit.model, "casadi_function"
    n, k = len(model.channels), len(model.state)
    p, m, s = (ca.SX.sym(what, size) for what, size in (("p", len(model.names)), ("m", n), ("s", k)))
    if parameters:
        made = ca.Function(name, [p, m, s], [model.decoded(p, np.zeros(len(model.zeros)), m, s, np.ones(n))])
    else:
        made = ca.Function(name, [m, s], [decouple(fit)(m, s)])
    generator = ca.CodeGenerator(f"{name}.c", {"casadi_real": real})
    generator.add(made)
    place = f"in, in + {n}"
    before = f"    const {real} *arg[8] = {{{'p, ' if parameters else ''}{place}}};\n"
    before += f"    {real} *res[8] = {{out}};\n    static {real} work[400];\n"
    if parameters:
        before += f"    static const {real} p[] = {{{numbers(fit.values, real)}}};\n"
        before = "\n".join(reversed(before.rstrip("\n").split("\n"))) + "\n"  # the table first
    declared = f"int {name}(const {real} **arg, {real} **res, long long *iw, {real} *w, int mem);\n"
    how = "inputs" if parameters else "constants"
    return Rival(
        f"CasADi, parameters as {how}, {real}", name, generator.dump(),
        f"(void){CASADI.format(name=name)}", real, before=declared + "@" + before,
    )  # fmt: skip


# -- SymPy ---------------------------------------------------------------------------------------------------


def sympy_stage(fit: hallsym.Fit) -> Rival:
    """SymPy with common subexpressions on Eq. (31) with numbers: pose = inverse (reading / gain)."""
    import sympy

    model, state = fit.model, ca.SX.sym("s", len(fit.model.state))
    gains = [sympy.expand(e) for e in _sympy(ca.vertsplit(model.gain(fit.values, state)))]
    readings = sympy.symbols(f"m_0:{len(model.channels)}")
    rows = [
        sum(
            sympy.Float(d, 17) * m / g for d, m, g in zip(row, readings, gains, strict=True) if abs(d) > 1e-12
        )
        for row in inverse(fit)
    ]
    return _printed_by_sympy(rows, len(readings))


def sympy_encoder(fit: hallsym.Fit) -> Rival:
    """SymPy on the closed form with numbers: the ellipse taken out, and the arctangent of the library."""
    import sympy

    center, x, y = (np.array([e.value for e in generate(fit).decoupler.table[k : k + 2]]) for k in (0, 2, 4))
    m = sympy.symbols("m_0:2")

    def row(of: np.ndarray) -> object:
        return sum(
            sympy.Float(f, 17) * (v - sympy.Float(c, 17)) for f, v, c in zip(of, m, center, strict=True)
        )

    return _printed_by_sympy([sympy.atan2(row(y), row(x))], 2)


def sympy_array(fit: hallsym.Fit) -> Rival:
    """SymPy on the closed form of a magnet array with numbers: the first harmonic, functions of libm."""
    import sympy

    model, readings = fit.model, ca.SX.sym("m", len(fit.model.channels))
    begin = model.begin(readings, {n: ca.SX(v) for n, v in model.named(fit.values).items()})
    rows = [sympy.expand_log(e, force=True) for e in _sympy(ca.vertsplit(ca.densify(begin)))]
    return _printed_by_sympy(rows, len(model.channels))


def _printed_by_sympy(rows: Sequence, n: int) -> Rival:
    import sympy
    from sympy.codegen.ast import float32, real

    shared, results = sympy.cse(rows, optimizations="basic")
    rename = {symbol: _indexed(symbol.name, n) for row in rows for symbol in row.free_symbols}

    def text(expression: object) -> str:
        printed = sympy.ccode(expression, type_aliases={real: float32})
        for name, place in rename.items():
            printed = printed.replace(name.name, place)
        return str(printed)

    lines = [f"    const float {name} = {text(value)};" for name, value in shared]
    lines += [f"    out[{k}] = {text(value)};" for k, value in enumerate(results)]
    head = "void sympy_function(const float *in, float *out)"
    source = "\n".join(["#include <math.h>", f"{head};", head, "{", *lines, "}", ""])
    return Rival(
        "SymPy, common subexpressions, float", "sympy_function", source, "sympy_function(in, out);",
        before=f"{head};\n@",
    )  # fmt: skip


def _indexed(name: str, n: int) -> str:
    """`m_1` -> `in[1]`, `s_0` -> `in[n]`, a single `m` -> `in[0]`."""
    kind, _, index = name.partition("_")
    return f"in[{int(index or 0) + (n if kind == 's' else 0)}]"


def _sympy(expressions: Sequence[ca.SX]) -> list:
    found, values = graph(expressions), []
    for o in found.operations:
        values.append(_value(o, [values[k] for k in o.args]))
    return [values[k] for k in found.results]


def _value(o: Operation, args: list) -> object:
    import sympy

    if o.op in ("input", "const"):
        return sympy.Symbol(o.symbol) if o.op == "input" else sympy.Float(o.value, 17)
    a, b = args[0], args[-1]
    return {
        "add": lambda: a + b, "sub": lambda: a - b, "mul": lambda: a * b, "div": lambda: a / b,
        "sq": lambda: a * a, "neg": lambda: -a, "inv": lambda: 1 / a, "twice": lambda: 2 * a,
        "atan2": lambda: sympy.atan2(a, b), "log": lambda: sympy.log(a),
    }[o.op]()  # fmt: skip


# -- by hand -------------------------------------------------------------------------------------------------


def inverse(fit: hallsym.Fit) -> np.ndarray:
    """Return d pose / d (reading / gain), (n_pose, n_channels), at rest."""
    model = fit.model
    pose, state = ca.SX.sym("pose", len(model.pose)), ca.SX.sym("state", len(model.state))
    reading = model.reading(fit.values, np.zeros(len(model.zeros)), pose, state)
    slope = ca.Function("slope", [pose, state], [ca.jacobian(reading, pose), model.gain(fit.values, state)])
    found, gain = (np.array(part) for part in slope(np.zeros(len(model.pose)), np.zeros(len(model.state))))
    return np.linalg.inv(found / gain)


BY_HAND = """
void by_hand(const float *p, const float *in, float *out);
void by_hand(const float *p, const float *in, float *out)
{
    const float z = in[3], rx = in[4], ry = in[5];
    const float a = in[0] / FMA(p[1], z, FMA(p[2], rx, FMA(p[3], ry, p[0])));
    const float b = in[1] / FMA(p[5], z, FMA(p[6], rx, FMA(p[7], ry, p[4])));
    const float c = in[2] / FMA(p[9], z, FMA(p[10], rx, FMA(p[11], ry, p[8])));
    out[0] = FMA(p[12], a, FMA(p[13], b, c));
    out[1] = FMA(p[14], c, a + b);
    out[2] = FMA(p[15], a, FMA(p[16], b, p[17] * c));
}
"""


def by_hand(fit: hallsym.Fit) -> Rival:
    """A fused version as a careful engineer would write it: gains scaled so that three entries are 1.

    No zeros and no range test; the large term of each gain comes first, which costs accuracy alone.
    """
    d, state = inverse(fit), ca.SX.sym("s", 3)
    gain = fit.model.gain(fit.values, state)
    parts = ca.Function("gain", [state], [gain, ca.jacobian(gain, state)])
    rest, slope = (np.array(part) for part in parts(np.zeros(3)))
    own = (d[1, 0], d[1, 1], d[0, 2])  # a and b count for y by themselves, c for x
    table: list[float] = []
    for k, scale in enumerate(own):
        table += [float(rest[k, 0] / scale), *(slope[k] / scale).tolist()]
    table += [d[0, 0] / own[0], d[0, 1] / own[1], d[1, 2] / own[2]]
    table += [d[2, 0] / own[0], d[2, 1] / own[1], d[2, 2] / own[2]]
    declared = "void by_hand(const float *p, const float *in, float *out);\n@"
    return Rival(
        "by hand, fused", "by_hand", "#define FMA __builtin_fmaf\n" + BY_HAND, "by_hand(p, in, out);",
        before=f"{declared}    static const float p[] = {{{numbers(table, 'float')}}};\n",
        table=4 * len(table),
    )  # fmt: skip


ENCODER = """
#include <math.h>
void by_hand(const float *p, const float *in, float *out);
void by_hand(const float *p, const float *in, float *out)
{
    const float u = in[0] - p[0], v = in[1] - p[1];
    out[0] = atan2f(FMA(p[4], u, p[5] * v), FMA(p[2], u, p[3] * v));
}
"""


def encoder_by_hand(fit: hallsym.Fit) -> Rival:
    """The ellipse of two voltages taken out, and the library's atan2f: what most controllers run."""
    table = [e.value for e in generate(fit).decoupler.table[:6]]
    return Rival(
        "by hand, atan2f of the library", "by_hand", "#define FMA __builtin_fmaf\n" + ENCODER,
        "by_hand(p, in, out);", before=f"void by_hand(const float *p, const float *in, float *out);\n@"
        f"    static const float p[] = {{{numbers(table, 'float')}}};\n", table=4 * len(table),
    )  # fmt: skip
