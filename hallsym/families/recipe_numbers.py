"""Checks of the numbers in an effect's text."""

from hallsym.errors import InputError


def among(key: str, value: str, known: str) -> str:
    """Return `value` if it is one of the words in `known`; raises `InputError` otherwise."""
    names = known.split()
    if value not in names:
        raise InputError(f"An effect's {key} must be one of {', '.join(names)}; it is {value!r}.")
    return value


def positive(key: str, value: float) -> float:
    """Return `value` if it is positive and finite; raises `InputError` otherwise."""
    if not 0 < value < float("inf"):
        raise InputError(f"An effect's {key} must be a positive number; it is {value:g}.")
    return value
