"""Requests to a driver while a byte is damaged: each phase is repeated until the damage has happened."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from campaign.damage_rig import DamageRig, Point

from gantry_driver.core.motion import motion_plan
from gantry_driver.core.motion.motion_plan import MotionConfig, Path

MOTION = MotionConfig()
HOVER_MM, OVERTRAVEL_MM, BETWEEN_MM = 8.0, 1.0, 4.0
"""As the controller has them: above the panel before a touch, into it with one, and the lift of a double press."""
HOLD_S = 0.3
TIMES = 12
"""Maximum number of repetitions of a phase for a damage that comes late."""


@dataclass(frozen=True, slots=True)
class Scene:
    """One control on a flat panel: its middle, and the extension at which the stylus meets the panel; mm."""

    x: float
    y: float
    panel: float

    @property
    def hover(self) -> float:
        return self.panel - HOVER_MM

    @property
    def pressed(self) -> float:
        return self.panel + OVERTRAVEL_MM


Do = Callable[[DamageRig, Scene, random.Random], bool]
"""Carries a phase out; whether everything went as asked for."""


def scene_of(rng: random.Random) -> Scene:
    """Draw a control with room for a drag around it."""
    return Scene(rng.uniform(50.0, 300.0), rng.uniform(50.0, 170.0), rng.uniform(15.0, 45.0))


def follow_path(rig: DamageRig, path: Path) -> bool:
    points = [(1000.0 * x, 1000.0 * y, 1000.0 * e) for x, y, e in path.points.tolist()]
    return not points or rig.goal(points, path.times_s.tolist())


def start_of(rig: DamageRig) -> np.ndarray:
    """Return where the driver says that the stylus is, as the controller plans from it."""
    return np.array(rig.machine.reading_m or (0.0, 0.0, 0.0))


def approach(rig: DamageRig, scene: Scene) -> bool:
    aim = np.array([scene.x, scene.y]) / 1000.0
    return follow_path(rig, motion_plan.travel(start_of(rig), aim, scene.hover / 1000.0, MOTION))


def contact(rig: DamageRig, scene: Scene, *, twice: bool) -> bool:
    deep = scene.pressed / 1000.0
    if twice:
        path = motion_plan.plunge_twice(start_of(rig), deep, BETWEEN_MM / 1000.0, MOTION)
    else:
        path = motion_plan.plunge(start_of(rig), deep, MOTION)
    if not follow_path(rig, path):
        return False
    rig.run_for(HOLD_S)
    return rig.machine.phase.state == "idle"


def withdrawal(rig: DamageRig) -> bool:
    return follow_path(rig, motion_plan.lift(start_of(rig), MOTION))


def touch(rig: DamageRig, scene: Scene) -> bool:
    """Touch without damage: also the proof that nothing of an earlier damage has stayed."""
    return approach(rig, scene) and contact(rig, scene, twice=False) and withdrawal(rig)


def _approach(rig: DamageRig, scene: Scene, rng: random.Random) -> bool:
    with rig.damaging():
        fine = approach(rig, scene)
    return fine and contact(rig, scene, twice=False) and withdrawal(rig)


def _contact(rig: DamageRig, scene: Scene, rng: random.Random) -> bool:
    twice = rng.random() < 0.3
    if not approach(rig, scene):
        return False
    with rig.damaging():
        fine = contact(rig, scene, twice=twice)
    return fine and withdrawal(rig)


def _withdrawal(rig: DamageRig, scene: Scene, rng: random.Random) -> bool:
    if not (approach(rig, scene) and contact(rig, scene, twice=False)):
        return False
    with rig.damaging():
        return withdrawal(rig)


def _along(rig: DamageRig, scene: Scene, way: Sequence[Point], speed_m_s: float) -> bool:
    if not (approach(rig, scene) and contact(rig, scene, twice=False)):
        return False
    points = np.array(way) / 1000.0
    with rig.damaging():
        fine = follow_path(rig, motion_plan.follow(start_of(rig), points, speed_m_s, MOTION))
    return fine and withdrawal(rig)


def _turn(rig: DamageRig, scene: Scene, rng: random.Random) -> bool:
    """Follow an arc of 20 to 120 degrees whose chords span 2 degrees, around a middle next to the control."""
    radius, angle = rng.uniform(4.0, 10.0), math.radians(rng.uniform(20.0, 120.0)) * rng.choice([-1, 1])
    begin, count = rng.uniform(0.0, math.tau), math.ceil(abs(math.degrees(angle)) / 2.0)
    middle = scene.x - radius * math.cos(begin), scene.y - radius * math.sin(begin)
    angles = [begin + angle * n / count for n in range(1, count + 1)]
    way = [(middle[0] + radius * math.cos(a), middle[1] + radius * math.sin(a), scene.pressed) for a in angles]
    return _along(rig, scene, way, MOTION.turn_speed_m_s)


def _drag(rig: DamageRig, scene: Scene, rng: random.Random) -> bool:
    length, angle = rng.uniform(10.0, 45.0), rng.uniform(0.0, math.tau)
    count = math.ceil(length / 10.0)
    steps = [length * n / count for n in range(1, count + 1)]
    way = [(scene.x + s * math.cos(angle), scene.y + s * math.sin(angle), scene.pressed) for s in steps]
    return _along(rig, scene, way, MOTION.drag_speed_m_s)


def _homing(rig: DamageRig, scene: Scene, rng: random.Random) -> bool:
    with rig.damaging():
        return rig.homing()


def _jog(rig: DamageRig, scene: Scene, rng: random.Random) -> bool:
    """Move in the air by a little, as a person does who sets the machine up."""
    x, y, e = rig.here
    axis, by = rng.randrange(3), rng.choice([0.1, 1.0, 10.0]) * rng.choice([-1, 1])
    place = [x, y, e]
    place[axis] = min(max(place[axis] + by, 0.0), (359.0, 219.0, scene.hover)[axis])
    with rig.damaging():
        return rig.goal([(place[0], place[1], place[2])])


def _settings(rig: DamageRig, scene: Scene, rng: random.Random) -> bool:
    """Write what someone has changed on the board; the driver reads it back."""
    rig.expected_states |= {"connecting", "mismatch"}
    values = rig.board.eeprom.values
    number = rng.choice([100, 101, 102, 110, 111, 112, 120, 121, 122, 130, 27])
    values[number] = round(values[number] * rng.choice([0.5, 0.9, 1.25]), 3)
    rig.fault("brown_out")
    rig.until(lambda: rig.machine.phase.state == "mismatch", 30.0)
    rig.expected_states -= {"mismatch"}
    with rig.damaging():
        refusal = rig.machine.write_settings(rig.now)
        assert not refusal, refusal
        rig.run_for(0.1)
        fine = rig.connected()
    return fine and rig.homing()


def _rest(rig: DamageRig, scene: Scene, rng: random.Random) -> bool:
    with rig.damaging():
        rig.run_for(2.0)
    return rig.machine.phase.state == "idle"


def _start_up(rig: DamageRig, scene: Scene, rng: random.Random) -> bool:
    """Reset the board at rest, by power or by its own firmware; the driver has to find out."""
    with rig.damaging():
        rig.expected_states |= {"connecting"}
        rig.fault(rng.choice(["brown_out", "soft_reset"]))
        rig.run_for(1.0)
        if not rig.connected():
            return False
    return rig.homing()


def _other_path(scene: Scene, rng: random.Random) -> list[Point]:
    """Return what another program may send: upright touches, a slanted one, dabs without a rise, or a line drawn."""
    x, y, deep = scene.x, scene.y, scene.pressed
    far = x + rng.uniform(-40.0, 40.0), y + rng.uniform(-40.0, 40.0)
    kind = rng.choice(["touches", "touches", "slanted", "dabs", "line"])
    if kind == "touches":
        return [(x, y, 0.0), (x, y, deep), (x, y, 0.0), (*far, 0.0), (*far, deep), (*far, 0.0)]
    if kind == "slanted":
        return [(x - 2.0, y, scene.hover), (x, y, deep), (x + 2.0, y, scene.hover), (*far, 0.0)]
    if kind == "dabs":
        between = deep - rng.uniform(1.5, 5.0)
        return [(x, y, 0.0), *[(x, y, deep), (x, y, between)] * 3, (x, y, deep), (x, y, 0.0)]
    return [(x, y, scene.hover), (x, y, deep), (*far, deep), (x, y, deep), (x, y, 0.0)]


def _path(rig: DamageRig, scene: Scene, rng: random.Random) -> bool:
    """Follow what another program sends, with its own speeds or the driver's."""
    way, times = _other_path(scene, rng), list[float]()
    if rng.random() < 0.5:
        speed, last, clock = rng.uniform(20.0, 50.0), rig.here, 0.0
        for point in way:
            clock += max(math.dist(last, point) / (speed if point[2] != last[2] else 150.0), 1e-3)
            times.append(clock)
            last = point
    with rig.damaging():
        return rig.goal(way, times)


PHASES: dict[str, Do] = {
    "approach": _approach,
    "contact": _contact,
    "withdrawal": _withdrawal,
    "turn": _turn,
    "drag": _drag,
    "homing": _homing,
    "jog": _jog,
    "settings": _settings,
    "rest": _rest,
    "start-up": _start_up,
    "path": _path,
}


def carry_out(rig: DamageRig, phase: str, scene: Scene, rng: random.Random) -> None:
    """Bring the machine to where the phase begins, repeat the phase until the damage is done, and touch once more."""
    rig.story.panel_mm = scene.panel
    first = phase == "start-up" and rng.random() < 0.5
    if first:
        with rig.damaging():
            fine = rig.connected()
    else:
        fine = rig.connected()
    rig.expected_states.clear()
    if phase != "homing" or rng.random() < 0.5:
        fine = fine and rig.homing()
    if phase == "rest" and rng.random() < 0.5:
        fine = fine and approach(rig, scene)
    for _ in range(TIMES):
        if not fine or (rig.hit and rig.damage is not None):
            break
        fine = PHASES[phase](rig, scene, rng)
        if rig.damage is None:
            break
    rig.settle()
    if rig.machine.phase.state == "idle" and not touch(rig, scene):
        rig.settle()
