"""The Hall rotary encoder, read as two voltages or as an angle: models and effects."""

from hallsym.families.rotary import models, rings
from hallsym.families.rotary.checks import implausible
from hallsym.families.rotary.effects import EFFECTS, RING_EFFECTS, direct, short
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
RING = Family(
    name="ring",
    noun="encoder",
    about="a ring under several Halls (hall1_count, hall2_count, ...; angle_ref_rad)",
    readings=rings.HEADS,
    references=models.REFERENCES,
    moved=models.POSE,
    pose_metric=PoseMetric("rad"),
    models=(rings.rings3,),
    default="rings3",
    from_meta=rings.from_meta,
    tables=("encoder",),
    assumed="three Halls that share a period evenly over one pole pair",
    effects=RING_EFFECTS,
    # two speeds in both directions; Halls of a 12-bit converter, at not quite 120 deg
    example=Example(
        campaign=FAMILY.example.campaign if FAMILY.example else {},
        values={
            "V1": 2050.0, "V2": 2031.0, "V3": 2066.0, "A1": 905.0, "A2": 880.0, "A3": 912.0, "place_2": 2.11,
            "place_3": 4.17, "zero": 0.6,
        },
        noise={"hall1_count": 1.2, "hall2_count": 1.2, "hall3_count": 1.2, "angle_ref_rad": 2e-5},
    ),
    direct=direct,
    short=short,
    most_effects=6,
    decoder="angle",
)  # fmt: skip
rings.RING = RING
