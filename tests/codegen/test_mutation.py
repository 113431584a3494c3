"""The self-test that goes with generated C, tested: it must notice what is wrong with the code.

Each mutant is the library with one operator, constant or statement changed. A mutant that compiles to the
same instructions is none (trivial compiler equivalence, Papadakis et al., doi:10.1109/ICSE.2015.103), nor is
`<=` for `<` where the comparison chooses between what it compares. Others that compute the same are counted
as missed.
"""

import re
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from firmware import TESTED, need, ran, written
from test_codegen_every import EVERY

LEAST = 0.95
"""Share of the mutants that the self-test must notice."""
SWAPS = {
    "<=": "<", ">=": ">", "<": "<=", ">": ">=", "==": "!=", "!=": "==", "&&": "||", "||": "&&",
    "+": "-", "-": "+", "*": "/", "/": "*", "&": "|", "|=": "=", "^=": "|=", "+=": "=", ">>": "<<",
}  # fmt: skip
OPERATOR = re.compile(r" (<=|>=|==|!=|&&|\|\||\|=|\^=|\+=|>>|<|>|\+|-|\*|/|&) (?!\*)")
CONSTANT = re.compile(r"\b(0U|1U|8U|0xFFFFFFFFUL|0xEDB88320UL|0\.0f|0\.899999976f)\b")
STATEMENT = re.compile(r"^    +(?:p->|found|result|status|bad|crc|out->|\*status)[^=]* [|+^]?= .*;$")


def mutants(text):
    """Yield a source once for each change; comments and preprocessor lines stay."""
    lines = text.split("\n")
    for k, line in enumerate(lines):
        if line.startswith("#") or line.lstrip().startswith(("/*", "*", "//")):
            continue
        code = line.split("/*")[0]
        changed = [
            code[: m.start(1)] + SWAPS[m[1]] + code[m.end(1) :]
            for m in OPERATOR.finditer(code)
            if not _chooses_its_own(code, m)
        ]
        changed += [
            code[: m.start(1)] + _other(m[1], code[: m.start(1)].endswith(("? ", ": "))) + code[m.end(1) :]
            for m in CONSTANT.finditer(code)
        ]
        changed += [""] if STATEMENT.match(code.rstrip()) else []
        for new in changed:
            yield k, "\n".join([*lines[:k], new, *lines[k + 1 :]])


def _chooses_its_own(code, operator):
    """Whether a comparison chooses between what it compares: `<` and `<=` choose the same value."""
    before = re.search(r"\(([\w.]+) $", code[: operator.start(1)])
    if before and code[operator.end(1) :] == f" 0) ? difference(0, {before[1]}) : {before[1]};":
        return True  # a size: 0 is -0 in integers
    after = re.match(r" ([\w.]+)\) \? ([\w.]+) : ([\w.]+)", code[operator.end(1) :])
    return bool(before and after) and {before[1], after[1]} == {after[2], after[3]}


def _other(constant, truth):
    """Another constant; of a truth value the other one, because any number but 0 is true."""
    if truth and constant in ("0U", "1U"):
        return {"0U": "1U", "1U": "0U"}[constant]
    return {"0U": "1U", "1U": "2U", "8U": "7U", "0.0f": "1.0f"}.get(
        constant, constant.replace("8", "9").replace("F", "E")
    )


GCC = ("gcc", "-std=c99", "-ffp-contract=off", "-w", "-I.", "-Itest", "-xc", "-")


def machine_code(folder, source):
    """The machine code of a source, optimized: a mutant with the same is no other program."""
    return subprocess.run(
        [*GCC, "-O2", "-S", "-o", "-"], cwd=folder, input=source, capture_output=True
    ).stdout


def noticed(folder, name, source):
    """Whether a mutant fails to compile or its self-test says that something is wrong.

    The other files of the folder are compiled once: only the mutant is, and it is linked with them.
    """
    with TemporaryDirectory(dir=folder) as place:
        mutant, program = f"{place}/mutant.o", f"{place}/selftest"
        others = [f"{Path(other).stem}.o" for other in TESTED if other != name]
        for command in ([*GCC, "-O1", "-c", "-o", mutant], ["gcc", mutant, *others, "-o", program]):
            if subprocess.run(command, cwd=folder, input=source, capture_output=True).returncode:
                return True
        try:
            ran = subprocess.run([program], cwd=folder, capture_output=True, timeout=10)
        except subprocess.TimeoutExpired:
            return True
        return ran.returncode != 0


WHOLE, MOST = 200, 80
"""Mutants of a case that are all tried; of more, at most so many, evenly over the code."""

CASES = ("stage31", "stage31 q31", "clipped 5 mrad", "meng volts q31", "three sums", "travel")


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_the_self_test_notices_what_is_wrong_with_the_code(tmp_path, case):
    need("gcc")
    folder = written(EVERY[case].made(), tmp_path / "fw")
    ran(folder, *GCC[:-2], "-O1", "-c", *TESTED)
    sources = {name: (folder / name).read_text() for name in ("decoupler.c", "decoupler_check.c")}
    every = [(name, line, text) for name, source in sources.items() for line, text in mutants(source)]
    tried = every[:: 1 if len(every) <= WHOLE else -(-len(every) // MOST)]
    missed = [one for one in tried if not noticed(folder, one[0], one[2].encode())]
    same = {name: machine_code(folder, source.encode()) for name, source in sources.items() if missed}
    alive = [
        f"{name}:{line + 1}: {text.splitlines()[line].strip()}"
        for name, line, text in missed
        if machine_code(folder, text.encode()) != same[name]
    ]
    found = len(tried) - len(missed)
    print(f"{found} of {found + len(alive)} mutants noticed; alive:", *alive, sep="\n")
    assert found > 50
    assert found >= LEAST * (found + len(alive)), alive
