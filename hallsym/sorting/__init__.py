"""Sort sensors by gain, and choose from an inventory the sets that an array decodes best with.

`readings` reads the table of a sorting bench, `bins` holds the probabilities, `sort` sorts. After Maguire,
UBC 2015, chapter 5. `influence` is the sensitivity of a model's pose to gains, `match` chooses the sets.
"""

from hallsym.sorting.bins import change_probability
from hallsym.sorting.match import Matching, match_sensors
from hallsym.sorting.readings import read_readings
from hallsym.sorting.sort import WIDTH, Sorting, sort_sensors

__all__ = [
    "WIDTH", "Matching", "Sorting", "change_probability", "match_sensors", "read_readings",
    "sort_sensors",
]  # fmt: skip
