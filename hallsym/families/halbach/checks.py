"""What has to be said of a log of a Halbach array before it is fitted: stroke, wavelength, sensors."""

from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.families.halbach.layout import Array, arrays, sensors
from hallsym.model import Inspection, Model

SAMPLES = 4000
"""Samples of a log that are looked at, evenly over all runs."""
LEAST_STROKE = 0.25
"""Stroke, in wavelengths, that a fit needs: less tells amplitude and phase of a harmonic hardly apart."""
WHOLE = 0.99
"""Stroke, in wavelengths, from which on the wavelength of the magnets shows by itself: a whole one, of which
the last sample and the reference's noise may take a little."""
SILENT = 0.1
"""Amplitude of a channel, over the median of all, below which it sees no field."""
FOLLOWS = 0.5
"""Share of the variation that the field at the stated wavelength must explain, of half of the channels."""
OFF = 0.02
"""Relative difference of the wavelength in a log from the nominal one that is refused: the fifth harmonic of
a board of three periods is then half a radian off."""
COVERED = 0.5
"""Share of the samples in which the array must be over a channel, where the model takes it for endless."""
LEAST_UNDER = 10
"""Samples at which the array must be over a channel for it to have an amplitude and a phase."""
TRIED = np.geomspace(0.5, 2.0, 401)
"""Wavelengths, over the nominal one, at which the field of a log is looked for."""


def inspect(model: Model, log: Any, *, fitted: bool = True) -> Inspection:
    """Refuse a log that the array of a layout cannot have made; note what it cannot tell.

    Raises `InputError` for a stroke that is too short, a mover beyond the sensors, a channel that sees no
    field, and another wavelength.
    """
    (array,) = arrays(model.layout).values()
    log.table.require((*model.references, *model.channels))
    pick = np.unique(np.linspace(0, log.rows - 1, SAMPLES).astype(int))
    x, z = (log.array(c)[pick] for c in model.references)
    v = np.array([log.array(c)[pick] for c in model.channels])
    good = np.isfinite(x) & np.isfinite(z) & np.isfinite(v).all(axis=0)
    if good.sum() < 10:
        return Inspection()
    x, z, v = x[good], z[good], v[:, good]
    _inside(model, array, x, log.name)
    if not fitted:
        return Inspection()
    stroke = float(np.ptp(x)) / array.wavelength_m
    if stroke < LEAST_STROKE:
        raise InputError(
            f"Column {model.references[0]} of {log.name} covers {1e3 * np.ptp(x):.3g} mm, {stroke:.2f} of a "
            f"wavelength ({1e3 * array.wavelength_m:g} mm); amplitude and phase need a quarter at least, and "
            "gains, offsets and places a whole one."
        )
    under = _under(model, array, x)
    _covered(model, array, under, log.name)
    harmonic = _Harmonic(x, z, v, under)
    share, silent = harmonic.explained(array.wavelength_m)
    if silent.any() and not silent.all():
        name = model.channels[int(np.flatnonzero(silent)[0])]
        raise InputError(
            f"Channel {name} of {log.name} hardly sees the field (its amplitude is under "
            f"{100 * SILENT:.0f} % of the others'): it lies outside the array, or is not "
            "connected; leave it out of the layout."
        )
    _wavelength(array, harmonic, float(np.median(share)), stroke, log.name)
    notes = []
    if stroke < WHOLE:
        notes.append(
            f"The stroke of {1e3 * np.ptp(x):.3g} mm stays within one wavelength "
            f"({1e3 * array.wavelength_m:g} mm): gains, places and "
            "the wavelength share what they explain; record a longer stroke."
        )
    return Inspection(tuple(notes))


def _inside(model: Model, array: Array, x: np.ndarray, name: str) -> None:
    """Refuse poses at which the array stands over no sensor of the board."""
    places = np.array([s.middle[0] for s in sensors(model.layout)])
    beyond = np.maximum(x.min() - places.max(), 0), np.maximum(places.min() - x.max(), 0)
    far = max(x.max() - places.max(), places.min() - x.min(), *beyond)
    if far > array.length_m / 2:
        raise InputError(
            f"Column {model.references[0]} of {name} goes {1e3 * far:.4g} mm beyond the outermost sensor, "
            f"where an array of {1e3 * array.length_m:g} mm is over none; check the zero and the unit of the "
            "reference, or state 'periods' and the places of all sensors."
        )


