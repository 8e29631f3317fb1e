"""Differences between two values, and their limits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from icu_bringup.core.check.values import PIXELS, Kind, Value, columns, coordinates
from icu_common.core.geometry.geometry import Array

NEAREST_PERCENT = 90.0
"""Percentile of the distances from each point to the nearest one of the other cloud."""
SAMPLED = 500
"""Maximum number of points, evenly chosen, whose nearest neighbours are searched."""
LIMITS = {
    Kind.NUMBER: ("absolute", "relative"),
    Kind.ROTATION: ("angle_deg",),
    Kind.TEXT: (),
    Kind.IMAGE: ("mean",),
    Kind.CLOUD: ("distance", "count"),
}
"""Names of the limits of each kind.

``absolute`` is in the field's unit, ``relative`` a part of the expected value. ``mean`` is the mean absolute difference
of pixels. ``distance`` between nearest points is in the unit of their coordinates, ``count`` a part of the expected
number of points. A text must be the same.
"""
FLOORS: dict[str, float] = {
    "absolute": 1e-6,
    "relative": 1e-3,
    "angle_deg": 0.05,
    "mean": 0.5,
    "distance": 1e-3,
    "count": 0.02,
}
"""Minimum limits of a new expectation: other processors and library versions round differently."""
LENGTH_FLOOR_M, PIXEL_FLOOR = 1e-4, 0.05
"""Minimum limits of positions (metres, REP 103), and of points in an image."""
UNIT_FLOORS = {
    "_m": LENGTH_FLOOR_M,
    "_mm": 1e3 * LENGTH_FLOOR_M,
    "_deg": FLOORS["angle_deg"],
    "_px": PIXEL_FLOOR,
    "_s": 1e-3,
    "_ns": 1e6,
}
"""Minimum limits of numbers, by the unit at the end of a field's name."""
_OF_REPEATS = 3.0
"""Part of the limit for the largest difference between repeated runs."""
_LENGTHS = (".position.", ".translation.", ".point.")


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerance:
    """Limits of one field.

    Attributes
    ----------
    limits
        By the names in :data:`LIMITS`; a limit that is not named is 0.
    ignored
        True for a field that is not compared.
    why
        Reason for the limits, as a text.
    """

    limits: Mapping[str, float] = field(default_factory=dict)
    ignored: bool = False
    why: str = ""


@dataclass(frozen=True, slots=True)
class Difference:
    """Difference between two values: an amount for each limit's name; infinite if they cannot be compared."""

    amounts: dict[str, float]

    def exceeds(self, tolerance: Tolerance) -> bool:
        """Return whether an amount is above its limit."""
        if not tolerance.ignored and "absolute" in self.amounts:
            # As numpy.isclose: both limits together.
            return not self.amounts["absolute"] <= tolerance.limits.get("absolute", 0.0)
        return not tolerance.ignored and any(
            not amount <= tolerance.limits.get(name, 0.0) for name, amount in self.amounts.items()
        )

    @property
    def size(self) -> float:
        """Largest amount, for finding the worst of several differences."""
        return max(self.amounts.values(), default=0.0)


def difference(old: Value, new: Value, tolerance: Tolerance) -> Difference:
    """Return the difference from the expected value; for numbers, the part that ``relative`` does not cover."""
    if old.kind is not new.kind:
        return Difference({"kind": math.inf})
    match old.kind:
        case Kind.NUMBER:
            return Difference({"absolute": _apart(old.data, new.data, tolerance.limits.get("relative", 0.0))})
        case Kind.ROTATION:
            return Difference({"angle_deg": _angle_deg(old.data, new.data)})
        case Kind.IMAGE:
            return Difference({"mean": _mean(old.data, new.data)})
        case Kind.CLOUD:
            return Difference(_between_clouds(old, new))
    return Difference({"text": 0.0 if old.text == new.text else math.inf})


def _apart(old: Array, new: Array, relative: float) -> float:
    if old.shape != new.shape:
        return math.inf
    same = (old == new) | (np.isnan(old) & np.isnan(new))
    with np.errstate(invalid="ignore"):
        rest = np.where(same, 0.0, np.abs(old - new) - relative * np.abs(old))
    rest = np.where(np.isnan(rest), math.inf, rest)
    return max(0.0, float(rest.max(initial=0.0)))


def _angle_deg(old: Array, new: Array) -> float:
    lengths = float(np.linalg.norm(old) * np.linalg.norm(new))
    if not lengths > 0.0:
        return 0.0 if np.array_equal(old, new) else math.inf
    a, b = old / np.linalg.norm(old), new / np.linalg.norm(new)
    # By the chord, because the arc cosine loses its digits at small angles; q and -q are the same rotation.
    return math.degrees(
        4.0 * math.asin(min(1.0, float(np.linalg.norm(a - math.copysign(1.0, float(a @ b)) * b)) / 2.0))
    )


