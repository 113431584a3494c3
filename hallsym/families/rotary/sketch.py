"""The machine as a page draws it, along its shaft."""

from hallsym.model.sketch import SIGNAL, Part

SKETCH = (
    Part(
        "reference", "reference", "M48 85a62 62 0 0 1 62 -62M40 85a70 70 0 0 1 70 -70", (2.0, 26.0),
        centred=False,
    ),
    Part("mechanics", "shaft", "M110 39a46 46 0 1 0 .01 0z", (110.0, 145.0)),
    Part("field", "magnet", "M110 57a26 26 0 1 0 .01 0zM110 57v52", (110.0, 123.0)),
    Part(
        "transducer", "Hall plates", "M104 21h12v12h-12zM166 73h12v12h-12zM178 79h54", (122.0, 30.0),
        centred=False,
    ),
    *SIGNAL,
)  # fmt: skip
