"""The one exception that a user's input can cause."""


class InputError(ValueError):
    """Bad input: its message is one sentence with what, where, what was expected and what to do.

    The command line prints it and exits with status 2; a script catches it as `ValueError`.
    """


def nearest(name: str, known: list[str]) -> str:
    """Return `" (did you mean 'x'?)"` for the closest known name, or an empty string."""
    from difflib import get_close_matches

    hit = get_close_matches(name, known, n=1, cutoff=0.5)
    return f" (did you mean '{hit[0]}'?)" if hit else ""
