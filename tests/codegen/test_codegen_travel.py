"""C for an array that travels over a longer board: absolute place and gap, sensors weighted as they see it.

Independent facts: the finite field of magnetised rectangles at a known pose; hallsym's own decoder, which
fits all readings with that field; a place moves by as much as the mover does, also where sensors come and go.
"""

from functools import cache

from msgspec import structs
from waves import calibrated

import hallsym
from hallsym.families.halbach.effects import ends
from hallsym.families.halbach.layout import columns
from hallsym.families.halbach.models import halbach
from hallsym.model import on_arrays

VALUES = {"a1": 0.62, "b1": 0.11, "a5": -6e-4, "b5": -8e-4, "edges": 1.0}
REACH, GAPS = 0.08, (0.004, 0.007)
FIELD, COVER = 0x40000000, 0x20000000


@cache
def fit_of(count=18, reach=REACH):
    """A board of 18 columns at 10 mm, an array of three periods, a third of it over no sensor at the ends."""
    places = [(j - (count - 1) / 2) * 0.01 for j in range(count)]
    fit = calibrated(ends.array_edges(halbach(columns(places, length_m=0.09))), VALUES, gaps=GAPS, sigma=1e-3)
    return fit.changed(log=structs.replace(fit.log, span={"x_ref_m": (-reach, reach), "z_ref_m": GAPS}))


@cache
def made():
    return hallsym.generate(fit_of())


def read(x, z):
    fit = fit_of()
    return on_arrays(fit.model.reading)(fit.values, [], [x, z], [])[0]
