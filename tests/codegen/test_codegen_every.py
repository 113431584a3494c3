"""What holds for generated code of every kind, whatever the family and the arithmetic.

Independent facts: readings of a known pose; random inputs and any bits; float32 beside double; a zero; the
compiler's own sanitizers; the bits of another processor; instructions counted one by one in QEMU; cppcheck;
Frama-C EVA; gcov.
"""

from dataclasses import dataclass, replace
from itertools import product

import boards
import numpy as np
import pytest
from calibrations import fit_of, made
from firmware import (
    PATHS,
    SANITIZED,
    STAGES,
    TESTED,
    Library,
    every_input,
    instructions,
    need,
    passes,
    proved_by_eva,
    ran,
    undefined_symbols,
    written,
)
from waves import LENGTH

import hallsym
from hallsym.codegen import Generated
from hallsym.codegen.backend import COUNT
from hallsym.codegen.box import box_of
from hallsym.codegen.decoupler import FLAG_BITS, short, steps_on_arrays
from hallsym.codegen.lowering import rows

M0 = ("MACHINE=microbit", "CPU=-mcpu=cortex-m0 -mthumb")
M3 = ("MACHINE=mps2-an385", "CPU=-mcpu=cortex-m3 -mthumb")
M4 = ("MACHINE=mps2-an386", "CPU=-mcpu=cortex-m4 -mthumb")
M7 = ("MACHINE=mps2-an500", "CPU=-mcpu=cortex-m7 -mthumb -mfloat-abi=hard -mfpu=fpv5-sp-d16")
M7_INTEGERS = ("MACHINE=mps2-an500", "CPU=-mcpu=cortex-m7 -mthumb")


@dataclass(frozen=True)
class Kind:
    """Generated code of a case; most instructions of a call in range and of any, of one number of both.

    `quick`: tried in a fast run too. `cores`: other than its own whose bits are compared.
    """

    case: str
    most: tuple[int, ...] = ()
    quick: bool = False
    cores: tuple[tuple[str, ...], ...] | None = None
    variant: tuple[tuple[str, object], ...] = ()

    def made(self) -> Generated:
        return made(self.case, **dict(self.variant))

    def fit(self) -> hallsym.Fit:
        return fit_of(self.case)


Q31 = (("arithmetic", "q31"),)
ENCODERS = {
    "ellipse volts": ((130,), True), "meng volts": (), "harmonics volts": (),
    "ideal angle": (), "meng angle": ((100,), True), "eccentric angle": (),
}  # fmt: skip
"""Each kind of code: no table, entries of 16 or 32 bits, of either form."""
EVERY = {
    "stage31": Kind("stage31", (102, 122), True, (M0, M3, M7)),
    **{case: Kind(case, quick=case == "exact_rotation") for case in STAGES if case != "stage31"},
    "four probes": Kind("four probes", cores=()),
    "stage31 q31": Kind("stage31", (850,), True, (M3, M4, M7_INTEGERS), Q31),
    "four probes q31": Kind("four probes", cores=(), variant=Q31),
    "three sums": Kind("three sums", (190,), True, (M3,)),
    "five sums": Kind("five sums", cores=(M7,)),
    **{case: Kind(case) for case in ("first harmonic alone", "second harmonic", "halbach")},
    **{case: Kind(case) for case in boards.BOARDS if case != "tilted 24 sums"},
    "12 sums": Kind("12 sums", quick=True),
    "closed form of 12 sums": Kind("closed form of 12 sums", (550, 8200)),
    "24 sums": Kind("24 sums", (2800, 15_000)),
    "rows": Kind("rows", (4800,)),
    "travel": Kind("travel", cores=()),
    "five Halls q31": Kind("five Halls", (1300, 8500), variant=Q31),
    **{case: Kind(case, *more) for case, more in ENCODERS.items()},
    **{
        f"clipped {1e3 * accuracy:g} mrad": Kind("clipped", (182,), variant=(("accuracy", accuracy),))
        for accuracy in (5e-3, 1e-3)
    },
    **{
        f"{case} q31": Kind(case, (limit,), case == "meng angle", variant=Q31)
        for case, limit in (("meng angle", 40), ("meng volts", 515), ("ellipse volts", 490))
    },
    "clipped q31": Kind("clipped", (415,), variant=(*Q31, ("accuracy", 5e-3))),
}
EACH = [pytest.param(n, marks=() if k.quick else pytest.mark.slow) for n, k in EVERY.items()]


def poses_of(name, count, seed=3):
    """Random poses and states (n, s) of the box of a calibration; of what repeats, within half a period."""
    fit, rng = EVERY[name].fit(), np.random.default_rng(seed)
    model, box = fit.model, box_of(fit)
    low, high = np.array([box.ends[c] for c in (*model.pose, *model.state)]).T[..., None]
    half = [[0.5 if c in model.period else 1.0] for c in (*model.pose, *model.state)]
    return half * (low + (high - low) * rng.random((len(low), count)))


