"""A desk with a known scene, clocks that the test sets, and shorthand for messages."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
from support.pinhole import pinhole

from icu_common.core.geometry.geometry import Transform
from icu_common.core.goals.results import GoalResult, Outcome
from scope_ui_bridge.core.config import BridgeConfig
from scope_ui_bridge.core.desk import Desk
from scope_ui_bridge.core.effects import Broadcast, Effect, Now, SendToViewer
from scope_ui_bridge.core.video import Face, VideoScene

START_NS = 1_700_000_000_000_000_000
BOOT = "boot-1"
FACES = tuple(
    Face(name=name, kind=kind, label=label, circle=kind != "button", centre=centre, size=size)
    for name, kind, label, centre, size in (
        ("RUN_STOP", "button", "Run / Stop", (0.2, 0.12, 0.003), (0.016, 0.009)),
        ("CH1_SCALE", "knob", "Scale", (0.21, 0.09, 0.015), (0.018, 0.018)),
        ("CH1_IN", "connector", "Input", (0.21, 0.013, 0.012), (0.014, 0.014)),
    )
)


def pose(shift_m: float = 0.0) -> Transform:
    """Return camera_from_panel of a panel 0.65 m away that faces the camera, its centre on the optical axis."""
    rotation = np.diag([1.0, -1.0, -1.0])
    return Transform(rotation, np.array([shift_m, 0.0, 0.65]) - rotation @ np.array([0.16, 0.075, 0.0]))


def scene() -> VideoScene:
    made = VideoScene(left=pinhole(k1=-0.08), right=pinhole("right", baseline_m=0.12, k1=-0.08), faces=FACES)
    made.outline = np.array([[0, 0], [0.32, 0], [0.32, 0.15], [0, 0.15], [0, 0]])
    made.place_panel(pose())
    return made


class Rig:
    """A desk, ready to move, with one page (``a``) unless given otherwise."""

    def __init__(self, config: BridgeConfig | None = None, *, operator: bool = True) -> None:
        self.desk = Desk(config or BridgeConfig(), BOOT, "DSO", scene=scene())
        self.seconds = 100.0
        self.set_s = 0.0
        """By how much the computer's clock has been set, the monotonic one not."""
        self.seq = 0
        self.desk.machine.set_state("driver", "idle")
        self.desk.machine.set_state("controller", "ready")
        self.desk.machine.set_state("calibration", "calibrated: rms 0.1 mm")
        self.see()
        self.a, self.hello = self.desk.join("Operator 1")
        if operator:
            self.ask(self.a, type="lease", step="take")

    @property
    def now(self) -> Now:
        clock_s = self.seconds + self.set_s
        return Now(mono_s=self.seconds, ros_ns=START_NS + round(clock_s * 1e9), wall_s=1.7e9 + clock_s)

    def see(self, confidence: float = 0.97) -> None:
        """Let the recognition speak and a picture be shown; ``stamp`` names it."""
        self.desk.machine.set_confidence(confidence, self.now)
        self.stamp = self.now.ros_ns
        self.desk.machine.frame_offered("left", self.stamp)

    def wait(self, seconds: float, *, alive: bool = False, see: bool = True) -> list[Effect]:
        """Let time pass in ticks of 50 ms; return the effects."""
        effects: list[Effect] = []
        for _ in range(round(seconds / 0.05)):
            self.seconds += 0.05
            if see:
                self.see()
            if alive:
                self.alive()
            effects += self.desk.tick(self.now)
        return effects

    def alive(self, viewer: str = "") -> None:
        self.ask(viewer or self.a, type="alive", client_ms=1.0)

    def ask(self, viewer: str, **fields: Any) -> list[Effect]:
        self.seq += 1
        head = {"seq": self.seq, "boot": BOOT, "epoch": self.desk.lease.epoch}
        return self.desk.message(viewer, json.dumps({**head, **fields}), self.now)

    def select(self, **what: Any) -> list[Effect]:
        return self.ask(self.a, type="select", **{"camera": "left", "stamp": str(self.stamp), **what})

    def act(self, gesture: str = "press", argument: float = math.nan, **more: Any) -> list[Effect]:
        number = self.desk.chosen.count
        fields = {"gesture": gesture, "selection": number, "camera": "left", "stamp": str(self.stamp), **more}
        if not math.isnan(argument):
            fields["argument"] = argument
        return self.ask(self.a, type="act", **fields)

    def move(self, x_mm: float, y_mm: float) -> list[Effect]:
        return self.ask(self.a, type="move", x_mm=x_mm, y_mm=y_mm, camera="left", stamp=str(self.stamp))

    def jog(self, dx: int, dy: int, step_mm: float = 5.0) -> list[Effect]:
        picture = {"camera": "left", "stamp": str(self.stamp)}
        return self.ask(self.a, type="jog", dx=dx, dy=dy, step_mm=step_mm, **picture)

    def end(self, stamp_ns: int, outcome: Outcome = Outcome.REACHED) -> list[Effect]:
        """Let the controller end a goal."""
        return self.desk.answers.result(GoalResult(goal_id=str(stamp_ns), goal="", outcome=outcome), self.now)


def moving(pictures: bool = False) -> Rig:
    """Return a desk whose machine moves, with images of the cameras or without."""
    rig = Rig()
    if pictures:
        rig.desk.machine.picture_came(rig.now)
    rig.desk.machine.set_state("driver", "moving")
    rig.wait(0.1, alive=True)
    return rig


def of_type(effects: list[Effect], kind: Any) -> list[Any]:
    return [effect for effect in effects if isinstance(effect, kind)]


def answer(effects: list[Effect]) -> dict[str, Any]:
    """Return the one answer among the effects."""
    (found,) = [e.message for e in of_type(effects, SendToViewer) if e.message["type"] == "answer"]
    return dict(found)


def shown_selections(effects: list[Effect]) -> list[Any]:
    """Return the messages to the pages about the selection."""
    return [e.message["selection"] for e in of_type(effects, Broadcast) if e.message["type"] == "selection"]


def selected(effects: list[Effect]) -> dict[str, Any]:
    """Return the only selection in the messages to the pages."""
    (found,) = shown_selections(effects)
    return dict(found)


def refusal(effects: list[Effect]) -> str:
    """Return the refusal's code, after checking that nothing else came of it, but that nothing is selected now."""
    assert len(effects) - len(shown_selections(effects)) == 1, effects
    assert not any(shown_selections(effects)), effects
    found = answer(effects)
    assert found["ok"] is False
    return str(found["code"])


def logged(effects: list[Effect]) -> list[dict[str, Any]]:
    return [e.message["entry"] for e in of_type(effects, Broadcast) if e.message["type"] == "log"]
