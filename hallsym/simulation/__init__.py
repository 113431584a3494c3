"""Logs of machines that are known: campaigns, trajectories, noise, and the simulated machine."""

from hallsym.simulation.campaign import (
    AtTimes,
    Campaign,
    Run,
    Signal,
    campaign_from,
    multi_sine,
    noise_table,
    ramp,
    read_campaign,
    sine,
    steps,
    triangle,
    write_campaign,
)
from hallsym.simulation.machine import NoiseModel, scaled, simulate, simulate_blocks
from hallsym.simulation.paper import bundled_campaign, is_the_papers, paper_campaign, table8_noise

__all__ = [
    "AtTimes",
    "Campaign",
    "NoiseModel",
    "Run",
    "Signal",
    "bundled_campaign",
    "campaign_from",
    "is_the_papers",
    "multi_sine",
    "noise_table",
    "paper_campaign",
    "ramp",
    "read_campaign",
    "scaled",
    "simulate",
    "simulate_blocks",
    "sine",
    "steps",
    "table8_noise",
    "triangle",
    "write_campaign",
]
