"""Sets of effects that a log cannot tell from a selected effect stand beside it.

Facts used: an encoder's error is its waves per turn. One wave is what two offsets make, two waves what a gain
mismatch and skewed axes make; eccentricity of chip and magnet makes both.
"""

import pytest
from test_diagnosis_turn import table

from hallsym.diagnosis import Diagnosis, diagnose
from hallsym.report.page.diagnosis_page import diagnosis_page
from hallsym.report.text.diagnosis import diagnosis_text

ONE_AND_TWO = {1: (0.3, 0.4), 2: (0.25, 1.3)}
"""Amplitude [deg] and phase [rad] of the waves of an encoder's error."""


@pytest.fixture(scope="module")
def of_a_table() -> Diagnosis:
    return diagnose(table(ONE_AND_TWO), "rotary_ideal")


def test_offset_gain_and_axes_stand_beside_an_eccentricity(of_a_table):
    d = of_a_table
    sets = [side for s in d.separate_by for side in s.sides]
    named = {e.name for e in d.effects}
    elementary = {"offset_error", "gain_mismatch", "orthogonality_error", "magnet_tilt"}
    assert "eccentricity" in named
    beside = [set(side) for side in sets if set(side) <= elementary and len(side) > 1]
    assert any("offset_error" in side for side in beside)
    assert all(any(set(s.group) == set(group) for group in d.groups) for s in d.separate_by)


def test_a_set_is_said_with_what_separates_it(of_a_table):
    d = of_a_table
    said = " ".join(diagnosis_text(d).split())
    for s in d.separate_by:
        assert s.recording
        if s.sides:
            together = " + ".join(s.sides[1])
            assert together in said
            assert together in diagnosis_page(d)
    assert Diagnosis.from_dict(d.to_dict()).separate_by == d.separate_by


@pytest.mark.xfail(strict=True, reason="open: one recording of four adds a gain mismatch to the eccentricity")
@pytest.mark.slow
def test_one_unit_calibrated_again_has_the_same_groups():
    """The same waves with other noise: the sets beside the eccentricity are the same."""
    groups = []
    for seed in range(4):
        d = diagnose(table(ONE_AND_TWO, seed=seed), "rotary_ideal")
        groups.append(({e.name for e in d.effects}, [s.sides for s in d.separate_by]))
    assert all(g == groups[0] for g in groups), groups