def inputs_of(name, at, near=0.0):
    """Readings [SI] at poses and states by the model's own equation, and what says the period."""
    fit, d = EVERY[name].fit(), EVERY[name].made().decoupler
    pose, state = np.split(at, [len(d.pose)])
    read = fit.model.readings(fit.values, pose, state)
    rows = dict(zip((*fit.model.channels, *fit.model.state), (*read, *state), strict=True))
    for c, row in rows.items():
        if c in fit.model.period:  # as a chip gives it
            rows[c] = row - fit.model.period[c] * np.round(row / fit.model.period[c])
    rows |= {f"{short(c)}_near_m": row + near for c, row in zip(d.pose, pose, strict=True)}
    return np.array([rows[c] for c in d.inputs])


def numbers_of(backend, inputs):
    """Inputs [SI] as numbers of an arithmetic, and what these are in SI."""
    scale = np.array([[port.scale] for port in backend.inputs])
    whole = np.mod(inputs / scale, 2**32) if backend.inputs[0].type == "uint32_t" else inputs / scale
    made_ = backend._rounded(np.clip(whole, *(side.astype(float) for side in backend.span)))
    return made_, made_.astype(float) * scale


def si(backend, pose):
    return pose.astype(float) * np.array([[port.scale] for port in backend.outputs])


@pytest.mark.parametrize("name", EACH)
def test_readings_of_a_pose_give_it_back(name):
    """The decoder of the reference inverts the model; the code is as near to it as it says."""
    code, at = EVERY[name].made(), poses_of(name, 300)
    backend, d, pose = code.backend, code.decoupler, at[: len(code.decoupler.pose)]
    inputs = inputs_of(name, at, np.random.default_rng(1).uniform(-0.2, 0.2, 300) * LENGTH)
    exact = np.abs(d.difference(d.exact(inputs), pose)).max(axis=1)
    given, rounded = numbers_of(backend, inputs)
    moved = np.abs(d.difference(d.exact(rounded), pose)).max(axis=1)
    found, status = backend.step(given)
    off = np.abs(d.difference(si(backend, found), pose)).max(axis=1)
    assert not status.any()
    assert (off <= np.array([backend.error_bound[c] for c in d.pose]) + moved).all()
    assert (exact < (1e-9 if not name.startswith("clipped") else 1e-7)).all()


@pytest.mark.parametrize("name", EACH)
def test_rounding_stays_within_its_bound_of_weak_fields_too(name):
    """The same arithmetic in float32 and in double; where a polynomial turns it leaves twice what it may."""
    code, rng = EVERY[name].made(), np.random.default_rng(8)
    d, backend = code.decoupler, code.backend
    if backend.type != "float":
        return
    low, high = backend.span
    inputs = low + (high - low) * rng.random((len(low), 20_000)) if d.drawn is None else d.drawn(rng, 20_000)
    given, rounded = numbers_of(backend, inputs)
    found, status = backend.step(given)
    exact = steps_on_arrays(d)(rounded, d.constants)[0]
    off = np.abs(d.difference(found.astype(float), exact))[:, status == 0]
    bound = np.array([code.bounds.error[c] for c in d.pose])
    assert (np.quantile(off, 0.9, axis=1) <= bound).all()
    assert (off.max(axis=1) <= bound + 2 * np.array([d.left(c) for c in d.pose])).all()
    assert (off.max(axis=1) > bound / 50).all()  # of many readings not all round alike


@pytest.mark.parametrize("name", ["exact_rotation", "cubic"])
def test_the_rounding_of_iterations_is_bounded_near_what_is_met_at_corners_of_the_box(name):
    """All readings and states at or near their ends, where an iteration settles slowest."""
    code, rng = EVERY[name].made(), np.random.default_rng(12)
    d, (low, high) = code.decoupler, code.backend.ends
    share = np.abs(rng.integers(0, 2, (len(low), 100_000)) - 0.02 * rng.random((len(low), 100_000)))
    inputs = (low + (high - low) * share).astype(np.float32)
    exact = steps_on_arrays(d)(inputs.astype(float), d.constants)[0]
    off = np.abs(code.backend.step(inputs)[0] - exact).max(axis=1)
    bound = np.array(list(code.bounds.error.values()))
    assert (off <= bound).all()
    assert (bound < 10 * off).all()


