"""Positions of a calibration, their order, and the purpose of each."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from harris_perception.core.hand_eye.degeneracy import checked
from harris_perception.core.hand_eye.hand_eye_config import HandEyeConfig
from harris_perception.core.hand_eye.tip_samples import Sample
from harris_perception.core.hand_eye_procedure.calibration_tour import (
    FITTED,
    Aims,
    CalibrationStop,
    Purpose,
    readings_of,
    seconds,
    shortest,
)
from icu_common.core.configuration.config import Config, ConfigError, setting
from icu_common.core.geometry.geometry import Array
from icu_common.core.reasons.message import Message


@dataclass(frozen=True, slots=True, kw_only=True)
class RunConfig(Config):
    """Area of the run, time limits, and end conditions."""

    mounting: str = setting("fixed", "Mounting of the cameras", choices=("fixed", "carriage"), read_only=True)
    x_min_m: float = setting(0.03, "Minimum x reading", minimum=0.0, maximum=5.0, unit="m")
    x_max_m: float = setting(0.33, "Maximum x reading", minimum=0.0, maximum=5.0, unit="m")
    y_min_m: float = setting(0.03, "Minimum y reading", minimum=0.0, maximum=5.0, unit="m")
    y_max_m: float = setting(0.18, "Maximum y reading", minimum=0.0, maximum=5.0, unit="m")
    columns: int = setting(4, "Number of candidate positions along x", minimum=2, maximum=20)
    rows: int = setting(3, "Number of candidate positions along y", minimum=2, maximum=20)
    places: int = setting(
        8,
        "Number of positions for the first solution; more are added while the error is too large",
        minimum=2,
        maximum=400,
    )
    enough_m: float = setting(
        0.000033,
        "Predicted error, without the error that all samples share, below which no positions are added; 0: "
        "all positions are visited",
        minimum=0.0,
        maximum=0.01,
        unit="m",
    )
    least_gain: float = setting(
        0.2,
        "Minimum share by which all further positions together must reduce the predicted error; less is not worth "
        "their time, unless it brings the error below `enough_m`",
        minimum=0.0,
        maximum=1.0,
    )
    heights_m: tuple[float, ...] = setting(
        (0.0, -0.016),
        "Heights in base_link at each position, raised where there is less room; with carriage cameras one "
        "height per position, in turn",
        minimum=-0.5,
        maximum=0.0,
        unit="m",
    )
    held_out: int = setting(
        4, "Maximum number of positions between the others that check the calibration", minimum=2, maximum=50
    )
    held_out_height_m: float = setting(
        -0.006, "Height of every second held-out position", minimum=-0.5, maximum=0.0, unit="m"
    )
    backlash_places: int = setting(
        2,
        "Number of positions at the lower end of each axis that are approached from both sides to measure backlash",
        minimum=0,
        maximum=20,
    )
    approach_m: float = setting(
        0.003, "Half the distance between the two positions of a backlash pair", minimum=0.0, maximum=0.05, unit="m"
    )
    accept_timeout_s: float = setting(3.0, "Maximum time until a goal is accepted", minimum=0.1, maximum=60.0, unit="s")
    move_timeout_s: float = setting(30.0, "Maximum time until a goal is reached", minimum=1.0, maximum=600.0, unit="s")
    look_timeout_s: float = setting(
        6.0, "Maximum time until a tip at rest is seen", minimum=0.5, maximum=120.0, unit="s"
    )
    retries: int = setting(
        4, "Maximum number of retries of a step that timed out, each with twice the time", minimum=0, maximum=20
    )
    max_retries: int = setting(20, "Maximum number of retries in one run", minimum=0, maximum=1000)
    longest_wait_s: float = setting(60.0, "Upper limit of the doubled times", minimum=1.0, maximum=600.0, unit="s")
    max_missed: float = setting(0.25, "Maximum fraction of positions without a sample", minimum=0.0, maximum=0.9)
    max_held_out_m: float = setting(
        0.001, "Maximum error at the held-out positions", minimum=1e-6, maximum=0.1, unit="m"
    )

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        for axis, low, high in (("x", self.x_min_m, self.x_max_m), ("y", self.y_min_m, self.y_max_m)):
            if low < self.approach_m:
                raise ConfigError(f"{axis}_min_m = {low}; expected at least approach_m = {self.approach_m}")
            if high <= low:
                raise ConfigError(f"{axis}_max_m = {high} is not above {axis}_min_m = {low}")
        if not self.heights_m:
            raise ConfigError("heights_m = (); expected at least one height")
        if self.columns == self.rows == 2:
            raise ConfigError("columns = 2, rows = 2; expected at least 3 of one, for two held-out places between")


def plan(config: RunConfig, *, see_tip: bool = True) -> list[CalibrationStop]:
    """Return the goals up to the first solution, in order.

    The controller approaches each position from below, so that the backlash is always taken up. If the cameras do not
    see the tip, lowering it measures nothing, and the distance by which it may be lowered is unknown.
    """
    groups = [*_from_both_sides(config), *([stop] for stop in _checks(config, see_tip))]
    known = [readings_of([s for g in groups for s in g if s.purpose in (*FITTED, Purpose.CHECK)])]
    sets, aims = _grid(config, see_tip), _aims(config)
    for _ in range(min(config.places, len(sets))):
        chosen = sets.pop(aims.best(np.vstack(known), sets))
        known.append(readings_of(chosen))
        groups.append(chosen)
    stops = shortest(groups)
    last = stops[-1]
    return [*stops, last._replace(z=0.0, purpose=Purpose.PARK)] if last.z else stops


def next_stops(
    config: RunConfig, known: Array, visited: set[tuple[float, float]], at: CalibrationStop, *, see_tip: bool = True
) -> list[CalibrationStop]:
    """Return the goals of one more position: the most useful one per second; empty if none is left.

    Parameters
    ----------
    config
        Configuration of the run.
    known
        (N, 3) m, readings of the samples used.
    visited
        Readings x and y of the visited positions.
    at
        Present position of the machine.
    see_tip
        Whether the cameras see the tip.
    """
    sets = [stops for stops in _grid(config, see_tip) if (stops[0].x, stops[0].y) not in visited]
    if not sets:
        return []
    return sets[_aims(config).best(known, sets, [seconds(at, stops) for stops in sets])]


def is_worth_more(
    config: RunConfig, error_m: float, known: Array, visited: set[tuple[float, float]], *, see_tip: bool = True
) -> bool:
    """Return whether further positions are worth their time; noisy cameras leave an error that they cannot reduce.

    ``enough_m`` of 0 requests all positions; see :func:`next_stops` for the parameters.
    """
    if error_m <= config.enough_m or config.enough_m == 0.0:
        return error_m > config.enough_m
    gain = _rest_gain(config, known, visited, see_tip)
    return gain >= config.least_gain or error_m * (1.0 - gain) <= config.enough_m


def _rest_gain(config: RunConfig, known: Array, visited: set[tuple[float, float]], see_tip: bool) -> float:
    """Return the share by which all positions that are left would reduce the predicted error."""
    left = [stop for stops in _grid(config, see_tip) if (stops[0].x, stops[0].y) not in visited for stop in stops]
    if not left:
        return 0.0
    aims = _aims(config)
    return 1.0 - math.sqrt(aims.variance(np.vstack([known, readings_of(left)])) / aims.variance(known))


def check_plan(config: RunConfig, solver: HandEyeConfig) -> None:
    """Reject positions from which no calibration can be solved, before the machine moves.

    Raises
    ------
    DegenerateError
        Like the solver at the end of the run.
    """
    readings = readings_of([stop for stops in _grid(config, True) for stop in stops])
    checked(
        [Sample(reading=r, tip=r, covariance=np.zeros((3, 3))) for r in readings], Message("calibration.tip"), solver
    )


def corners(config: RunConfig) -> Array:
    """Return readings (4, 3) at the corners of the calibrated area, on the panel's side."""
    depth = -min(config.heights_m)
    xs, ys = (config.x_min_m, config.x_max_m), (config.y_min_m, config.y_max_m)
    return np.array([(x, y, depth) for x in xs for y in ys])


