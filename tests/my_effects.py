"""An effect of somebody's own, as `--effects` reads it from a file."""

from hallsym.model import Parameter, rate


def speed_gain(model):
    """Gain that follows the velocity of x."""
    slope = Parameter("speed_gain", 0.0, -100.0, 100.0, "s/m")

    def step(s, p):
        s["gain"] = s["gain"] * (1 + p["speed_gain"] * s["d1_x_ref_m"])

    wide = model.with_columns(rate("x_ref_m"))
    return wide.with_step("transducer", step, effect="speed_gain", parameters=(slope,))


EFFECTS = (speed_gain,)