@pytest.mark.parametrize("name", ["ellipse volts", "three sums"])
def test_readings_reversed_about_their_centers_are_a_pose_half_a_period_away_and_the_header_says_so(name):
    code, at = EVERY[name].made(), poses_of(name, 300)
    backend, d, inputs = code.backend, code.decoupler, inputs_of(name, at)
    center = np.array(d.listed[0])[:, None]  # no field
    found, status = backend.step(numbers_of(backend, 2 * center - inputs)[0])
    assert not status.any()
    off = np.abs(d.difference(si(backend, found), at))[0]
    assert np.allclose(off, d.model.period[d.pose[0]] / 2, rtol=1e-4)
    assert "All readings reversed about their centers" in code.files["decoupler.h"]


ZEROS = ("stage31", "exact_rotation", "ellipse volts", "three sums", "meng angle q31")


@pytest.mark.parametrize("name", [*ZEROS, pytest.param("cubic", marks=pytest.mark.slow)])
def test_a_zero_is_taken_wherever_the_machine_is(name, tmp_path):
    """It moves every pose alike, but of a finite rotation; one that cannot be leaves the table as it was."""
    need("gcc")
    code, at, known = EVERY[name].made(), poses_of(name, 30), poses_of(name, 30, seed=4)
    backend, d = code.backend, code.decoupler
    library = Library(written(code, tmp_path / "fw"), code)
    most = 3 * np.array([code.backend.error_bound[c] for c in d.pose])
    given, true = numbers_of(backend, inputs_of(name, at))[0], at[: len(d.pose)]
    for k, (inputs, zero) in enumerate(zip(given.T, known[: len(d.pose)].T, strict=True)):
        wanted = zero / [port.scale for port in backend.outputs]
        wanted = wanted if backend.type == "float" else np.round(wanted).astype(np.int64)
        assert library.zero(inputs, wanted) == 0
        for j in (k, k - 1) if name not in ("exact_rotation", "cubic") else (k,):
            pose, status = library.step(given[:, j])
            moved = zero + true[:, j] - true[:, k]
            assert status == 0
            assert (np.abs(d.difference(si(backend, pose[:, None]), moved[:, None]))[:, 0] <= most).all()
    assert library.check() == 0  # the zeros have a CRC of their own
    taken = library.table.copy()
    if backend.type == "float":
        assert library.zero(np.full(len(inputs), np.nan), wanted) & sum(set(d.input_bits)) != 0
        for value in (np.nan, 1e9):
            assert library.zero(inputs, np.append(wanted[:-1], value)) == 1 << 31
    assert (library.table == taken).all()


FIELD, TILTED, COVER = 0x40000000, 0x20000000, 0x10000000
SLOW = pytest.mark.slow
ELSEWHERE = [
    ("three sums", 1, 0.0025, FIELD), ("three sums", 1, 0.05, FIELD), ("12 sums", 2, 0.013, FIELD),
    ("12 sums", 2, 0.5, FIELD), ("12 sums", 3, 0.02, TILTED),
    *(pytest.param(*row, marks=SLOW) for row in (
        ("rows", 2, 0.012, FIELD), ("rows", 3, 0.03, TILTED), ("rows", 0, 0.051, COVER), ("rows", 0, 0.2, 0),
        ("travel", 0, 0.15, 0), ("travel", 1, 1.5e-3, FIELD)
    )),
]  # fmt: skip


@pytest.mark.parametrize(("name", "coordinate", "value", "bit"), ELSEWHERE)
def test_a_machine_beyond_its_box_raises_a_flag(name, coordinate, value, bit):
    """0: some flag."""
    backend, at = EVERY[name].made().backend, poses_of(name, 100)
    at[coordinate] = value
    found, status = backend.step(numbers_of(backend, inputs_of(name, at))[0])
    assert (status & bit == bit).all()
    assert status.all()
    assert np.isfinite(found).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "reach", "level", "tilt"),
    [
        ("rows", boards.ROWS_REACH, [2e-3, -1e-3, 5e-3, 3e-3, -2e-3, 2e-3], 5e-6),
        ("travel", boards.REACH, [0, 5e-3], 0),
    ],
)
def test_no_coordinate_steps_as_sensors_come_and_go(name, reach, level, tilt):
    """From end to end of the board in steps of 10 um: every sensor comes and goes."""
    backend, at = EVERY[name].made().backend, np.arange(-reach, reach, 1e-5)
    for axis in range(2 if tilt else 1):
        pose = np.tile(np.array(level)[:, None], len(at))
        pose[axis] = at
        off = backend.step(numbers_of(backend, inputs_of(name, pose))[0])[0] - pose
        moved = np.abs(np.diff(off, axis=1)).max(axis=1)
        assert (moved[:3] < 5e-7).all()
        assert (moved[3:] < tilt).all()


