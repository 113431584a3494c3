"""The Hall rotary encoder, read as two voltages or as an angle: models and effects."""

from hallsym.families.rotary import models
from hallsym.families.rotary.checks import implausible
from hallsym.families.rotary.effects import EFFECTS, direct, short
from hallsym.model import Example, Family, PoseMetric

FAMILY = Family(
    name="rotary",
    noun="encoder",
    about="an encoder (v_sin_v and v_cos_v, or angle_rad; angle_ref_rad)",
    readings=r"v_(sin|cos)_v|angle_rad",
    references=models.REFERENCES,
    moved=models.POSE,
    pose_metric=PoseMetric("rad"),
    models=(models.rotary_ideal, models.rotary, models.rotary_meng),
    default="rotary",
    aliases={"ideal_arctan": "rotary_ideal", "ellipse": "rotary", "meng": "rotary_meng"},
    from_meta=models.from_meta,
    effects=EFFECTS,
    # two speeds in both directions, situation a of the paper's Table 2, and noise of 0.02 deg
    example=Example(
        campaign={
            "step_s": 1e-3,
            "run": [
                {"duration_s": 1.0, "angle_rad": {"kind": "ramp", "rate": rate, "about": about}}
                for rate, about in ((13.0, 0.0), (-13.0, 13.0), (40.0, 0.0), (-40.0, 40.0))
            ],
        },
        values={
            "Vx": 0.008943, "Vy": 0.000491, "Ax": 1.008607, "Ay": 0.994536, "beta": 0.000368, "m": 0.113,
            "A": 1.0, "zero": 0.6,
        },
        noise={"v_sin_v": 3.5e-4, "v_cos_v": 3.5e-4, "angle_rad": 3.5e-4, "angle_ref_rad": 2e-5},
    ),
    implausible=implausible,
    direct=direct,
    short=short,
    pairs=True,
    most_effects=6,
    decoder="angle",
)  # fmt: skip
models.FAMILY = FAMILY
