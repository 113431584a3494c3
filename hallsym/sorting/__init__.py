"""Sort sensors by gain, and choose from an inventory the sets that an array decodes best with.

`readings` reads the table of a sorting bench, `bench` makes measurements of it, `drift` smooths the reference
sensor, `seating` refuses, `bins` holds the probabilities, `sort` puts it together. After Maguire, UBC 2015,
chapter 5. `influence` asks a model what a gain does to its pose, `exchange` arranges sensors, `match` chooses
the sets.
"""

from hallsym.sorting.bins import bins_of, change_probability, fit_changes, wrong_probability
from hallsym.sorting.drift import Smooth, smooth
from hallsym.sorting.influence import Influence, alike, influence_of_gains, summed, without_common
from hallsym.sorting.match import Matching, Way, match_sensors
from hallsym.sorting.readings import Readings, read_readings, readings_from
from hallsym.sorting.result import METHODS, Drift, Repeats, Sorting
from hallsym.sorting.seating import Refusal, Scatter
from hallsym.sorting.sort import WIDTH, sort_sensors

__all__ = [
    "METHODS",
    "WIDTH",
    "Drift",
    "Influence",
    "Matching",
    "Readings",
    "Refusal",
    "Repeats",
    "Scatter",
    "Smooth",
    "Sorting",
    "Way",
    "alike",
    "bins_of",
    "change_probability",
    "fit_changes",
    "influence_of_gains",
    "match_sensors",
    "read_readings",
    "readings_from",
    "smooth",
    "sort_sensors",
    "summed",
    "without_common",
    "wrong_probability",
]
