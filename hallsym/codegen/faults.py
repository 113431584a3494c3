"""Faults of a parameter table, as lines of C that make each and ask whether `decoupler_check()` finds it.

Each table is sealed with new CRC, so that the test behind the CRC has to find the fault; values just inside a
limit must be found good.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from math import inf, prod

from hallsym.codegen.accepted import Ends
from hallsym.codegen.bounds import LEAST_GAIN
from hallsym.codegen.decoupler import Decoupler, short

JUST = 0.02
"""How far a tried value lies on either side of a limit, relative: far above the rounding of the check."""
Setter = Callable[[str, float], str | None]
"""`(entry, value in SI) -> C` that sets an entry; None where its numbers cannot hold the value."""


def expect(changes: Sequence[str | None], faults: str = "0U") -> list[str]:
    """Return C that makes `changes` and expects these faults; nothing where a change cannot be made."""
    if None in changes:
        return []
    return [*(f"{change}" for change in changes), f"missed += unlike(&table, {faults});"]


def of_words() -> Iterator[str]:
    """Faults of the words before the entries."""
    yield from expect(["table.version += 1U;"], "DECOUPLER_BAD_VERSION")
    yield from expect(["table.layout ^= 1U;"], "DECOUPLER_BAD_LAYOUT")
    yield from expect(["table.length += 4U;"], "DECOUPLER_BAD_LAYOUT")
    yield from expect(["table.calibration[0] ^= 1U;"])
    both = ["table.version += 1U;", "table.layout ^= 1U;"]
    yield from expect(both, "DECOUPLER_BAD_VERSION | DECOUPLER_BAD_LAYOUT")


def of_several(d: Decoupler, limited: Sequence[str], zero: str | None, gain: str = "") -> Iterator[str]:
    """Faults of every kind at once: each has a bit of its own. `gain`: what is found of a gain of nothing."""
    changes, found = ["table.version += 1U;"], ["DECOUPLER_BAD_VERSION"]
    if limited:
        name, symmetric = short(limited[0]), d.box.symmetric(limited[0])
        one, other = (f"limit_{name}",) * 2 if symmetric else (f"high_{name}", f"low_{name}")
        changes.append(f"table.{one} = {'-' if symmetric else ''}decoupler_params.{other};")
        changes += [] if symmetric else [f"table.{other} = decoupler_params.{one};"]
        found.append("DECOUPLER_BAD_LIMITS")
    if d.margins and gain:
        changes.append(f"table.{d.margins[0].rest} = 0;")
        found.append(gain)
    if zero:
        changes.append(zero)
        found.append("DECOUPLER_BAD_ZEROS")
    yield from expect(changes, " | ".join(found))


def of_limits(
    d: Decoupler, limited: Sequence[str], zero: str = "", ends: Ends | None = None
) -> Iterator[str]:
    """An empty range, one of a single value, and one of 0 and -0 of numbers (`zero`), of each input.

    `ends`: least and greatest values of the limits, if any.
    """
    for column in limited:
        name = short(column)
        if d.box.symmetric(column):
            entry = f"limit_{name}"
            yield from expect([f"table.{entry} = -decoupler_params.{entry};"], "DECOUPLER_BAD_LIMITS")
            none = [f"table.{entry} -= decoupler_params.{entry};"]
            yield from expect(none, "DECOUPLER_BAD_LIMITS" if zero else "0U")
            if zero:
                yield from expect([f"table.{entry} = -{zero};"], "DECOUPLER_BAD_LIMITS")
        else:
            low, high = f"low_{name}", f"high_{name}"
            swapped = [f"table.{low} = decoupler_params.{high};", f"table.{high} = decoupler_params.{low};"]
            yield from expect(swapped, "DECOUPLER_BAD_LIMITS")
            least, greatest = (ends or {}).get(low, (-inf, inf))
            single = "0U" if least <= d.ends(column)[1] <= greatest else "DECOUPLER_BAD_LIMITS"
            yield from expect([f"table.{low} = decoupler_params.{high};"], single)


def of_margins(d: Decoupler, reach: Mapping[str, float], write: Setter) -> Iterator[str]:
    """Gains that the range of an input brings near zero, term by term and together."""
    values = {e.name: e.value for e in d.entries}
    for margin in d.margins:
        rest, terms = values[margin.rest], {e: prod(reach[c] for c in own) for e, own in margin.terms}
        none = [write(entry, 0.0) for entry in terms]
        for sign in (1.0, -1.0):
            yield from expect([*none, write(margin.rest, sign * rest)])
        yield from expect([*none, write(margin.rest, 0.0)], "DECOUPLER_BAD_GAIN")
        terms = {entry: most for entry, most in terms.items() if most > 0}
        for share, faults in ((1 - JUST, "0U"), (1 + JUST, "DECOUPLER_BAD_GAIN")):
            alone = [{entry: sign * share / most} for entry, most in terms.items() for sign in (1.0, -1.0)]
            together = [{entry: share / most / len(terms) for entry, most in terms.items()}]
            for shares in (*alone, *(together if len(terms) > 1 else ())):
                # terms in units of what the gain at rest leaves, which is lowered until integers hold them
                for own in (rest, rest * 0.125, rest * 0.125**2, rest * 0.125**3):
                    most = (1 - LEAST_GAIN) * abs(own)
                    found = [write(entry, most * part) for entry, part in shares.items()]
                    if None not in found:
                        yield from expect([*none, write(margin.rest, own), *found], faults)
                        break
