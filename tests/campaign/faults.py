"""The faults of the campaign, the promises, and the judge: the board's own journal and its motors.

The same run is made in virtual time (:class:`~campaign.virtual_link.VirtualRig`) and on a pseudo-terminal
(:class:`~campaign.port_rig.PortRig`).

Each seed is one run: a random path, as a trajectory or as a G-code program, one fault at a random moment, and then the
promises. No line is lost, doubled or reordered without a report, and there is no false done. Nothing moves after the
answer but the stylus upwards, no byte goes beyond the buffer, and no wait is unbounded. In virtual time one seed
reproduces one run, to the byte.
"""

from __future__ import annotations

import dataclasses
import math
import random
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from gantry_driver.core.configuration.machine_config import DriverConfig, StylusConfig
from gantry_driver.core.machine.machine import Machine
from icu_common.core.goals.results import GoalResult

HOMED = (-359.0, -219.0, -1.0)
CLEARANCE_MM = 10.5
"""Height above the deepest point at which the driver waits for a report."""
Point = tuple[float, float, float]


MAY_PRESS_MM = 0.52
"""Extension that is not worth a retreat, and a step."""
ANSWER_WITHIN_S = 120.0
REST_WITHIN_S = 60.0
CONFIG = DriverConfig(enabled_at_start=True, answer_timeout_s=1.5)
SERVO = dataclasses.replace(CONFIG, stylus=StylusConfig(kind="servo_m3"))


class Rig(Protocol):
    """A machine, a board, and what a run needs of them; all times in seconds of the rig's clock."""

    machine: Machine
    results: list[GoalResult]

    def home(self) -> None: ...
    def go(self, points: Sequence[Point], goal_id: str) -> GoalResult: ...
    def call(self, action: Callable[[Machine, float], Any]) -> Any: ...
    def stop(self, reason: str) -> None: ...
    def fault(self, kind: str, **arguments: Any) -> None: ...
    def until(self, condition: Callable[[], Any], within_s: float) -> None: ...
    def run_for(self, seconds: float) -> None: ...
    def mpos(self) -> Point: ...
    def servo(self) -> float: ...
    def counter(self, name: str) -> int: ...
    def lines(self, since: int, kind: str = "line") -> list[dict[str, Any]]: ...
    @property
    def entry(self) -> int: ...


