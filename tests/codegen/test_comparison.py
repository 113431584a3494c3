"""What the documentation says of other generators, from the benchmark that it was taken from."""

import sys
from pathlib import Path

import pytest
from firmware import need

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.mark.slow
def test_ours_beside_the_others():
    need("arm-none-eabi-gcc", "qemu-system-arm", "gcc", "make", "awk")
    pytest.importorskip("sympy", reason="sympy not installed: make bench installs it")
    sys.path.insert(0, str(BENCHMARKS))
    try:
        import bench_codegen
    finally:
        sys.path.remove(str(BENCHMARKS))
    rows = {title: {row.label: row for row in found} for title, found, _ in bench_codegen.tables()}
    stage, encoder = rows.values()
    ours, fused = stage["hallsym, arithmetic alone"], stage["hallsym --fma, arithmetic alone"]
    sympy, hand = stage["SymPy, common subexpressions, float"], stage["by hand, fused"]
    assert ours.count < sympy.count < stage["CasADi, parameters as constants, float"].count
    assert hand.count < fused.count <= 60  # no zeros are added there
    for row in (ours, fused):
        assert max(row.errors) < max(sympy.errors)
        assert row.errors[0] <= sympy.errors[0]
    assert max(fused.errors) < max(hand.errors)
    least = encoder["hallsym, range test and status"].cycles.split("-")[0]
    assert int(least) < int(encoder["by hand, atan2f of the library"].cycles.split("-")[0])