@pytest.mark.slow
def test_rows_of_sensors_need_the_period_alone_and_agree_with_the_decoder_of_the_model():
    """hallsym's own decoder: weighted least squares of the finite field, from its own start."""
    code, fit, at = EVERY["rows"].made(), EVERY["rows"].fit(), poses_of("rows", 150)
    both = [
        code.backend.step(numbers_of(code.backend, inputs_of("rows", at, near * LENGTH))[0])[0]
        for near in (-0.2, 0.2)
    ]
    assert (both[0] == both[1]).all()
    weight = [1 / fit.noise.sigmas[c].value ** 2 for c in fit.model.channels]
    readings = list(inputs_of("rows", at)[:-2])
    found = fit.model.decode(fit.values, [], readings, [], weight, list(at))
    assert np.abs(found - at).max() < 1e-7
    assert (np.abs(both[0] - found).max(axis=1) <= list(code.backend.error_bound.values())).all()


@pytest.mark.slow
def test_arrays_that_end_beyond_all_sensors_are_decoded_as_fixed_patches():
    fit = boards.rows(length=12 * LENGTH, reach=0.01)
    weight = np.array([1 / fit.noise.sigmas[c].value ** 2 for c in fit.model.channels])
    assert rows.decoupler(fit.model, fit.values, weight, box_of(fit), 2e-5) is None


@pytest.mark.slow
def test_a_tilted_mover_is_decoded_within_what_its_sums_resolve():
    """At 10 mrad: less than the .7 um and 1.5 urad that all sensors leave of an independent plant."""
    backend, at = EVERY["24 sums"].made().backend, poses_of("24 sums", 3000)
    off = backend.step(numbers_of(backend, inputs_of("24 sums", at))[0])[0] - at
    rms = np.sqrt((off**2).mean(axis=1))
    assert (rms[:3] < 4e-7).all()
    assert (rms[3:] < 1.5e-6).all()


@pytest.mark.parametrize("name", ["stage31", "grid of 24", pytest.param("grid of 48", marks=SLOW)])
def test_each_input_has_a_bit_of_its_own_or_with_its_neighbours(name, tmp_path):
    """The bits of the flags are above those of the inputs; the self-test tries each of these."""
    need("gcc")
    code, bits = EVERY[name].made(), EVERY[name].made().decoupler.input_bits
    count = len(bits)
    own = FLAG_BITS - len(code.decoupler.flags) - code.decoupler.mends
    assert len(set(bits)) == min(count, own)
    assert max(bits) < min(1 << own, 1 << count)
    assert ("*status |= bit;" in code.files["decoupler.c"]) == (count > own)
    status = code.backend.vectors.status[COUNT : COUNT + 6 * count].reshape(count, 6)
    assert (status & np.array(bits)[:, None] > 0).all()
    library = Library(written(code, tmp_path / "fw"), code)
    inputs = numbers_of(code.backend, inputs_of(name, poses_of(name, 60)))[0]
    ends = code.backend.ends[1][:, 0]
    for k, value in product(range(count), (np.nan, np.inf, -np.inf, 1.01)):
        given = inputs[:, k % inputs.shape[1]].copy()
        given[k] = value * (ends[k] if value == 1.01 else 1.0)
        out, said = library.step(given)
        assert said & ((1 << own) - 1) == bits[k]
        assert np.isfinite(out).all()
    out, said = library.step(np.full(count, np.nan, np.float32))
    assert said & ((1 << own) - 1) == sum(set(bits))
    assert out.tobytes() == code.backend.step(np.full((count, 1), np.nan))[0].astype(np.float32).tobytes()


@pytest.mark.parametrize("count", [72, 200])
def test_bits_of_any_number_of_readings_are_shared_by_neighbours(count):
    """Each bit by as many as any other, or one more."""
    d = EVERY["grid of 24"].made().decoupler
    bits = replace(d, inputs=tuple(map(str, range(count)))).input_bits
    assert list(bits) == sorted(bits)
    shared = [bits.count(1 << k) for k in range(FLAG_BITS - len(d.flags) - d.mends)]
    assert sum(shared) == count
    assert max(shared) - min(shared) <= 1


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
    if not d.sampled:  # else of poses alone
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
        assert max(others) <= kind.most[-1]
    if name not in ("rows", "travel"):  # cppcheck takes too long
        ran(folder, "make", "misra")
    if code.decoupler.evident:
        proved_by_eva(folder, integers=code.backend.type == "q31")
    if name in ("stage31", "stage31 q31", "meng angle q31", "ellipse volts q31"):
        every_input(folder)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["harmonics volts", "eccentric angle"])
def test_eva_raises_no_alarm(name, tmp_path):
    proved_by_eva(written(EVERY[name].made(), tmp_path / "fw"))


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["stage31", "ellipse volts", "meng angle", "meng angle q31", "meng volts q31", "five Halls q31"]
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
