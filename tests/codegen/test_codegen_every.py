"""What holds for generated code of every kind, whatever the family and the arithmetic.

Independent facts: random inputs and any bits; the compiler's own sanitizers; the bits of another processor;
instructions counted one by one in QEMU; cppcheck; Frama-C EVA.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import test_codegen_arrays as arrays
import test_codegen_correction as correction
import test_codegen_faults as faults
import test_codegen_movers as movers
import test_codegen_q31_rotary as integers
import test_codegen_rotary as encoders
import test_codegen_travel as travel
import test_codegen_waves as waves
from firmware import (
    PATHS,
    SANITIZED,
    TESTED,
    every_input,
    instructions,
    need,
    passes,
    proved_by_eva,
    ran,
    undefined_symbols,
    written,
)

from hallsym.codegen import Generated
from hallsym.codegen.bounds import PoseByPose

M3 = ("MACHINE=mps2-an385", "CPU=-mcpu=cortex-m3 -mthumb")
M7 = ("MACHINE=mps2-an500", "CPU=-mcpu=cortex-m7 -mthumb -mfloat-abi=hard -mfpu=fpv5-sp-d16")


@dataclass(frozen=True)
class Kind:
    """Generated code; most instructions of a call in range and of any; `quick`: tried in a fast run too.

    `cores`: other than its own whose bits are compared.
    """

    made: Callable[[], Generated]
    most: tuple[int, int] | None = None
    quick: bool = False
    cores: tuple[tuple[str, ...], ...] | None = None


def one(limit: int) -> tuple[int, int]:
    return limit, limit


EVERY = {
    "three sums": Kind(waves.made, one(190), True, (M3,)),
    "five sums": Kind(lambda: waves.made("five sums"), None, False, (M7,)),
    "first harmonic alone": Kind(lambda: waves.made("first harmonic alone")),
    "second harmonic": Kind(lambda: waves.made("second harmonic, another wavelength")),
    "12 sums": Kind(lambda: arrays.made("12 sums"), None, True),
    "closed form of 12 sums": Kind(lambda: arrays.made("closed form of 12 sums"), (520, 620)),
    "24 sums": Kind(lambda: arrays.made("24 sums"), (2800, 15_000)),
    "many periods": Kind(lambda: arrays.made("many periods")),
    "rows": Kind(movers.made, one(4800)),
    "travel": Kind(travel.made, cores=()),
    "five Halls q31": Kind(lambda: faults.made_of("five Halls", "q31"), (1300, 8500)),
    **{
        f"{case} {form}": Kind(
            lambda c=case, f=form: encoders.made(c, f), limit and one(limit), (case, form) in encoders.QUICK
        )
        for (case, form), limit in {
            **dict.fromkeys([(c, f) for c in encoders.CASES for f in encoders.LAYOUTS]),
            ("ellipse", "volts"): 130,
            ("meng", "angle"): 170,
        }.items()
    },
    **{
        f"{case} {kind}": Kind(lambda c=case, a=accuracy, k=kind: correction.made(c, a, k), one(limit))
        for case, accuracy, kind, limit in (
            ("clipped", 5e-3, "auto", 182), ("clipped", 1e-3, None, 182), ("meng angle", None, "table", 100)
        )
    },
    **{
        f"{case} q31": Kind(
            lambda c=case, a=accuracy: integers.made(c, a), one(limit), case == "meng angle"
        )
        for (case, accuracy), limit in zip(integers.CASES, (40, 515, 490, 415), strict=True)
    },
}  # fmt: skip
EACH = [pytest.param(n, marks=() if k.quick else pytest.mark.slow) for n, k in EVERY.items()]


@pytest.mark.parametrize("name", EACH)
def test_stated_errors_hold_and_whatever_the_bits_the_pose_is_finite(name):
    code = EVERY[name].made()
    backend, d = code.backend, code.decoupler
    for column, met in code.errors.items():
        assert 0 < met <= backend.error_bound[column]
    if backend.type == "float":  # rounding is far below what a sensor resolves
        most = {"_m": 3e-7, "ad": 1e-6 if len(d.pose) > 1 else 1e-5}
        assert all(e < most[c[-2:]] for c, e in code.bounds.error.items())
    pose, status = backend.step(backend.sample(np.arange(20_000)))
    assert np.isfinite(pose).all()
    assert (status != 0).any() or backend.type == "q31"
    if not isinstance(d.bounded, PoseByPose):  # else of poses alone
        scaled = pose * np.array([[port.scale] for port in backend.outputs])
        for column, row in zip(d.pose, scaled, strict=True):
            assert code.bounds.low[column] - 1e-7 <= row.min()
            assert row.max() <= code.bounds.high[column] + 1e-7


@pytest.mark.parametrize("name", EACH)
def test_its_folder_passes_its_self_test_without_undefined_behaviour(name, tmp_path):
    folder = written(EVERY[name].made(), tmp_path / "fw")
    passes(folder, *SANITIZED)


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n, kind in EVERY.items() if kind.most or kind.cores is not None])
def test_bits_and_instructions_on_a_controller_and_what_tools_find(name, tmp_path):
    need("arm-none-eabi-gcc", "qemu-system-arm", "make", "cppcheck")
    kind = EVERY[name]
    code = kind.made()
    folder = written(code, tmp_path / "fw")
    for core in ((), *(kind.cores or ())):
        ran(folder, "make", "clean")
        assert ran(folder, "make", "qemu", *core).count("as stated") == 2
    wide = (
        {"__aeabi_lmul", "__aeabi_ldivmod"} if code.decoupler.mends and code.backend.type == "q31" else set()
    )
    assert undefined_symbols(folder) == {"decoupler_crc"} | wide  # nothing of libm
    if kind.most:
        typical, *others = instructions(code, folder)
        assert typical <= kind.most[0]
        assert max(others) <= kind.most[1]
    if name not in ("rows", "travel"):  # cppcheck takes too long
        ran(folder, "make", "misra")
    if code.decoupler.evident:
        proved_by_eva(folder, integers=code.backend.type == "q31")
    if name in ("meng angle q31", "ellipse volts q31"):
        every_input(folder)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["harmonics volts", "eccentric angle"])
def test_eva_raises_no_alarm(name, tmp_path):
    proved_by_eva(written(EVERY[name].made(), tmp_path / "fw"))


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["ellipse volts", "meng angle", "meng angle q31", "meng volts q31", "five Halls q31"]
)
def test_the_self_test_runs_every_line_and_branch(name, tmp_path):
    need("gcc", "clang", "gcov")
    folder = written(EVERY[name].made(), tmp_path / "fw")
    passes(folder, "-O0", compiler="clang")
    ran(folder, "gcc", "-std=c99", "-O0", "--coverage", *PATHS, *TESTED, "-o", "covered")
    ran(folder, "./covered")
    said = ran(folder, "gcov", "-b", "-n", *map(str, folder.glob("*-decoupler.gcda")))
    own = said[said.index("decoupler.c'") :]
    assert "Lines executed:100.00%" in own
    assert "Branches executed:100.00%" in own
