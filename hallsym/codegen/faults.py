"""Faults of a parameter table, as lines of C that make each and ask whether `decoupler_check()` finds it.

Each table is sealed with new CRC, so that the test behind the CRC has to find the fault.
"""

from collections.abc import Iterator, Mapping, Sequence

from hallsym.codegen.decoupler import Decoupler, short


def expect(changes: Sequence[str], faults: str = "0U") -> list[str]:
    """Return C that makes `changes` and expects these faults."""
    return [*changes, f"missed += unlike(&table, {faults});"]


def of_words() -> Iterator[str]:
    """Faults of the words before the entries."""
    yield from expect(["table.version += 1U;"], "DECOUPLER_BAD_VERSION")
    yield from expect(["table.layout ^= 1U;"], "DECOUPLER_BAD_LAYOUT")
    yield from expect(["table.length += 4U;"], "DECOUPLER_BAD_LAYOUT")
    yield from expect(["table.calibration[0] ^= 1U;"])
    both = ["table.version += 1U;", "table.layout ^= 1U;"]
    yield from expect(both, "DECOUPLER_BAD_VERSION | DECOUPLER_BAD_LAYOUT")


def of_several(d: Decoupler, limited: Sequence[str], zero: Sequence[str]) -> Iterator[str]:
    """Faults of every kind at once: each has a bit of its own. `zero`: C that makes a zero too large."""
    changes, found = ["table.version += 1U;", *zero], ["DECOUPLER_BAD_VERSION"]
    found += ["DECOUPLER_BAD_ZEROS"] * len(zero)
    if limited:
        name, symmetric = short(limited[0]), d.box.symmetric(limited[0])
        one, other = (f"limit_{name}",) * 2 if symmetric else (f"high_{name}", f"low_{name}")
        changes.append(f"table.{one} = {'-' if symmetric else ''}decoupler_params.{other};")
        changes += [] if symmetric else [f"table.{other} = decoupler_params.{one};"]
        found.append("DECOUPLER_BAD_LIMITS")
    yield from expect(changes, " | ".join(found))


def of_limits(
    d: Decoupler, limited: Sequence[str], zero: str, values: Mapping[str, float],
    accepted: Mapping[str, tuple[float, float]],
) -> Iterator[str]:  # fmt: skip
    """An empty range, one of a single value, and one of 0 and -0 (`zero`), of each input.

    `values`, `accepted`: of the limits, and their ends.
    """
    for column in limited:
        name = short(column)
        if d.box.symmetric(column):
            for value in (f"-decoupler_params.limit_{name}", zero, f"-{zero}"):
                yield from expect([f"table.limit_{name} = {value};"], "DECOUPLER_BAD_LIMITS")
        else:
            low, high = f"low_{name}", f"high_{name}"
            swapped = [f"table.{low} = decoupler_params.{high};", f"table.{high} = decoupler_params.{low};"]
            yield from expect(swapped, "DECOUPLER_BAD_LIMITS")
            least, greatest = accepted[low]
            single = "0U" if least <= values[high] <= greatest else "DECOUPLER_BAD_LIMITS"
            yield from expect([f"table.{low} = decoupler_params.{high};"], single)