def _aims(config: RunConfig) -> Aims:
    return Aims((config.x_min_m, config.y_min_m), (config.x_max_m, config.y_max_m))


def _axes(config: RunConfig) -> tuple[Array, Array]:
    xs = np.linspace(config.x_min_m, config.x_max_m, config.columns)
    return xs, np.linspace(config.y_min_m, config.y_max_m, config.rows)


def _grid(config: RunConfig, see_tip: bool) -> list[list[CalibrationStop]]:
    """Return the candidate positions, each with the stops at its heights."""
    xs, ys = _axes(config)
    sets = []
    for row, y in enumerate(ys):
        for column, x in enumerate(xs):
            heights = config.heights_m
            if config.mounting == "carriage":
                # The panel looks the same from each height, and only the tip moves with the height.
                heights = heights[(row + column) % len(heights) :][:1] if see_tip else (0.0,)
            sets.append([CalibrationStop(float(x), float(y), z, Purpose.FIT) for z in heights])
    return sets


def _checks(config: RunConfig, see_tip: bool) -> list[CalibrationStop]:
    """Return the held-out positions, each in the middle between others."""
    xs, ys = _axes(config)
    between = [(float(x), float(y)) for y in (ys[1:] + ys[:-1]) / 2 for x in (xs[1:] + xs[:-1]) / 2]
    # Positions at steps of the golden ratio are evenly spread for any number of them.
    spread = [int(i * 0.618034 * len(between)) % len(between) for i in range(config.held_out)]
    chosen = list(dict.fromkeys([*spread, *range(len(between))]))[: config.held_out]
    low = config.held_out_height_m if see_tip else 0.0
    return [
        CalibrationStop(between[i][0], between[i][1], low if n % 2 else 0.0, Purpose.CHECK)
        for n, i in enumerate(chosen)
    ]


def _from_both_sides(config: RunConfig) -> list[list[CalibrationStop]]:
    """Return the pairs of stops for the backlash: close together, approached from below and from above.

    The controller approaches every position from below, except at the lower end of an axis, where there is no room for
    it: reading 0 is approached from above. There the carriage lags in the other direction.
    """
    pairs, beside = [], 2 * config.approach_m
    for share in (np.arange(config.backlash_places) + 1.0) / (config.backlash_places + 1):
        y = float(config.y_min_m + share * (config.y_max_m - config.y_min_m))
        pairs.append([CalibrationStop(beside, y, 0.0, Purpose.X_BELOW), CalibrationStop(0.0, y, 0.0, Purpose.X_ABOVE)])
        x = float(config.x_min_m + share * (config.x_max_m - config.x_min_m))
        pairs.append([CalibrationStop(x, beside, 0.0, Purpose.Y_BELOW), CalibrationStop(x, 0.0, 0.0, Purpose.Y_ABOVE)])
    return pairs
