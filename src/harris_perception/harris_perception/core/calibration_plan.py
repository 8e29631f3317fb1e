"""Where a calibration goes, in which order, and what each place is for."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from harris_perception.core.hand_eye import HandEyeConfig, Sample, checked
from icu_common.core.config import Config, ConfigError, setting


@dataclass(frozen=True, slots=True, kw_only=True)
class RunConfig(Config):
    """Where the run goes and how long it waits."""

    mounting: str = setting("fixed", "Where the cameras are mounted", choices=("fixed", "carriage"), read_only=True)
    x_min_m: float = setting(0.03, "Least x reading", minimum=0.0, maximum=5.0, unit="m")
    x_max_m: float = setting(0.33, "Greatest x reading", minimum=0.0, maximum=5.0, unit="m")
    y_min_m: float = setting(0.03, "Least y reading", minimum=0.0, maximum=5.0, unit="m")
    y_max_m: float = setting(0.18, "Greatest y reading", minimum=0.0, maximum=5.0, unit="m")
    columns: int = setting(4, "Places along x", minimum=2, maximum=20)
    rows: int = setting(3, "Places along y", minimum=2, maximum=20)
    heights_m: tuple[float, ...] = setting(
        (0.0, -0.012),
        "Heights in base_link at each place; with cameras on the carriage one of them at each, in turn",
        minimum=-0.5,
        maximum=0.0,
        unit="m",
    )
    held_out: int = setting(4, "Places between the others, if there are so many, that check it", minimum=2, maximum=50)
    held_out_height_m: float = setting(-0.006, "Their height", minimum=-0.5, maximum=0.0, unit="m")
    backlash_places: int = setting(
        2, "Places at the lower end of each axis, entered from above, that tell the backlash", minimum=0, maximum=20
    )
    approach_m: float = setting(
        0.003, "Each row is entered from so far left and below, which takes up the backlash", minimum=0.0, maximum=0.05
    )
    accept_timeout_s: float = setting(3.0, "A goal is answered within", minimum=0.1, maximum=60.0, unit="s")
    move_timeout_s: float = setting(30.0, "A goal is reached within", minimum=1.0, maximum=600.0, unit="s")
    look_timeout_s: float = setting(6.0, "A still tip is seen within", minimum=0.5, maximum=120.0, unit="s")
    max_missed: float = setting(0.25, "Part of the places where the tip may stay unseen", minimum=0.0, maximum=0.9)
    max_held_out_m: float = setting(0.001, "Greatest error at the held-out places", minimum=1e-6, maximum=0.1, unit="m")

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        for axis, low, high in (("x", self.x_min_m, self.x_max_m), ("y", self.y_min_m, self.y_max_m)):
            if low < self.approach_m:
                raise ConfigError(f"{axis}_min_m = {low}: at least approach_m = {self.approach_m} is needed")
            if high <= low:
                raise ConfigError(f"{axis}_max_m = {high} is not above {axis}_min_m = {low}")
        if not self.heights_m:
            raise ConfigError("heights_m = (): at least one height is needed")
        if self.columns == self.rows == 2:
            raise ConfigError("columns = 2, rows = 2: at least 3 of one are needed, for two held-out places between")


class Purpose(str, Enum):
    """Why the run goes to a place."""

    APPROACH = "approach"
    ABOVE = "above"
    FIT = "fit"
    CHECK = "check"
    X_BELOW = "x from below"
    X_ABOVE = "x from above"
    Y_BELOW = "y from below"
    Y_ABOVE = "y from above"
    PARK = "park"


BACKLASH = ((Purpose.X_BELOW, Purpose.X_ABOVE), (Purpose.Y_BELOW, Purpose.Y_ABOVE))
SAMPLED = (Purpose.FIT, Purpose.CHECK, *BACKLASH[0], *BACKLASH[1])


@dataclass(frozen=True, slots=True)
class Stop:
    """One goal of the run: readings x and y, and the height z in base_link; metres."""

    x: float
    y: float
    z: float
    purpose: Purpose


def plan(config: RunConfig, *, see_tip: bool = True) -> list[Stop]:
    """Return the goals in order: each place is entered towards +x and +y, so that the backlash is always taken up.

    Where the cameras do not see the tip, a way down tells nothing, and nothing would tell how far it may go.
    """
    xs = np.linspace(config.x_min_m, config.x_max_m, config.columns)
    ys = np.linspace(config.y_min_m, config.y_max_m, config.rows)
    back = config.approach_m
    stops: list[Stop] = []
    for row, y in enumerate(ys):
        stops.append(Stop(float(xs[0]) - back, float(y) - back, 0.0, Purpose.APPROACH))
        for column, x in enumerate(xs):
            heights = config.heights_m
            if config.mounting == "carriage":
                # The panel looks the same from each height, and the tip moves with nothing else.
                heights = heights[(row + column) % len(heights) :][:1] if see_tip else (0.0,)
            stops += [Stop(float(x), float(y), z, Purpose.FIT) for z in heights]
    between = [(float(x), float(y)) for y in (ys[1:] + ys[:-1]) / 2 for x in (xs[1:] + xs[:-1]) / 2]
    # Places at the golden ratio's steps are spread evenly however many are wanted.
    spread = [int(i * 0.618034 * len(between)) % len(between) for i in range(config.held_out)]
    chosen = list(dict.fromkeys([*spread, *range(len(between))]))[: config.held_out]
    for x, y in (between[i] for i in sorted(chosen)):
        stops.append(Stop(x - back, y - back, 0.0, Purpose.APPROACH))
        stops.append(Stop(x, y, config.held_out_height_m if see_tip else 0.0, Purpose.CHECK))
    stops += _from_both_sides(config)
    last = stops[-1]
    return [*stops, Stop(last.x, last.y, 0.0, Purpose.PARK)]


def check_plan(config: RunConfig, solver: HandEyeConfig) -> None:
    """Refuse a plan from which nothing could be solved, before anything moves.

    Raises
    ------
    DegenerateError
        As the solver would at the end of the run.
    """
    readings = [np.array([s.x, s.y, -s.z]) for s in plan(config) if s.purpose is Purpose.FIT]
    checked([Sample(reading=r, tip=r, covariance=np.zeros((3, 3))) for r in readings], "the tip", solver)


def _from_both_sides(config: RunConfig) -> list[Stop]:
    """Return the places that tell the backlash, in pairs: close together, entered from below and from above.

    The controller enters every place from below, except at the lower end of an axis, where there is no room for it:
    reading 0 is entered from above. There the carriage lags the other way.
    """
    stops = []
    back = config.approach_m
    for share in (np.arange(config.backlash_places) + 1.0) / (config.backlash_places + 1):
        y = float(config.y_min_m + share * (config.y_max_m - config.y_min_m))
        stops.append(Stop(back, y - back, 0.0, Purpose.APPROACH))
        stops += [Stop(2 * back, y, 0.0, Purpose.X_BELOW), Stop(0.0, y, 0.0, Purpose.X_ABOVE)]
        x = float(config.x_min_m + share * (config.x_max_m - config.x_min_m))
        stops.append(Stop(x - back, back, 0.0, Purpose.APPROACH))
        stops += [Stop(x, 2 * back, 0.0, Purpose.Y_BELOW), Stop(x, 0.0, 0.0, Purpose.Y_ABOVE)]
    return stops
