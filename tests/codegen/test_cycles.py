"""`make count`: cycles of Arm's tables, by hand for a few instructions."""

import re
import subprocess
from pathlib import Path

import pytest
from firmware import GOLDEN, need, ran

from hallsym.cli.main import main
from hallsym.codegen.templates import ROOT

SCRIPT = ROOT / "common/test/cycles.awk"
PROGRAM = {
    0x8000: ("b510", "push", "{r4, lr}"),
    0x8002: ("ed90 7a00", "vldr", "s14, [r0]"),
    0x8006: ("ee27 7a27", "vmul.f32", "s14, s14, s15"),
    0x800A: ("ee87 7a27", "vdiv.f32", "s14, s14, s15"),
    0x800E: ("eea6 7a27", "vfma.f32", "s14, s12, s15"),
    0x8012: ("bf88", "it", "hi"),
    0x8014: ("60c1", "strhi", "r1, [r0, #12]"),
    0x8016: ("d001", "beq.n", "801c <decoupler_step+0x1c>"),
    0x8018: ("fba0 2301", "umull", "r2, r3, r0, r1"),
    0x801C: ("4348", "muls", "r0, r1"),
    0x801E: ("bd10", "pop", "{r4, pc}"),
    0x8020: ("eb00 0181", "add.w", "r1, r0, r1, lsl #2"),
    0x8024: ("f9b1 1040", "ldrsh.w", "r1, [r1, #64]"),
    0x8028: ("4b01", "ldr", "r3, [pc, #4]"),
    0x802A: ("bd10", "pop", "{r4, pc}"),
    0x9000: ("4770", "bx", "lr"),
}
CALLER = 0x9000


def said(tmp_path, core, *calls):
    """What the script says of these programs counters; each call is followed by its caller's."""
    listing, log = tmp_path / "listing", tmp_path / "log"
    rows = [f"    {pc:x}:\t{code:10s}\t{what}\t{how}\n" for pc, (code, what, how) in PROGRAM.items()]
    listing.write_text("".join(rows))
    trace = [pc for call in calls for pc in (*call, CALLER)]
    log.write_text("".join(f"Trace 0: 0x7f [00000000/{pc:08x}/00000000/ff] name\n" for pc in trace))
    given = {"core": core, "name": "f", "start": "8000", "size": "2c", "caller": "9000", "caller_size": "2"}
    options = [text for pair in given.items() for text in ("-v", "=".join(pair))]
    done = subprocess.run(["awk", *options, "-f", SCRIPT, listing, log], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


FLOATS = (0x8000, 0x8002, 0x8006, 0x800A, 0x800E, 0x8012, 0x8014, 0x8016, 0x801C, 0x801E)
INTEGERS = (0x8000, 0x8014, 0x8016, 0x8018, 0x801C, 0x801E)


def test_floats_on_a_cortex_m4f(tmp_path):
    need("awk")
    counted, cycles = said(tmp_path, "cortex-m4", FLOATS, INTEGERS)
    assert counted == "f, 44 bytes, instructions per call: 10 6"
    # push 3, load 2, product 1 (2: needed next), quotient 14 (15), fused 3, it 0-1, store 1-2, branch 2-4,
    # product 1, pop 3 and the pipeline 1-3; push 3, store 1-2, branch not taken 1, products 1 and 1, pop 4-6
    low, high = 3 + 2 + 1 + 14 + 3 + 0 + 1 + 2 + 1 + 4, 3 + 2 + 2 + 15 + 3 + 1 + 2 + 4 + 1 + 6
    assert cycles.endswith(f"Cortex-M4 without wait states: {low}-{high} 11-14")


def test_integers_on_smaller_cores(tmp_path):
    need("awk")
    assert said(tmp_path, "cortex-m3", INTEGERS)[1].endswith(": 13-18")  # umull 3-5
    moved = tuple(pc for pc in INTEGERS if pc != 0x8018)  # a Cortex-M0 has no umull; the branch is taken
    assert said(tmp_path, "cortex-m0", moved)[1].endswith(": 15-46")  # 3 + 2 + 3 + (1 or 32) + 6


@pytest.mark.parametrize("core", ["cortex-m3", "cortex-m4"])
def test_an_address_that_was_just_computed_comes_later(tmp_path, core):
    need("awk")
    # push 3, sum 1, load 1-2 and 1 for its address, load 1-2 and 0-1 beside the program counter, pop as above
    low, high = 3 + 1 + (1 + 1) + 1 + 4, 3 + 1 + (2 + 1) + (2 + 1) + 6
    assert said(tmp_path, core, (0x8000, 0x8020, 0x8024, 0x8028, 0x802A))[1].endswith(f": {low}-{high}")


def test_a_cortex_m0plus_branches_sooner(tmp_path):
    need("awk")
    taken = (0x8000, 0x8014, 0x8016, 0x801C, 0x801E)
    small = said(tmp_path, "cortex-m0plus", taken)[1]
    # push 3, store 2, branch 2, product 1 or 32, pop 5
    assert small.endswith(f"Cortex-M0+ without wait states: {3 + 2 + 2 + 1 + 5}-{3 + 2 + 2 + 32 + 5}")


def test_no_cycles_where_no_manual_states_them(tmp_path):
    need("awk")
    assert said(tmp_path, "cortex-m7", FLOATS)[1].endswith("not stated for this core")


def test_a_called_function_counts_until_its_caller_goes_on(tmp_path):
    need("awk")
    PROGRAM[0xA000] = ("4770", "bx", "lr")
    try:
        assert said(tmp_path, "cortex-m4", (0x8000, 0xA000, 0x801E))[0].endswith(": 3")
    finally:
        del PROGRAM[0xA000]


@pytest.mark.parametrize("core", ["cortex-m4", pytest.param("cortex-m7", marks=pytest.mark.slow)])
def test_of_generated_code(tmp_path, core):
    need("arm-none-eabi-gcc", "qemu-system-arm", "make", "awk")
    folder = Path(tmp_path / "fw")
    assert main(["codegen", str(GOLDEN / "calib.json"), "-o", str(folder)]) == 0
    options = f"CPU=-mcpu={core} -mthumb -mfloat-abi=hard -mfpu=fpv4-sp-d16"
    ran(folder, "make", "count", options, *(["MACHINE=mps2-an500"] if core == "cortex-m7" else []))
    text = (folder / "doc/instructions.txt").read_text()
    step = re.search(r"cycles of decoupler_step per call, Cortex-M. without wait states: (.*)", text)[1]
    if core == "cortex-m7":
        assert step == "not stated for this core"
        return
    counts = re.search(r"decoupler_step, \d+ bytes, instructions per call: (.*)", text)[1].split()
    ranges = [tuple(map(int, part.split("-"))) for part in step.split()]
    assert len(ranges) == len(counts) == 5
    for count, (least, most) in zip(map(int, counts), ranges, strict=True):
        # three divisions of 14 and some thirty loads of 2
        assert count + 3 * 13 + 20 <= least <= most <= 2 * count + 3 * 13
