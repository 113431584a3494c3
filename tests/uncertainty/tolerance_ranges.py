"""Ranges of machines whose tolerances are studied."""

from hallsym.families.published import bounds

SMALL = {
    **{f"H{k}{axis}_um": 100 for k in (1, 2, 3) for axis in "xy"},
    **{f"eta_{k}_percent": 0.03 for k in "ABC"},
    **{f"theta_{k}_mrad": 0.25 for k in "ABC"},
}
"""Small enough for the error to be linear in them to 1e-3."""
COUPLED = {f"{q}_{k}_per_{u}": 100 for q, u in (("a", "m"), ("b", "rad"), ("c", "rad")) for k in "ABC"}
PAPER = bounds()
