"""Every reader with damaged files: one sentence, in time, no other numbers in silence (damaged_files.py)."""

import pytest
from damaged_files import Workshop, targets

READERS = {target.name: target for target in targets()}
DEAR = {"fleet, continued": 8, "CSV log, fit": 12, "C, generated again": 12, "C, numbers alone": 12}
"""So many files of readers that take most of a second each; 40 of every other."""


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    pytest.importorskip("pyarrow")
    pytest.importorskip("h5py")
    return Workshop(tmp_path_factory.mktemp("damaged"))


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(READERS))
def test_a_damaged_file_is_refused_or_says_what_it_is(workshop: Workshop, name: str) -> None:
    found = [workshop.case(READERS[name], seed) for seed in range(DEAR.get(name, 40))]
    assert [outcome for outcome in found if outcome.fault] == []
    assert sum(outcome.kind in ("refused", "same numbers") for outcome in found) >= 0.4 * len(found)