Do = Callable[[Rig, random.Random], Any]


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Event of the fault; ``before`` marks those that are armed before the path is sent."""

    name: str
    do: Do
    before: bool = False
    must_reach: bool = False
    powerless: bool = False
    """The board loses its power, and with it the lines that it has not executed."""


def write_settings(rig: Rig, rng: random.Random) -> None:
    """Write a setting to a board that receives nothing for a long time while it stores it; then home again."""
    rig.fault("eeprom_pause", seconds=rng.uniform(0.02, 1.2), tail_s=rng.uniform(0.0, 0.045))
    refusal = rig.call(lambda machine, now: machine.write_settings(now, {12: rng.choice([0.001, 0.003])}))
    assert not refusal, refusal
    rig.home()
    assert rig.machine.settings[12] in ("0.001", "0.003"), rig.machine.settings


def vanish_while_writing(rig: Rig, rng: random.Random) -> None:
    """The port accepts no bytes for some time, and then it disappears with those that wait in it."""
    rig.fault("stop_reading", seconds=1.0)
    rig.run_for(rng.uniform(0.0, 0.9))
    rig.fault("unplug", seconds=rng.uniform(0.05, 5.0))


FAULTS = (
    Fault(name="none", do=lambda rig, rng: None, must_reach=True),
    Fault(name="unplug", do=lambda r, g: r.fault("unplug", seconds=g.uniform(0.05, 5.0)), powerless=True),
    Fault(name="brown-out", do=lambda r, g: r.fault("brown_out"), powerless=True),
    Fault(name="soft reset", do=lambda r, g: r.fault("soft_reset")),
    Fault(name="error", do=lambda r, g: r.fault("error", number=22, after=g.randrange(12)), before=True),
    Fault(name="garbage", do=lambda r, g: r.fault("garbage", count=g.randrange(1, 200))),
    Fault(name="stray ok", do=lambda r, g: r.fault("stray_ok", count=g.randrange(1, 3))),
    Fault(name="lost", do=lambda r, g: r.fault("answers", how="lost", count=g.randrange(1, 3)), before=True),
    Fault(
        name="delayed",
        do=lambda r, g: r.fault("answers", how="delayed", count=2, seconds=g.uniform(0.1, 4.0)),
        before=True,
    ),
    Fault(name="split", do=lambda r, g: r.fault("answers", how="split", count=5), before=True, must_reach=True),
    Fault(name="merged", do=lambda r, g: r.fault("answers", how="merged", count=3), before=True, must_reach=True),
    Fault(name="EEPROM pause", do=lambda r, g: write_settings(r, g), before=True, must_reach=True),
    Fault(name="vanishes", do=lambda r, g: vanish_while_writing(r, g), powerless=True),
    Fault(name="alarm", do=lambda r, g: r.fault("alarm", number=g.choice([1, 2]))),
    Fault(name="hang", do=lambda r, g: r.fault("hang", seconds=g.uniform(0.2, 20.0))),
    Fault(name="full", do=lambda r, g: r.fault("stop_reading", seconds=g.uniform(0.1, 12.0))),
    Fault(name="door", do=lambda r, g: r.fault("door", on=True)),
    Fault(name="stop button", do=lambda r, g: r.fault("stop_button", on=True)),
    Fault(name="limit", do=lambda r, g: r.fault("limit", axis="X", on=True)),
    Fault(name="operator stop", do=lambda r, g: r.stop("stop requested")),
)


def fault_of(seed: int) -> Fault:
    """Every fault comes once in as many seeds as there are faults."""
    return FAULTS[seed % len(FAULTS)]


def config_of(seed: int) -> DriverConfig:
    """A Z axis for two thirds of the seeds, a servo for the others."""
    return SERVO if seed // len(FAULTS) % 3 == 2 else CONFIG


def path(rng: random.Random) -> list[Point]:
    """Return a path of short and of longer segments somewhere in the travel, with the stylus up or down."""
    size = rng.choice([0.002, 0.02, 0.1])
    x, y = rng.uniform(0.0, 0.359 - size), rng.uniform(0.0, 0.219 - size)
    down = rng.choice([0.0, 0.0, 0.02])
    return [
        (round(x + rng.uniform(0.0, size), 3), round(y + rng.uniform(0.0, size), 3), down)
        for _ in range(rng.randrange(4, 40))
    ]


def run_seed(seed: int, rig: Rig) -> str:
    """Run one seed and return the fault's name and the outcome; a promise that does not hold is an AssertionError."""
    rng = random.Random(seed)
    fault = fault_of(seed)
    rig.home()
    since, way = rig.entry, path(rng)
    if fault.before:
        fault.do(rig, rng)
    program = bool(seed // len(FAULTS) % 2)
    if rig.machine.config.stylus.kind == SERVO.stylus.kind:
        low, way = way[0][2] > 0, [(x, y, 0.0) for x, y, _ in way]
        points = [(x, y, 0.02 if low and n < len(way) - 1 else 0.0) for n, (x, y, _) in enumerate(way)]
    else:
        low, points = False, way
    sent = program_of(way, rng) if program else moves_of(way)
    if program:
        source = [*(["M3 S800"] if low else []), *source_of(sent), *(["M3 S200"] if low else [])]
        accepted = rig.call(lambda machine, now: machine.run_program(str(seed), source, now))
    else:
        accepted = rig.go(points, str(seed))
    assert accepted.outcome.value == "accepted", accepted
    if not fault.before:
        rig.run_for(rng.choice([0.02, 0.3, 4.0]) * rng.random())
        fault.do(rig, rng)
    rig.until(lambda: len(rig.results) >= 2, ANSWER_WITHIN_S)
    answer = rig.results[-1]
    reached = answer.outcome.value == "reached"
    assert reached or (answer.outcome.value == "aborted" and answer.reason), answer
    assert reached or not fault.must_reach, answer
    judge(rig, fault, way, sent, since, reached=reached)
    assert rig.counter("bytes_lost_overflow") == 0, "more bytes than the buffer holds"
    assert rig.counter("bytes_lost_eeprom") == 0, "bytes to a board that stores a setting"
    assert [r.goal_id for r in rig.results] == [str(seed)] * 2, "one acceptance and one final answer"
    return f"{fault.name}: {answer.outcome.value}"


def judge(rig: Rig, fault: Fault, way: list[Point], sent: list[str], since: int, *, reached: bool) -> None:
    if reached:
        x, y, z = way[-1]
        target = (HOMED[0] + 1000 * x, HOMED[1] + 1000 * y, HOMED[2] - 1000 * z)
        assert max(abs(a - b) for a, b in zip(rig.mpos(), target)) <= 0.05, f"a false done: {rig.mpos()}, not {target}"
    # A link that is gone, or a board that hangs, cannot be stopped; the answer says so. Rest begins when it is back.
    rig.until(lambda: rig.machine.connected and rig.machine.at_rest, REST_WITHIN_S)
    before = rig.mpos()
    rig.run_for(2.0)
    after = rig.mpos()
    assert max(abs(a - b) for a, b in zip(after[:2], before[:2])) < 1e-6, f"motion after the answer: {before}, {after}"
    assert after[2] >= before[2] - 1e-6, f"the stylus went down after the answer: {before}, {after}"
    told = any(
        text in rig.machine.state_text for text in ("not lifted: ", "did not lift the stylus in time")
    )  # by the board
    if not reached and rig.machine.homed and fault.name != "door" and not told:
        assert after[2] > HOMED[2] - MAY_PRESS_MM and rig.servo() != CONFIG.stylus.servo_down, (
            f"a stop that presses: {after}"
        )
    if fault.powerless:
        return
    # A board that was reset while moving is locked (error:9) and refuses what was still on the wire. One that was reset
    # at rest is not: it may obey neither a line nor the rest of one that reaches it then.
    first_banner = min((entry["n"] for entry in rig.lines(since, "banner")), default=math.inf)
    heard = [
        entry["text"]
        for entry in rig.lines(since)
        if entry["answer"] == "ok" or (entry["answer"] != "error:9" and entry["n"] < first_banner)
    ]
    if any("G92" in text or "Z-10.5G53" in text for text in heard):
        judge_places(heard, way, reached=reached)
        return
    taken = [text for text in heard if text[:1] != "$" and ("X" in text or "Y" in text)]
    assert taken == sent[: len(taken)], f"lost, doubled or reordered: {taken}, {sent}"
    assert not reached or len(taken) == len(sent)


def judge_places(heard: Sequence[str], way: list[Point], *, reached: bool) -> None:
    """Compare where lines go that are written in a frame, or stop on the way down, with the points of the path.

    After a path that was ended, early or after its end, the stylus may be lifted to where it is homed; nothing follows.
    """
    here, offset = list(HOMED), [0.0, 0.0, 0.0]
    wanted = [(HOMED[0] + 1000 * x, HOMED[1] + 1000 * y, HOMED[2] - 1000 * z) for x, y, z in way]
    wanted = [place for place, before in zip(wanted, [HOMED, *wanted]) if place != before]
    lifted = False
    for text in heard:
        words = {a: float(value) for a, value in re.findall(r"([XYZ])(-?[\d.]+)", text)}
        lifts = (not reached or not wanted) and "G53" in text and words == {"Z": HOMED[2]}
        assert lifts or not lifted or not words, f"{text} follows the lift of a path that was ended"
        if "G92" in text:
            offset = [at - words.get(a, at) for a, at in zip("XYZ", here)]
        elif words:
            base = [0.0, 0.0, 0.0] if "G53" in text else offset
            here = [words[a] + o if a in words else at for a, at, o in zip("XYZ", here, base)]
            next_place = next(iter(wanted), None)
            if lifts and (next_place is None or max(abs(a - b) for a, b in zip(here, next_place)) >= 0.002):
                lifted = True
                continue
            assert next_place is not None, f"{text} goes on behind the end of the path"
            if max(abs(a - b) for a, b in zip(here, next_place)) < 0.002:
                wanted.pop(0)
            else:
                above = here[2] - next_place[2]
                assert abs(above - CLEARANCE_MM) < 0.002, f"{text} is neither a point nor a stop above one"
    assert not reached or not wanted, f"never sent: {wanted}"


def moves_of(way: list[Point]) -> list[str]:
    """Return the lines that this path must become, computed independently of the driver."""
    lines, here, feed = [], (0.0, 0.0, 0.0), ""
    for point in way:
        words = "".join(
            f"{letter}{format(home + sign * 1000 * value, '.3f').rstrip('0').rstrip('.')}"
            for letter, home, sign, value, old in zip("XYZ", HOMED, (1, 1, -1), point, here)
            if value != old
        )
        seconds = max(
            ((point[0] - here[0]) ** 2 + (point[1] - here[1]) ** 2) ** 0.5 / 0.15, abs(point[2] - here[2]) / 0.03
        )
        length = sum((1000 * (a - b)) ** 2 for a, b in zip(point, here)) ** 0.5
        if words:
            word = f"F{format(length / seconds * 60, '.1f').rstrip('0').rstrip('.')}"
            if not feed or abs(float(word[1:]) / float(feed[1:]) - 1.0) > 0.005:
                feed, words = word, word + words
            lines.append(f"{words}G53G1")
        here = point
    return lines


RAPID = "F17234"
"""The highest feed of all axes together: how a rapid move is sent."""


def program_of(way: list[Point], rng: random.Random) -> list[str]:
    """Return the lines of a path in which some moves are rapid."""
    lines, feed, own = [], "", ""
    for line in moves_of(way):
        word, axes = re.fullmatch(r"(F[\d.]+)?(.*)G53G1", line).groups()  # type: ignore[union-attr]
        own = word or own
        new = RAPID if rng.random() < 0.2 else own
        lines.append(f"{new if new != feed else ''}{axes}G53G1")
        feed = new
    return lines


def source_of(lines: list[str]) -> list[str]:
    """Return such lines as people write them: the command first, every feed, and G0 where it is meant."""
    source, feed = ["G21 G90 ; a path"], ""
    for line in lines:
        word, axes = re.fullmatch(r"(F[\d.]+)?(.*)G53G1", line).groups()  # type: ignore[union-attr]
        feed = word or feed
        spaced = re.sub(r"([XYZ])", r" \1", axes)
        source.append(f"G53 G0{spaced}" if feed == RAPID else f"G53 G1{spaced} {feed}")
    return source
