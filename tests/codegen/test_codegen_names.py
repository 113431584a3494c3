"""Names in generated code: made from columns, several in one image, and what compilers are told."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from calibrations import fit_of
from firmware import calibration, known, need, ran
from hypothesis import given
from hypothesis import strategies as st

import hallsym
from hallsym.codegen import generate
from hallsym.codegen.naming import KEYWORDS, TAKEN, commented, identifier, mapping
from hallsym.errors import InputError
from hallsym.log import Noise

STRICT = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Werror", "-ffp-contract=off")
NAMES = ("stage", "enc_left", "enc_right")


@given(st.text(max_size=30))
def test_whatever_a_column_is_called_its_name_in_c_is_an_identifier(text):
    name = identifier(text)
    assert name.isascii()
    assert name.isidentifier()
    assert name not in KEYWORDS | TAKEN
    assert "\n" not in commented(text)
    assert "*/" not in commented(text)


PREFIXES = (
    "", "2nd", "Left", "a__b", "_a", "float", "x" * 25, "a b", "a/../b", "a\n", "math", "stdint", "string",
)  # fmt: skip
LICENCES = ("", "MIT */", "MIT\nint x;", "MIT OR", "x" * 101, "MIT // x")


@pytest.mark.parametrize(
    "option", [*(("name", n) for n in PREFIXES), *(("license", text) for text in LICENCES)]
)
def test_a_prefix_and_a_licence_that_c_does_not_take_are_refused(option):
    with pytest.raises(InputError, match=f"--{option[0]}"):
        generate(calibration(), **dict([option]))
    with pytest.raises(InputError, match="would both be hall_x_x2d_1_m"):
        mapping(("hall_x-1_m", "hall_x_x2d_1_m"))


def foreign(*channels):
    """The calibration of a stage whose probes have other names."""
    fit = calibration()
    layout = tuple(
        replace(probe, channel=channel)
        for probe, channel in zip(hallsym.families.stage.models.paper_layout(), channels, strict=True)
    )
    model = hallsym.families.stage.models.stage31(layout)
    sigmas = {c: fit.noise.sigmas[old] for c, old in zip(channels, fit.model.channels, strict=True)}
    return known(model, fit.values, noise=Noise(sigmas))


@pytest.mark.parametrize("arithmetic", ["float", "q31"])
@pytest.mark.parametrize(
    "column",
    ["zero_x_m", "limit_z_m", "gain_hall_b_m", "x_hall_b_m", "now_hall_b_m", "Z_m", "z_m", "out_x_m"],
)
def test_a_probe_that_is_called_like_a_number_of_the_code_is_refused(column, arithmetic):
    with pytest.raises(InputError, match=r"would be called .* in C, as .* is; rename it"):
        generate(foreign(column, "hall_b_m", "hall_c_m"), arithmetic=arithmetic)


EVIL = ("hall_x-1_m", "hall_a; int evil; float q_m", "hall_*/ #error \n_m")
LIKE_FUNCTIONS = [
    ("upper_m", "limited_m", "within_m"), ("q1_m", "left_m", "known_m"), ("negative_m", "field_m", "size_m"),
]  # fmt: skip


@pytest.mark.parametrize("arithmetic", ["float", "q31"])
@pytest.mark.parametrize("names", [EVIL, *(pytest.param(n, marks=pytest.mark.slow) for n in LIKE_FUNCTIONS)])
def test_probes_of_any_name_give_code_that_compiles(tmp_path, names, arithmetic):
    need("gcc", "make")
    made = generate(foreign(*names), arithmetic=arithmetic)
    for column, name in mapping(names).items():
        assert made.to_dict()["identifiers"][column] == name
    texts = [str(text).replace("a; int evil; float q", "") for text in made.files.values()]
    assert not any("int evil" in text for text in texts)
    made.write(tmp_path / "fw")
    assert "0 faults of a table not found" in ran(tmp_path / "fw", "make", "check")


@pytest.fixture(scope="module")
def image(tmp_path_factory):
    """A stage and two encoders, floats and integers, with prefixes of their own, and a program with all."""
    folder = tmp_path_factory.mktemp("image")
    generate(calibration(), name="stage").write(folder / "stage")
    generate(fit_of("meng volts"), name="enc_left", license="MIT OR Apache-2.0").write(folder / "enc_left")
    generate(fit_of("meng angle"), arithmetic="q31", name="enc_right").write(folder / "enc_right")
    uses = "".join(f"    bad |= {n}_check(&{n}_params);\n" for n in NAMES)
    includes = "".join(f'#include "{n}.h"\n#include "{n}_params.h"\n' for n in NAMES)
    body = f"    uint32_t bad = 0U;\n{uses}    return (int)bad;\n"
    program = f"{includes}int main(void);\nint main(void)\n{{\n{body}}}\n"
    (folder / "main.c").write_text(program)
    return folder


def sources(folder):
    paths = [f"-I{n}" for n in NAMES]
    files = [f"{n}/{file}" for n in NAMES for file in (f"{n}.c", f"{n}_check.c", f"{n}_params.c")]
    return (*paths, *files)


M4F = ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16", "-ffreestanding")
COMPILERS = {"gcc": (), "clang": (), "arm-none-eabi-gcc": M4F}


@pytest.mark.slow
@pytest.mark.parametrize("compiler", COMPILERS)
def test_three_decouplers_compile_without_a_warning_and_link_into_one_image(image, compiler):
    need(compiler)
    if COMPILERS[compiler]:
        for source in sources(image)[len(NAMES) :]:
            paths = sources(image)[: len(NAMES)]
            ran(image, compiler, *STRICT, *COMPILERS[compiler], *paths, "-c", source, "-o", "x.o")
        return
    ran(image, compiler, *STRICT, *sources(image), "main.c", "-o", compiler)
    ran(image, f"./{compiler}")


COMPILED = ("-std=c99", "-O2", "-Istage", "-c", "stage/stage.c", "-o", "x.o")
REORDERED = (("-fassociative-math", "-fno-signed-zeros", "-fno-trapping-math"), ("-freciprocal-math",))
"""What lets a compiler compute another number than IEEE 754; gcc takes the first with the others only."""
GCC = ("gcc", "arm-none-eabi-gcc")
NO_NAN, OTHER_ORDER = "NaN must be told from numbers", "bounds and bits are those of IEEE 754"
REFUSED = [
    (compiler, source, (flag,), NO_NAN)
    for compiler in (*GCC, "clang")
    for source in ("stage.c", "stage_check.c")
    for flag in ("-ffast-math", "-Ofast", "-ffinite-math-only")
] + [
    (compiler, "stage.c", flags, OTHER_ORDER)
    for compiler in GCC
    for flags in (*REORDERED, ("-funsafe-math-optimizations",))
]


@pytest.mark.parametrize(("compiler", "source", "flags", "says"), REFUSED)
def test_another_arithmetic_is_refused_by_compilers_that_tell_it(image, compiler, source, flags, says):
    need(compiler)
    with pytest.raises(AssertionError, match=says):
        ran(image, compiler, *(a.replace("stage.c", source) for a in COMPILED), *flags)


HARMLESS = [(compiler, ("-fno-signed-zeros", "-fno-trapping-math")) for compiler in ("gcc", "clang")]
UNDONE = [pytest.param("clang", flags, marks=pytest.mark.slow) for flags in REORDERED]


@pytest.mark.parametrize(("compiler", "flags"), [*HARMLESS, *UNDONE])
def test_flags_that_are_not_refused_change_no_bit(image, compiler, flags):
    need(compiler, "make")
    folder = image / "enc_left"
    ran(folder, "make", "clean")
    said = ran(folder, "make", "check", f"CC={compiler} {' '.join(flags)}")
    assert said.count("as stated") == 2
    assert "0 faults of a table not found, 0 zeros wrong" in said


@pytest.mark.slow
def test_the_self_test_finds_a_flag_that_clang_does_not_tell(tmp_path):
    """A range of two ends is tested by comparisons, which -fno-honor-nans may take for true."""
    need("clang", "make")
    generate(calibration(), ranges={"z_m": (-1e-4, 2.5e-4)}).write(tmp_path / "fw")
    assert ran(tmp_path / "fw", "make", "check", "CC=clang").count("as stated") == 2
    ran(tmp_path / "fw", "make", "clean")
    with pytest.raises(AssertionError, match="vectors failed"):
        ran(tmp_path / "fw", "make", "check", "CC=clang -fno-honor-nans")


def test_every_file_says_its_licence_what_made_it_and_of_which_calibration(image):
    for name, licence in (("stage", "LicenseRef-generated"), ("enc_left", "MIT OR Apache-2.0")):
        folder = image / name
        digest = re.search(r"SHA256 \"(\w+)\"", (folder / f"{name}_params.h").read_text())[1]
        for path in folder.rglob("*"):
            inside = path.relative_to(folder)
            if not path.is_file() or path.suffix == ".bin" or inside.parts[0] in ("build", "manifest.json"):
                continue  # bytes of a flash page, what tests compiled, and the list of all
            head = "".join(path.read_text().splitlines(keepends=True)[:6])
            if path.suffix == ".json":
                record = json.loads(path.read_text())
                assert record["license"] == licence, path
                continue
            assert f"SPDX-License-Identifier: {licence}" in head, path
            assert f"hallsym {hallsym.__version__} from calibration {digest[:16]}" in head, path


# -- packages ------------------------------------------------------------------------------------------------


USER = """
#include "enc_left.h"
#include "enc_left_params.h"
int main(void) { return (int)enc_left_check(&enc_left_params); }
"""


@pytest.mark.slow
def test_an_installed_library_is_found_by_its_name(image, tmp_path):
    need("cmake", "gcc")
    installed = tmp_path / "installed"
    ran(image, "cmake", "-S", "enc_left", "-B", str(tmp_path / "b"), f"-DCMAKE_INSTALL_PREFIX={installed}")
    ran(image, "cmake", "--build", str(tmp_path / "b"), "--target", "install")
    ran(image, "cmake", "-S", "enc_left", "-B", str(tmp_path / "t"), "-DENC_LEFT_SELFTEST=ON")
    ran(image, "cmake", "--build", str(tmp_path / "t"))
    assert "0 of" in ran(tmp_path / "t", "./enc_left_selftest")
    user = tmp_path / "user"
    user.mkdir()
    (user / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.13)\nproject(user C)\nfind_package(enc_left 3 REQUIRED)\n"
        "add_executable(user main.c)\ntarget_link_libraries(user enc_left::enc_left)\n"
    )
    (user / "main.c").write_text(USER)
    ran(user, "cmake", "-S", ".", "-B", "b", f"-DCMAKE_PREFIX_PATH={installed}")
    ran(user, "cmake", "--build", "b")
    ran(user, "b/user")


@pytest.mark.parametrize("name", NAMES)
def test_packages_name_files_that_are_there(image, name):
    folder = image / name
    library = json.loads((folder / "library.json").read_text())
    assert library["name"] == name
    headers = {path.name for path in folder.glob("*.h")}
    assert headers == set(library["headers"])
    module = (folder / "zephyr/module.yml").read_text()
    assert f"name: {name}\n" in module
    listed = (folder / "zephyr/CMakeLists.txt").read_text()
    for source in re.findall(r"\.\./(\S+\.c)", listed):
        assert (folder / source).exists()
    assert f"CONFIG_{name.upper()}_LIB" in listed
    assert f"config {name.upper()}_LIB" in (folder / "zephyr/Kconfig").read_text()


ZEPHYR = """
cmake_minimum_required(VERSION 3.13)
project(image C)
macro(zephyr_library_named name)
  set(library ${name})
  add_library(${library} STATIC)
