"""Names in generated C: identifiers made from columns, and the prefix of one decoupler among several.

A column may be called anything in a log; an identifier is made from it, not copied. Generated texts are
written with the prefix `decoupler`; `renamed` gives a decoupler its own, so that several fit in one image.
"""

import re
from collections.abc import Iterable

from hallsym.errors import InputError, quoted
from hallsym.output import commented

PREFIX = "decoupler"
"""Prefix of symbols, files, include guards and the CMake target, unless another is given."""
LONGEST_LICENSE = 100
LONGEST_PREFIX = 24
"""Characters of a prefix: C99 promises 63 of an identifier, and the longest suffix has 30."""
_WORDS = """
alignas alignof and and_eq asm auto bitand bitor bool break case catch char class compl const constexpr
const_cast continue decltype default delete do double dynamic_cast else enum explicit export extern false
float for friend goto if inline int long mutable namespace new noexcept not not_eq nullptr operator or or_eq
private protected public register reinterpret_cast restrict return short signed sizeof static static_assert
static_cast struct switch template this thread_local throw true try typedef typeid typename typeof union
unsigned using virtual void volatile wchar_t while xor xor_eq
"""
_LOCAL = """
agreement angle_of around bad bits bytes crc difference field found high in k known left limit limited low
magnitude n out p pose pose_of result root scaled seen size size_of slopes slower status sum suspect suspected
upper value within without
"""
_HEADERS = """
assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign stdarg
stdatomic stdbool stddef stdint stdio stdlib stdnoreturn string strings tgmath threads time uchar unistd
wchar wctype
"""
HEADERS = frozenset(_HEADERS.split())
"""Headers of the C library, whose place a file of that name would take."""
KEYWORDS = frozenset(_WORDS.split())
"""Words of C11 and C++20 that no identifier can be; the header is for both."""
TAKEN = frozenset(_LOCAL.split())
"""Names that generated functions and status bits use themselves; of integers, lines are q1, q2, ... too."""


def identifier(text: str) -> str:
    """Return a C identifier for a column or a part of its name: itself where it is one.

    Any other character becomes `_xHH_` with its code in hexadecimal, so that different names stay different.

    >>> identifier("hall_a_m"), identifier("hall_x-1_m"), identifier("int")
    ('hall_a_m', 'hall_x_x2d_1_m', 'int_')
    """
    made = re.sub(r"[^A-Za-z0-9_]", lambda found: f"_x{ord(found[0]):02x}_", text)
    if not re.match(r"[A-Za-z]", made):
        made = f"c_{made}"
    taken = made in KEYWORDS or made.lower() in TAKEN or re.fullmatch(r"q\d+", made)
    return f"{made}_" if taken else made


def mapping(columns: Iterable[str]) -> dict[str, str]:
    """Return the identifiers of columns that are none themselves, by column.

    Raises `InputError` where two columns would share one.
    """
    made: dict[str, str] = {}
    for column in columns:
        other = made.setdefault(identifier(column), column)
        if other != column:
            raise InputError(
                f"Columns {quoted(other)} and {quoted(column)} would both be {identifier(column)} in C; "
                "rename one of them in the log (--column) and fit again."
            )
    return {column: name for name, column in made.items() if name != column}


def check_distinct(columns: Iterable[tuple[str, str]], outputs: Iterable[str], others: Iterable[str]) -> None:
    """Refuse columns (column, name in C) that are called like another, or like an entry or step of the code.

    Status bits and macros are in capitals, so names that differ by these alone are the same; `outputs` are
    the names whose macros begin with OUT_.
    """
    taken = {name.upper(): "a number of the code" for name in others}
    taken |= {f"OUT_{name}".upper(): "an output" for name in outputs}
    for column, name in columns:
        other = taken.get(name.upper())
        taken[name.upper()] = quoted(column)
        if other:
            raise InputError(
                f"Column {quoted(column)} would be called {commented(name)[:80]} in C, as {other} is; rename "
                "it in the log (--column) and fit again."
            )


def check_prefix(prefix: str) -> str:
    """Return the prefix; raise `InputError` where no C identifier could begin with it."""
    if not re.fullmatch(r"[a-z][a-z0-9_]*[a-z0-9]", prefix) or "__" in prefix or len(prefix) > LONGEST_PREFIX:
        raise InputError(
            f"--name must be 2 to {LONGEST_PREFIX} small letters, digits and single underscores, and begin "
            f"with a letter, such as enc_left; instead received {quoted(prefix)}."
        )
    if prefix in KEYWORDS:
        raise InputError(f"--name {prefix} is a word of C or C++; give another, such as {prefix}_1.")
    if prefix in HEADERS:
        raise InputError(
            f"--name {prefix} would make {prefix}.h, which is a header of the C library; give another, such "
            f"as {prefix}_1."
        )
    return prefix


def check_license(text: str) -> str:
    """Return an SPDX expression; raise `InputError` where it is none that a comment of C can hold."""
    word = r"[A-Za-z0-9][A-Za-z0-9.+:-]*"
    if len(text) > LONGEST_LICENSE or not re.fullmatch(rf"\(?{word}( (AND|OR|WITH) \(?{word}\)?)*\)?", text):
        raise InputError(
            "--license must be an SPDX expression, such as MIT or LicenseRef-ours; instead received "
            f"{quoted(text)}."
        )
    return text


def renamed(text: str, prefix: str) -> str:
    """Return a generated text, or the path of a file, with symbols and file names of another prefix."""
    if prefix == PREFIX:
        return text
    text = re.sub(rf"\b{PREFIX}(?=_[a-z]|\.[a-z])", prefix, text)
    return re.sub(rf"(?<![A-Za-z0-9]){PREFIX.upper()}(?=_[A-Z])", prefix.upper(), text)
