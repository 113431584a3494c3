"""The machine as a page draws it, from above."""

from hallsym.model.sketch import SIGNAL, Part

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