endmacro()
macro(zephyr_library_sources)
  target_sources(${library} PRIVATE ${ARGV})
endmacro()
macro(zephyr_library_compile_options)
  target_compile_options(${library} PRIVATE ${ARGV})
endmacro()
macro(zephyr_include_directories)
  target_include_directories(${library} PUBLIC ${ARGV})
endmacro()
set(CONFIG_ENC_LEFT_LIB y)
add_subdirectory(MODULE/zephyr module)
add_executable(image main.c)
target_link_libraries(image enc_left)
"""
"""Zephyr's functions as its own CMake files define them, as far as a module of one library goes."""


def test_the_zephyr_module_builds_with_a_stand_in_of_its_functions(image, tmp_path):
    need("cmake", "gcc")
    (tmp_path / "CMakeLists.txt").write_text(ZEPHYR.replace("MODULE", str(image / "enc_left")))
    (tmp_path / "main.c").write_text(USER)
    ran(tmp_path, "cmake", "-S", ".", "-B", "b", "-DCMAKE_POLICY_DEFAULT_CMP0076=NEW")
    ran(tmp_path, "cmake", "--build", "b")
    ran(tmp_path, "b/image")


def test_the_update_over_a_serial_line_takes_good_tables_only(image):
    """The C of docs/controller.md, with the table that it is about."""
    need("gcc")
    text = (Path(__file__).parents[2] / "docs/controller.md").read_text()
    code = text.split("```c\n")[1].split("```")[0]
    trial = """
#include <stdio.h>
static int32_t sent(const uint8_t *bytes, uint32_t count, uint32_t length)
{
    const uint8_t head[] = {7U, 'H', 'H', 'S', (uint8_t)length, (uint8_t)(length >> 8U)};
    int32_t result = -1;
    for (uint32_t k = 0U; k < sizeof(head); k++) { result = received(head[k]); }
    for (uint32_t k = 0U; (k < count) && (result == -1); k++) { result = received(bytes[k]); }
    return result;
}
int main(void)
{
    static uint8_t bytes[4096];
    uint32_t identity[2];
    static stage_params_t kept;
    const stage_in_t in = {0};
    const stage_out_t known = {1e-4F, 0.0F, 0.0F};
    stage_out_t pose;
    FILE *file = fopen("stage/table/stage_params.bin", "rb");
    const uint32_t count = (uint32_t)fread(bytes, 1U, sizeof(bytes), file);
    int bad = start(&kept) | start(NULL);
    bad |= (reset_done(&in, &known) == 0U) ? 0 : 32;
    bad |= (live == &tables[1]) ? 0 : 1;
    bad |= (every_100_us(&in, &pose) == 0U) && (pose.x_m > 0.99e-4F) ? 0 : 64;
    kept = *live;
    bad |= start(&kept);
    bad |= (every_100_us(&in, &pose) == 0U) && (pose.x_m > 0.99e-4F) ? 0 : 128;
    bad |= (sent(bytes, count, count) == 0) ? 0 : 2;
    bad |= (live == &tables[1]) ? 0 : 4;
    bytes[100] ^= 4U;
    bad |= (sent(bytes, count, count) == STAGE_BAD_CRC) ? 0 : 8;
    bytes[100] ^= 4U;
    bad |= (sent(bytes, count, count - 1U) == STAGE_BAD_LAYOUT) ? 0 : 16;
    bad |= (sent(bytes, 4000U, 4000U) == STAGE_BAD_LAYOUT) ? 0 : 16;
    bad |= (live == &tables[1]) ? 0 : 16;
    running(identity);
    printf("%08x%08x", (unsigned)identity[0], (unsigned)identity[1]);
    return bad;
}
"""
    (image / "update.c").write_text(code + trial)
    files = ["stage/stage.c", "stage/stage_check.c", "stage/stage_params.c"]
    warned = ("-std=c99", "-Wall", "-Wextra", "-Werror")
    ran(image, "gcc", *warned, *sources(image)[:2], "update.c", *files, "-o", "update")
    record = json.loads((image / "stage/table/stage_params.json").read_text())
    assert ran(image, "./update") == record["calibration_sha256"][:16]
