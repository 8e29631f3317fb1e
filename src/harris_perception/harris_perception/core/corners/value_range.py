"""Values of an image that the detectors accept, and the unit in which float32 holds its responses."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

F32 = npt.NDArray[Any]

_FAINT, _BRIGHT = 2.0**-16, 2.0**20
"""Range of image values whose responses, of the fourth power, fit into float32 with any window."""

_SPAN = 2.0**-24
"""Size of a value, relative to one of 16 bits, whose response does not fit into float32 together with the latter's."""


def checked(gray: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the image (H, W) if the detectors accept it, else raise ``ValueError``.

    A read-only image is copied: numba would compile the kernels again for read-only arrays.
    """
    if gray.ndim != 2:
        raise ValueError(f"expected a grey picture (H, W), got shape {gray.shape}")
    if gray.dtype.newbyteorder("=") not in (np.uint8, np.uint16, np.float32):
        raise ValueError(f"expected uint8, uint16 or float32, got {gray.dtype}")
    return gray if gray.flags.writeable else gray.copy()


def in_range(gray: npt.NDArray[Any], least: float = _FAINT) -> tuple[npt.NDArray[Any], float]:
    """Return a checked image (H, W) in a unit in which float32 holds its responses, and that unit.

    The unit is a power of two, so nothing is rounded. It is 1 except for floats whose largest value is below ``least``
    or huge. It is also 1 if only a few values are huge relative to the others, such as placeholders for unknown values.
    """
    if gray.dtype.kind != "f" or gray.size == 0:
        return gray, 1.0
    top = max(-float(np.fmin.reduce(gray, axis=None)), float(np.fmax.reduce(gray, axis=None)))
    if not math.isfinite(top):
        top = float(np.where(np.isfinite(gray), np.abs(gray), np.float32(0.0)).max())
    if top == 0.0 or least <= top <= _BRIGHT:
        return gray, 1.0
    exponent = math.frexp(top)[1] - 16
    if top > _BRIGHT:
        sizes = np.abs(gray[np.isfinite(gray) & (gray != 0.0)])
        if math.ldexp(float(np.median(sizes)), -exponent) < _SPAN:
            return gray, 1.0
    return np.ldexp(gray, -exponent), math.ldexp(1.0, exponent)


def in_unit(response: F32, unit: float) -> F32:
    """Return positive responses times a unit, float32 if it holds all of them, else float64."""
    if unit == 1.0:
        return response
    values = response.astype(np.float64) * unit
    held = np.finfo(np.float32)
    return values if ((values < held.tiny) | (values > held.max)).any() else values.astype(np.float32)


def from_lowest(gray: npt.NDArray[Any]) -> F32:
    """Return an image (H, W) minus its lowest finite value, float32.

    Gradients do not change, but rounding in earlier steps grows with the values: on a constant image rounding errors
    would be detected as corners.
    """
    values = gray.astype(np.float32)
    lowest = np.min(values, where=np.isfinite(values), initial=np.float32(np.inf))
    return np.asarray(values - lowest, np.float32) if np.isfinite(lowest) else values
