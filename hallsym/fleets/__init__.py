"""Many devices: one fit a log, spread over processes or a cluster, and what the devices have in common.

`sources` lists the devices, `row` is what one device gives, `fleet` spreads them over `workers` and keeps
what is done; `spread` says how parameters differ between devices and which devices differ from the others,
`result` what to expect of the next ones.
"""

from hallsym.fleets.fleet import fleet
from hallsym.fleets.jig import RingFleet, jig_of, ring_fleet
from hallsym.fleets.result import Fleet, load_fleet, machine_file, tolerance_file
from hallsym.fleets.sources import Device, devices_of
from hallsym.fleets.spread import Spread, spread_of
from hallsym.fleets.workers import Failed, completed

__all__ = [
    "Device", "Failed", "Fleet", "RingFleet", "Spread", "completed", "devices_of", "fleet", "jig_of",
    "load_fleet", "machine_file", "ring_fleet", "spread_of", "tolerance_file",
]  # fmt: skip
