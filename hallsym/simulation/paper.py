"""The campaign of Chen et al. (Sensors 2016, 16, 872), simulated and bundled."""

from hallsym.families import published
from hallsym.log import Log, read_log


def bundled_campaign() -> Log:
    """Return the bundled log: 19 settings of Table 6 x 3 runs, simulated (data/campaign/README.md)."""
    return read_log(published.data_folder() / "campaign")
