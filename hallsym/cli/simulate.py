"""`hallsym simulate`: the log a known machine would record.

Simulate a campaign of a machine with known parameters: the paper's by default (Table 6 settings,
sines at 1 Hz, 2 ms clock, Table A1 deviations, noise that reproduces Table 8), or any from TOML.
"""

from argparse import Namespace

from hallsym.cli import OK
from hallsym.cli.common import campaign_of, levels, progress_of, say, truth_of
from hallsym.families.machine_file import read_machine
from hallsym.log import LogWriter
from hallsym.output import Step
from hallsym.simulation import NoiseModel, simulate_blocks

OPTIONS = """
campaign TOML <optional>        campaign file (default: the paper's campaign, or the example of the
    model's family)
-o, --output LOG <required>     log to write: .parquet or .csv
--seed SEED <seed, required>    of noise and random zero deviations
--values JSON                   calibration whose values are the truth (default: published or
    example values)
--noise-scale NOISE_SCALE <float=1.0>  factor on every noise level; 0 for a noise-free log
--step S <float>                clock of the paper's campaign [s] (default 0.002)
@model that of the axes moved, else stage31
"""


def run(options: Namespace) -> int:
    """Carry the command out."""
    machine = read_machine(options.machine)
    campaign = campaign_of(options)
    model, values = truth_of(options, machine, campaign)
    sigma = levels(campaign, model, values)
    noise = NoiseModel({c: s * options.noise_scale for c, s in sigma.items()})
    show, done = progress_of(options), 0
    with LogWriter(options.output) as writer:
        for block in simulate_blocks(model, values, campaign, noise, seed=options.seed):
            writer.append(block)
            done += len(block["run"])
            share = done / campaign.rows
            show(Step(f"simulating, {100 * share:.0f} % of {campaign.rows} samples", share))
    record = {
        "log": str(options.output), "rows": campaign.rows, "runs": len(campaign.runs), "model": model.name,
        "values": dict(values), "noise": dict(noise.sigma), "seed": options.seed,
    }  # fmt: skip
    say(
        options,
        record,
        lambda: f"wrote {options.output}: {campaign.rows} samples in {len(campaign.runs)} runs",
    )
    return OK
