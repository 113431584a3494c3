"""Logs of known machines: campaigns, trajectories, noise, and the simulated machine."""

from hallsym.simulation.campaign import (
    MOST_SAMPLES,
    Campaign,
    Run,
    campaign_from,
    follow,
    noise_table,
    read_campaign,
    write_campaign,
)
from hallsym.simulation.machine import NoiseModel, simulate, simulate_blocks
from hallsym.simulation.paper import (
    bundled_campaign,
    default_campaign,
    is_the_papers,
    paper_campaign,
    table8_noise,
)
from hallsym.simulation.signals import Signal, multi_sine, sine, steps, triangle

__all__ = [
    "MOST_SAMPLES", "Campaign", "NoiseModel", "Run", "Signal", "bundled_campaign", "campaign_from",
    "default_campaign", "follow", "is_the_papers", "multi_sine", "noise_table", "paper_campaign",
    "read_campaign", "simulate", "simulate_blocks", "sine", "steps", "table8_noise", "triangle",
    "write_campaign",
]  # fmt: skip
