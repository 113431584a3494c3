"""The one exception that a user's input can cause."""


class InputError(ValueError):
    """Bad input: its message is one sentence with what, where, what was expected and what to do.

    The command line prints it and exits with status 2; a script catches it as `ValueError`.
    """


def nearest(name: str, known: list[str]) -> str:
    """Return `" (did you mean 'x'?)"` for the closest known name, or an empty string."""
    from difflib import get_close_matches

    folded = {k.lower(): k for k in reversed(known)}
    hit = get_close_matches(name.lower(), list(folded), n=1, cutoff=0.5)
    return f" (did you mean '{folded[hit[0]]}'?)" if hit else ""


def counted(number: int, thing: str) -> str:
    """Return a count with its noun.

    >>> counted(1, "run"), counted(22, "held-out run")
    ('1 run', '22 held-out runs')
    """
    return f"{number} {thing}{'' if number == 1 else 's'}"
