"""The machines as a page draws them: an array from the side, a planar mover from above."""

from hallsym.model.family import SIGNAL, Part

REFERENCE = Part("reference", "reference", "M4 44h32v18h-32zM36 53h14", (4.0, 38.0), centred=False)

BOXES = "".join(f"M{x} 104h24v26h-24z" for x in range(20, 212, 24))
ARROWS = "".join(
    ("M{0} 124v-13l-3 4m3 -4l3 4", "M{1} 117h13l-4 -3m4 3l-4 3", "M{0} 110v13l-3 -4m3 4l3 -4",
     "M{2} 117h-13l4 -3m-4 3l4 3")[k % 4].format(x + 12, x + 5, x + 19)
    for k, x in enumerate(range(20, 212, 24))
)  # fmt: skip
SENSORS = "".join(f"M{x} 70h9v8h-9z" for x in range(60, 160, 15))

SKETCH = (
    REFERENCE,
    Part("mechanics", "mover", "M50 46h122v18h-122z", (111.0, 59.0)),
    Part("field", "magnet array", BOXES + ARROWS, (116.0, 146.0)),
    Part("transducer", "Hall sensors", SENSORS + "M159 74h60v5h13", (178.0, 66.0), centred=False),
    *SIGNAL,
)

ARRAYS = "".join(
    f"M{x} {y}h46v38h-46z" + "".join(f"M{x + 9 * k} {y}v38" for k in range(1, 5)) if upright
    else f"M{x} {y}h46v38h-46z" + "".join(f"M{x} {y + 8 * k}h46" for k in range(1, 5))
    for x, y, upright in ((62, 30, True), (122, 30, False), (62, 94, False), (122, 94, True))
)  # fmt: skip
GRID = "".join(f"M{x} {y}h5v5h-5z" for x in (190, 202, 214) for y in range(40, 140, 16))

PLANAR = (
    Part("reference", "reference", "M4 26h32v18h-32zM36 35h20", (2.0, 18.0), centred=False),
    Part("mechanics", "mover", "M56 24h118v114h-118z", (115.0, 86.0)),
    Part("field", "magnet arrays", ARRAYS, (115.0, 152.0)),
    Part("transducer", "Hall sensors", GRID + "M219 79h13", (182.0, 32.0), centred=False),
    *SIGNAL,
)