def _under(model: Model, array: Array, x: np.ndarray) -> np.ndarray:
    """Whether each channel (K, n) is under the array."""
    places = np.array([s.middle[0] for s in sensors(model.layout)])
    return np.asarray(np.abs(places[:, None] - x) < array.length_m / 2)


def _covered(model: Model, array: Array, under: np.ndarray, name: str) -> None:
    """Refuse sensors that the array hardly is over, unless the model knows the ends of the array."""
    share = under.mean(axis=1)
    least = int(np.argmin(share))
    if share[least] < COVERED and "edges" not in model.names:
        sensor = sensors(model.layout)[least]
        raise InputError(
            f"Channel {sensor.channel} of {name}, at {1e3 * sensor.middle[0]:.4g} mm, is outside the field "
            f"in {100 * (1 - share[least]):.0f} % of the samples, beyond the ends of an array of "
            f"{1e3 * array.length_m:g} mm; fit with --effect array_edges, correct 'periods' (length_m), or "
            "leave it out."
        )


class _Harmonic:
    """What one harmonic explains of readings v (K, n), of the samples at which the array is over a channel.

    By normal equations of all channels at once: the wavelength is looked for among some 400.
    """

    def __init__(self, x: np.ndarray, z: np.ndarray, v: np.ndarray, under: np.ndarray) -> None:
        self.x, self.above = x, z - z.min()
        self.weight = under.astype(float)
        count = self.weight.sum(axis=1, keepdims=True)
        self.enough = count[:, 0] >= LEAST_UNDER
        self.v = self.weight * (v - (self.weight * v).sum(axis=1, keepdims=True) / np.maximum(count, 1))
        self.power = np.maximum(np.sum(self.v**2, axis=1), 1e-300)

    def explained(self, wavelength: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the share of each channel's variation (K,), and which channels see hardly any field (K,)."""
        k = 2 * np.pi / wavelength
        fade = np.exp(-k * self.above)
        basis = np.array([np.ones_like(self.x), fade * np.cos(k * self.x), fade * np.sin(k * self.x)])
        gram = self.weight @ (basis[:, None] * basis).reshape(9, -1).T
        moments = self.v @ basis.T
        found = np.einsum("kij,kj->ki", np.linalg.pinv(gram.reshape(-1, 3, 3), hermitian=True), moments)
        left = np.maximum(self.power - np.sum(found * moments, axis=1), 0.0)
        share = np.where(self.enough, 1 - left / self.power, 0.0)
        size = np.where(self.enough, np.hypot(found[:, 1], found[:, 2]), np.nan)
        return share, size < SILENT * np.nanmedian(size)


def _wavelength(array: Array, harmonic: _Harmonic, share: float, stroke: float, name: str) -> None:
    """Refuse readings that repeat at another wavelength, or at none."""
    if stroke < WHOLE / 2:
        return
    shares = [float(np.median(harmonic.explained(w * array.wavelength_m)[0])) for w in TRIED]
    best = int(np.argmax(shares))
    found = float(TRIED[best]) * array.wavelength_m
    if shares[best] < FOLLOWS:
        raise InputError(
            f"The readings of {name} do not follow its reference with any period from "
            f"{1e3 * array.wavelength_m / 2:g} to {2e3 * array.wavelength_m:g} mm; check that columns and "
            "clock belong together, and the unit of the reference."
        )
    sure = (1 - share) > 4 * (1 - shares[best])
    if sure and abs(found / array.wavelength_m - 1) > OFF:
        raise InputError(
            f"The field in {name} repeats every {1e3 * found:.3g} mm, but the layout states a wavelength of "
            f"{1e3 * array.wavelength_m:g} mm; correct lambda_m in meta.json (wavelength_m in a machine "
            "file), or the unit of the reference."
        )
