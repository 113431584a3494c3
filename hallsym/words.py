"""Counts as they are said."""


def counted(number: int, thing: str) -> str:
    """Return a count with its noun.

    >>> counted(1, "run"), counted(22, "held-out run")
    ('1 run', '22 held-out runs')
    """
    return f"{number} {thing}{'' if number == 1 else 's'}"
