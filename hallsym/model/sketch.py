"""A sketch of a machine: its parts as outlines, each of the link of the chain that it stands for."""

from dataclasses import dataclass

WIDTH, HEIGHT = 360.0, 172.0
"""Size of a sketch [px]."""


@dataclass(frozen=True)
class Part:
    """A part of a machine: its name, and its outline as SVG path data in a box of `WIDTH` x `HEIGHT`.

    `link`: of `hallsym.model.LINKS`; lit where it is at fault. `at`: where the name begins, or its middle
    where it is `centred`.
    """

    link: str
    name: str
    outline: str
    at: tuple[float, float]
    centred: bool = True


SIGNAL = (
    Part("electronics", "amplifier, ADC", "M232 79h26M258 62h98v34h-98z", (307.0, 83.0)),
    Part("clock", "clock", "M307 110a14 14 0 1 0 .01 0zM307 115v9l6 4", (307.0, 153.0)),
)
"""What follows the transducer in every machine; its cable begins at (232, 79)."""