def _mean(old: Array, new: Array) -> float:
    if old.shape != new.shape:
        return math.inf
    if not old.size:
        return 0.0
    a, b = old.astype(np.float64), new.astype(np.float64)
    only_one = np.isnan(a) ^ np.isnan(b)
    if only_one.mean() > 0.01:  # a disparity that is missing in more than one of a hundred pixels
        return math.inf
    with np.errstate(invalid="ignore"):
        return float(np.nan_to_num(np.where(a == b, 0.0, np.abs(a - b)), nan=0.0, posinf=0.0).mean())


def _between_clouds(old: Value, new: Value) -> dict[str, float]:
    if old.text != new.text:
        return {"distance": math.inf, "count": math.inf}
    a, b = (_finite(columns(value, coordinates(value))) for value in (old, new))
    count = abs(len(a) - len(b)) / max(len(a), 1)
    if not len(a) or not len(b):
        return {"distance": 0.0 if len(a) == len(b) else math.inf, "count": count}
    distance = 0.0 if np.array_equal(a, b) else max(_nearest(a, b), _nearest(b, a))
    return {"distance": distance, "count": count}


def _nearest(points: Array, among: Array) -> float:
    chosen = points[:: -(-len(points) // SAMPLED)]
    squares = (among**2).sum(axis=1)
    found = [float(np.sqrt(max(0.0, (squares - 2.0 * among @ p).min() + float(p @ p)))) for p in chosen]
    return float(np.percentile(found, NEAREST_PERCENT))


def _finite(points: Array) -> Array:
    return np.asarray(points[np.isfinite(points).all(axis=1)])


def tolerance_for(path: str, value: Value, repeats: Mapping[str, float], runs: int) -> Tolerance:
    """Return the tolerance of a new expectation.

    Parameters
    ----------
    path, value
        The field and one of its values.
    repeats
        Largest differences between repeated runs, by the names of :attr:`Difference.amounts`.
    runs
        Number of these runs.
    """
    worst = max(repeats.values(), default=0.0)
    if math.isinf(worst) or (worst > 0.0 and value.kind is Kind.TEXT):
        return Tolerance(ignored=True, why=f"differs between {runs} runs of the same bag")
    if not worst and (value.kind is Kind.TEXT or (value.whole and not path.endswith("_ns"))):
        return Tolerance(why=f"the same in {runs} runs")
    floors = _floors(path, value)
    limits = {name: max(floor, _round_up(_OF_REPEATS * repeats.get(name, 0.0))) for name, floor in floors.items()}
    if worst > 0.0:
        why = f"{_OF_REPEATS:g} times the largest difference of {runs} runs ({worst:.3g}), at least the rounding"
    else:
        why = f"{runs} runs are equal; rounding of other processors"
    return Tolerance(limits=limits, why=why)


def _floors(path: str, value: Value) -> dict[str, float]:
    """Return the minimum limits of a field; field names contain their unit, such as ``error_m``."""
    floors = {name: FLOORS[name] for name in LIMITS[value.kind]}
    if value.kind is Kind.CLOUD and coordinates(value) == PIXELS:
        return {**floors, "distance": PIXEL_FLOOR}
    if value.kind is Kind.NUMBER:
        if any(part in f".{path}" for part in _LENGTHS):
            return {"absolute": LENGTH_FLOOR_M}
        if (floor := UNIT_FLOORS.get(path[path.rfind("_") :])) is not None:
            return {"absolute": floor}
    return floors


def _round_up(value: float) -> float:
    """Return a value rounded up to two digits."""
    if not value:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / unit) * unit:.2g}")


def limits_text(tolerance: Tolerance) -> str:
    """Return the limits as a short text, for a table."""
    if tolerance.ignored:
        return "not compared"
    return ", ".join(f"{name} {limit:g}" for name, limit in tolerance.limits.items()) or "the same"


def tolerance_of(document: Mapping[str, Any]) -> Tolerance:
    """Return a tolerance from its form in YAML: limits by name, ``ignore`` and ``why``.

    Raises
    ------
    ValueError
        For an unknown name, or a limit below 0.
    """
    limits = {name: value for name, value in document.items() if name not in ("ignore", "why")}
    known = {name for names in LIMITS.values() for name in names}
    for name, value in limits.items():
        if name not in known:
            raise ValueError(f"unknown limit {name!r}; known: {', '.join(sorted(known))}, ignore, why")
        if isinstance(value, bool) or not isinstance(value, int | float) or not value >= 0.0:
            raise ValueError(f"{name}: {value!r} is no number of at least 0")
    return Tolerance(
        limits={name: float(value) for name, value in limits.items()},
        ignored=bool(document.get("ignore", False)),
        why=str(document.get("why", "")),
    )
