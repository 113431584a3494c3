"""The 6-DOF precision stage read by three or more Hall probes: models and effects."""

from hallsym.families.stage import models
from hallsym.families.stage.effects import EFFECTS
from hallsym.model import Family, PoseMetric
from hallsym.model.family import SIGNAL, Part

SKETCH = (
    Part("reference", "reference", "M4 20h40v18h-40zM44 29h76v6", (4.0, 14.0), centred=False),
    Part("mechanics", "stage", "M70 35h100v90h-100z", (120.0, 76.0)),
    Part(
        "field", "magnets", "M73 68h9v22h-9zM158 68h9v22h-9zM109 113h22v9h-22z", (120.0, 107.0)
    ),
    Part(
        "transducer", "Hall probes", "M50 73h11v12h-11zM178 73h11v12h-11zM114 133h12v11h-12zM189 79h43",
        (174.0, 54.0), centred=False,
    ),
    *SIGNAL,
)  # fmt: skip
"""The machine as a page draws it."""
FAMILY = Family(
    name="stage",
    noun="stage",
    about="a stage (hall_a_m, ..., x_ref_m)",
    readings=r"hall_\w+_m",
    pose_metric=PoseMetric("m", arm_m=0.35),
    models=(models.stage15, models.stage30, models.stage31, models.stage31_tied),
    default="stage31",
    aliases={"model15": "stage15", "model30": "stage30", "model31": "stage31"},
    from_meta=models.from_meta,
    effects=EFFECTS,
    words={"z_m": "height Z", "rx_rad": "tilt Rx", "ry_rad": "tilt Ry", "rz_ref_rad": "rotation Rz"},
    sketch=SKETCH,
    together="height Z and tilts Rx, Ry",
)
models.FAMILY = FAMILY
