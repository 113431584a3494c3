"""The campaign of Chen et al. (Sensors 2016, 16, 872), its noise, and the bundled log of it."""

from collections.abc import Mapping

import numpy as np

from hallsym.families import build, published
from hallsym.log import Log, read_log
from hallsym.model import Model
from hallsym.simulation.campaign import Campaign, Run, campaign_from
from hallsym.simulation.machine import NoiseModel
from hallsym.simulation.signals import sine

DESIGNED = "stage15"
"""The paper's first model, with its layout."""
ANGLE_NOISE = 0.3e-6
"""Rz of the interferometers [rad]: two beams at a distance of 0.4 m that differ by about 100 nm."""
VERTICAL_NOISE = {"z_m": 12e-9, "rx_rad": 80e-9, "ry_rad": 80e-9}
"""Capacitive sensors of 12 nm (Section 5 of the paper) on a base of about 150 mm."""


def bundled_campaign() -> Log:
    """Return the bundled log: 19 settings of Table 6 x 3 runs, simulated (data/campaign/README.md)."""
    return read_log(published.data_folder() / "campaign")


def is_the_papers(model: Model) -> bool:
    """Return whether a model is of the paper's machine: same family, probes at the same places."""
    paper = build(DESIGNED)
    return model.family is paper.family and model.layout == paper.layout


def paper_campaign(step_s: float = 2e-3, duration_s: float = 1.0) -> Campaign:
    """Return Table 6's 19 vertical settings, each with sines on Y, X and Rz, and Table A1's deviations.

    Sines of 500 um, 300 um and 300 urad at 1 Hz on a 2 ms clock (Section 5 of the paper). Runs are numbered
    from 0 in the order of Table A1: setting by setting, Y then X then Rz.
    """
    settings, deviations = published.table("table6_settings"), published.table("tableA1_zero_deviations")
    motions = {
        "y": {"y_m": sine(500e-6, 1.0)},
        "x": {"x_m": sine(300e-6, 1.0)},
        "rz": {"rz_rad": sine(300e-6, 1.0)},
    }
    vertical = {
        number: {axis: settings[axis][k] for axis in ("z_m", "rx_rad", "ry_rad")}
        for k, number in enumerate(settings["setting"])
    }
    runs = tuple(
        Run(duration_s, vertical[setting], motions[axis], (a, b, c))
        for setting, axis, a, b, c in zip(
            *(deviations[n] for n in ("setting", "axis", "delta_a_m", "delta_b_m", "delta_c_m")), strict=True
        )
    )
    return Campaign(step_s, runs)


def default_campaign(model: Model, step_s: float = 2e-3) -> Campaign:
    """Return the example of a model's family, else the paper's campaign on a clock of `step_s`."""
    example = model.family.example
    return campaign_from(example.campaign, f"example of {model.name}") if example else paper_campaign(step_s)


def table8_noise(model: Model, values: Mapping[str, float] | None = None) -> NoiseModel:
    """Return noise levels for which the paper's machine, perfectly calibrated, shows Table 8's RMSE.

    Equal independent noise of the three probes reproduces Rz, 2.3057 urad, and then explains only .4 um of
    the 1.54 um in Y: A and B both sense Y, so independent noise cannot do both. The rest in X and Y is common
    to the probes and is attributed to the reference.
    """
    p = model.vector(published.values("table7_estimates") if values is None else values)
    table = published.table("table8_errors_model31")
    rmse = np.array([table[c][table["quantity"].index("rmse")] for c in model.pose])
    rest = np.zeros(len(model.state))
    spread = np.asarray(model.noise_gain(p, rest, np.ones(len(model.channels))))
    per_probe = np.sum(spread**2, axis=1)
    probe = np.sqrt((rmse[2] ** 2 - ANGLE_NOISE**2) / per_probe[2])
    common = np.sqrt(np.maximum(rmse**2 - probe**2 * per_probe, 0.0))
    sigma = dict.fromkeys(model.channels, float(probe))
    sigma |= {c: float(s) for c, s in zip(model.references, common, strict=True)}
    return NoiseModel({**sigma, **VERTICAL_NOISE})
