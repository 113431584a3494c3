"""The 6-DOF precision stage read by three or more Hall probes: models and effects."""

from hallsym.families.stage import models
from hallsym.families.stage.checks import implausible
from hallsym.families.stage.effects import EFFECTS
from hallsym.log import LAYOUT
from hallsym.model import Family, PoseMetric

FAMILY = Family(
    name="stage",
    noun="stage",
    about="a stage (hall_a_m, ..., x_ref_m)",
    readings=r"hall_\w+_m",
    references=models.REFERENCES,
    moved=(*models.POSE, *models.STATE),
    pose_metric=PoseMetric("m", arm_m=0.35),
    models=(models.stage15, models.stage30, models.stage31, models.stage31_tied),
    default="stage31",
    aliases={"model15": "stage15", "model30": "stage30", "model31": "stage31"},
    from_meta=models.from_meta,
    effects=EFFECTS,
    words={"z_m": "height Z", "rx_rad": "tilt Rx", "ry_rad": "tilt Ry", "rz_ref_rad": "rotation Rz"},
    assumed="the paper's, A at (0.1975, 0.4), B at (-0.1975, 0.42), C at (0.1975, 0.36) m",
    together="height Z and tilts Rx, Ry",
    at_bounds=(
        (
            LAYOUT,
            "H*",
            "probe positions end at their bounds: is this the layout of your machine? State it with "
            "--machine FILE",
        ),
        (
            "gain",
            "eta_*",
            "gains end at their bounds: are readings and references in the units that their names say? A "
            "probe of another sensitivity is stated with --machine FILE",
        ),
    ),
    implausible=implausible,
)
models.FAMILY = FAMILY
