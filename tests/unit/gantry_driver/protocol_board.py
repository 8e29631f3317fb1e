"""A small board in virtual time for the pure tests: enough of GRBL 1.1 to answer, move, hold, reset and lose bytes.

The emulation that the node tests use is the program mock_grbl; this one is a page that can be read next to a test.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable
from typing import Any

from gantry_driver.core.configuration.envelope_config import EnvelopeConfig
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.grbl.trajectory_gcode import Waypoint
from gantry_driver.core.machine.machine import Machine
from gantry_driver.core.states.machine_states import Answered, Event, Position, StateChanged
from icu_common.core.goals.results import GoalResult

HOMED = (-359.0, -219.0, -1.0)
SETTINGS = {
    13: "0",
    20: "1",
    22: "1",
    23: "3",
    27: "1.000",
    30: "1000",
    31: "0",
    32: "0",
    100: "80.000",
    101: "80.000",
    102: "400.000",
    110: "12000.000",
    111: "12000.000",
    112: "3000.000",
    120: "1500.000",
    121: "1500.000",
    122: "400.000",
    130: "360.000",
    131: "220.000",
    132: "60.000",
}

NO_PANEL = EnvelopeConfig(free_space_m=0.2, crossing_m=0.2)
"""Most tests are about something else than the panel: their whole travel is free space."""
BANNER = b"\r\nGrbl 1.1h ['$' for help]\r\n"


class Board:
    """Constant speed, 15 blocks, 128 bytes; ``executed`` and ``lost_bytes`` are the truth."""

    def __init__(self, *, locked: bool = True) -> None:
        self.settings = dict(SETTINGS)
        self.startup = ["", ""]
        self.macros: dict[str, str] = {}
        self.spoilt: dict[str, float] = {}
        self.mpos = [0.0, 0.0, 0.0]
        self.homed = HOMED
        self.state = "Alarm" if locked else "Idle"
        self.out = bytearray()
        self.rx = bytearray()
        self.blocks: list[tuple[str, list[float], float]] = []
        self.executed: list[str] = []
        self.received: list[str] = []
        self.lost_bytes = 0
        self.resets = 0
        self.realtime: list[tuple[float, int]] = []
        self.now = 0.0
        self.speed_scale = 1.0
        self.hooks: dict[str, Callable[[], None]] = {}
        self.mute = False
        self.held_up_until = -1.0
        self.waiting = bytearray()
        self.critical_until = -1.0
        self.homing_until = -1.0
        self.feed = 1000.0
        self.offset = [0.0, 0.0, 0.0]
        """Work offset, of a ``G92`` alone."""
        self.modes = {"motion": "G0", "spindle": "M5", "coolant": "M9", "speed": "0", "feed": "0"}
        self.refuse: dict[str, int] = {}
        self.drop_answers = 0
        self.stubborn: set[int] = set()
        self.hold_s = 0.05
        self.overrides = [100, 100, 100]
        self._hold_done = math.inf

    def write(self, data: bytes) -> None:
        """Take bytes; those that come while it is held up wait, and are then read one by one."""
        if self.now < self.held_up_until or self.waiting:
            self.waiting += data
            return
        self._take(data)

    def _take(self, data: bytes) -> None:
        for byte in data:
            if byte in b"?!~\x18\x90\x99":
                self.realtime.append((self.now, byte))
                self._realtime(byte)
            elif len(self.rx) >= 128:
                self.lost_bytes += 1
            else:
                self.rx.append(byte)

    def _realtime(self, byte: int) -> None:
        if byte == 0x18:
            if self.critical_until < 0 or self.now >= self.critical_until:
                self.reset()
        elif byte == ord("?"):
            if self.homing_until < 0 and self.critical_until < 0:
                self.say(self.report())
        elif byte == ord("!"):
            if self.state == "Run":
                self.state, self._hold_done = "Hold:1", self.now + self.hold_s
            elif self.state == "Idle":
                self.state = "Hold:0"
        elif byte == ord("~") and self.state == "Hold:0":
            self.state = "Run" if self.blocks else "Idle"
        elif byte in (0x90, 0x99):
            self.overrides[0 if byte == 0x90 else 2] = 100

    def report(self) -> str:
        x, y, z = self.mpos
        offset = ",".join(f"{value:.3f}" for value in self.offset)
        room = f"Bf:{15 - len(self.blocks)},{128 - len(self.rx)}"
        overrides = "" if self.overrides == [100, 100, 100] else "|Ov:{},{},{}".format(*self.overrides)
        return f"<{self.state}|MPos:{x:.3f},{y:.3f},{z:.3f}|{room}|FS:0,0|WCO:{offset}{overrides}>"

    def say(self, text: str) -> None:
        """Send a line, or noise in its place as often as ``spoilt`` says."""
        data = text.encode()
        if self.spoilt.get(text, 0) > 0:
            self.spoilt[text] -= 1
            data = b"\xf8\x81" + data[2:]
        if not self.mute:
            self.out += data + b"\r\n"

    def reset(self) -> None:
        """0x18, or the power: locked when it moved."""
        self.resets += 1
        moving = self.state in ("Run", "Hold:1") or self.homing_until >= 0
        if moving:
            self.say("ALARM:3")
        self.rx.clear()
        self.blocks.clear()
        self.offset = [0.0, 0.0, 0.0]
        self.modes = {"motion": "G0", "spindle": "M5", "coolant": "M9", "speed": "0", "feed": "0"}
        self.homing_until = self.critical_until = -1.0
        self.state = "Alarm" if moving or self.state == "Alarm" else "Idle"
        if not self.mute:
            self.out += BANNER
        if self.state == "Alarm":
            self.say("[MSG:'$H'|'$X' to unlock]")

    def alarm(self, code: int) -> None:
        self.state = "Alarm"
        self.blocks.clear()
        self.rx.clear()
        self.say(f"ALARM:{code}")
        if code in (1, 2):
            self.critical_until = self.now + 0.5

    def power_cycle(self) -> None:
        self.mpos = [0.0, 0.0, 0.0]
        self.state = "Alarm"
        self.reset()

    def step(self, now: float) -> None:
        dt, self.now = now - self.now, now
        if now < self.held_up_until:
            return
        if self.waiting:
            self._take(bytes([self.waiting.pop(0)]))
        if 0 <= self.critical_until <= now and self.critical_until > now - dt:
            self.say("[MSG:Reset to continue]")
        if 0 <= self.homing_until <= now:
            self.homing_until = -1.0
            self.mpos, self.state = list(self.homed), "Idle"
            self._answer("$H")
        if self.state == "Hold:1" and now >= self._hold_done:
            self.state = "Hold:0"
        self._move(dt if self.state in ("Run", "Hold:1") else 0.0)
        while self.homing_until < 0 and self._next_line():
            pass

    def _move(self, dt: float) -> None:
        while dt > 0 and self.blocks:
            text, target, feed = self.blocks[0]
            way = math.dist(self.mpos, target)
            can = feed / 60.0 * self.speed_scale * dt
            if can < way:
                self.mpos = [m + (t - m) * can / way for m, t in zip(self.mpos, target)]
                return
            self.mpos, dt = list(target), dt - way / (feed / 60.0 * self.speed_scale)
            self.executed.append(text)
            self.blocks.pop(0)
        if not self.blocks and self.state == "Run":
            self.state = "Idle"

    def _next_line(self) -> bool:
        end = self.rx.find(b"\n")
        if end < 0 or self.state == "Hold:1" or (self.state == "Hold:0" and len(self.blocks) >= 15):
            return False
        text = bytes(self.rx[:end]).decode()
        if (text.startswith("G4") or "G92" in text) and (self.blocks or self.state != "Idle"):
            return False
        if text.endswith("G1") and len(self.blocks) >= 15:
            return False
        del self.rx[: end + 1]
        self.received.append(text)
        if text in self.hooks:
            self.hooks.pop(text)()
        self._execute(text)
        return True

    def _execute(self, text: str) -> None:
        if text in self.refuse:
            self.say(f"error:{self.refuse[text]}")
            return
        if text == "$H":
            self.homing_until = self.now + 1.0
            return
        if text == "$I":
            self.say("[VER:1.1h.20190825:]")
            self.say("[OPT:V,15,128]")
        elif text == "$$":
            for number, value in self.settings.items():
                self.say(f"${number}={value}")
        elif text == "$N":
            for number, line in enumerate(self.startup):
                self.say(f"$N{number}={line}")
        elif text in self.macros:
            self.say(f"{text}={self.macros[text]}")
        elif match := re.fullmatch(r"\$(\d+)=(.+)", text):
            if int(match[1]) not in self.stubborn:
                self.settings[int(match[1])] = f"{float(match[2]):.3f}"
        elif self.state == "Alarm" and text != "$X":
            self.say("error:9")
            return
        elif text == "$G":
            modes = self.modes
            self.say(
                f"[GC:{modes['motion']} G54 G17 G21 G90 G94 {modes['spindle']} {modes['coolant']} T0 "
                f"F{float(modes['feed']):.0f} S{modes['speed']}]"
            )
        elif re.search("[XYZ]", text) and text.endswith("G1"):
            words = dict(re.findall(r"([XYZF])(-?[\d.]+)", text))
            target = list(self.blocks[-1][1] if self.blocks else self.mpos)
            offset = [0.0, 0.0, 0.0] if "G53" in text else self.offset
            for axis, letter in enumerate("XYZ"):
                if letter in words:
                    target[axis] = float(words[letter]) + offset[axis]
            self._set_modes(text)
            self.blocks.append((text, target, self.feed))
            if self.state == "Idle":
                self.state = "Run"
        elif text == "$X":
            self.state = "Idle"
        else:
            self._set_modes(text)
            if "G92" in text:
                place = self.blocks[-1][1] if self.blocks else self.mpos
                words = {} if "G92.1" in text else dict(re.findall(r"([XYZ])(-?[\d.]+)", text))
                self.offset = [at - float(words[a]) if a in words else 0.0 for a, at in zip("XYZ", place)]
            self.executed.append(text)
        self._answer(text)

    def _set_modes(self, text: str) -> None:
        """Record the reports of ``$G``."""
        for name, pattern in (
            ("motion", r"G(?:80|1)(?!\d)"),
            ("spindle", r"M[35]"),
            ("coolant", r"M[89]"),
        ):
            if match := re.search(pattern, text):
                self.modes[name] = match[0]
        for name, letter in (("feed", "F"), ("speed", "S")):
            if match := re.search(rf"{letter}([\d.]+)", text):
                self.modes[name] = match[1]
        self.feed = float(self.modes["feed"]) or self.feed

    def _answer(self, text: str) -> None:
        if self.drop_answers:
            self.drop_answers -= 1
            return
        self.say("ok")


class Rig:
    """A machine and a board on one virtual clock."""

    def __init__(
        self,
        config: DriverConfig | None = None,
        board: Board | None = None,
        envelope: EnvelopeConfig = NO_PANEL,
        **kwargs: Any,
    ) -> None:
        self.board = board or Board(**kwargs)
        config = config or DriverConfig(enabled_at_start=True)
        self.machine = Machine(dataclasses.replace(config, envelope=envelope))
        self.now = 0.0
        self.beating = True
        self.connected = True
        self.states: list[str] = []
        self.codes: dict[str, str] = {}
        self.results: list[GoalResult] = []
        self.positions: list[tuple[float, float, float]] = []
        self.events: list[Event] = []
        self.trace: list[tuple[float, bytes]] = []
        self.collect()

    def connect(self) -> Rig:
        self.machine.opened(self.now)
        self.board.reset()
        self.until(lambda: self.state not in ("connecting", "disconnected"))
        return self

    def homed(self) -> Rig:
        self.connect()
        self.step()
        assert self.machine.home(self.now) == ""
        self.until(lambda: self.state == "idle", 5.0)
        return self

    @property
    def state(self) -> str:
        return self.machine.phase.state

    def step(self, dt: float = 0.005) -> None:
        self.now += dt
        if self.beating:
            self.machine.heartbeat(self.now)
        self.board.step(self.now)
        data, self.board.out = bytes(self.board.out), bytearray()
        if self.connected:
            if data:
                self.machine.receive(data, self.now)
            self.machine.tick(self.now)
            out = self.machine.output(self.now)
            if out:
                self.trace.append((self.now, out))
                self.board.write(out)
            assert self.board.lost_bytes == 0
        self.collect()

    def collect(self) -> None:
        for event in self.machine.take_events():
            self.events.append(event)
            if isinstance(event, StateChanged):
                self.states.append(event.text)
                self.codes = dict(event.codes)
            elif isinstance(event, Answered):
                self.results.append(event.result)
            elif isinstance(event, Position):
                self.positions.append(event.reading_m)

    def code(self) -> str:
        """Return the code that the machine has published with its newest state, empty for none."""
        assert self.codes == dict(self.machine.codes()), "the report of every second has the same one"
        return self.codes.get("code", "")

    def until(self, condition: Callable[[], Any], within_s: float = 10.0) -> None:
        end = self.now + within_s
        while not condition():
            assert self.now < end, f"not within {within_s} s: {self.states[-5:]} {self.results[-2:]} {self.board.state}"
            self.step()

    def run_for(self, seconds: float) -> None:
        end = self.now + seconds
        while self.now < end:
            self.step()

    def go(self, *points: tuple[float, ...], **kwargs: Any) -> GoalResult:
        names = ("gantry_x_joint", "gantry_y_joint", "stylus_joint")[: len(points[0])]
        way = [Waypoint(positions_m=point, **kwargs) for point in points]
        return self.machine.run("goal", names, way, age_s=0.0, now=self.now)

    def outcomes(self) -> list[str]:
        return [result.outcome.value for result in self.results]

    def sent(self) -> str:
        return b"".join(data for _, data in self.trace).decode("latin-1")
