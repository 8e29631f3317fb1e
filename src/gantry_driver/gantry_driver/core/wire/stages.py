"""Division of a path into stages: each ends at rest, where reports must prove that the board is at the stage's end.

A stage ends at every extreme of z, and at every reversal of the path. It also ends ``clearance_m`` above the deepest
point of a descent that also moves sideways or is not written in the frame below. The driver sends the next stage only
after that proof. Whatever happens to a line of the descent, the stylus is above the panel until the board has reported
the right position.

While the stylus is extended, lines are written in a separate frame (``G92``), in which the deepest point of the path is
Z0, and X and Y are 100 to 999. The board reports frame and modes before the driver sends the first of these lines. A
line then needs no minus sign and no G53. No flipped, lost, doubled or swapped byte of ``Z0G1`` names a deeper position.
An X that has become a Z is above the travel, and an X or Y that has lost a digit is beyond it: the board itself rejects
both (ALARM:2).
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.grbl.lines import SYNCHRONISE, plain
from gantry_driver.core.grbl.modes import ASK_MODES, RequiredModes
from gantry_driver.core.grbl.trajectory_gcode import (
    MODES,
    SAME_FEED,
    StraightMove,
    StylusOrder,
    TrajectoryMotion,
    stylus_dwell,
    stylus_lines,
)
from gantry_driver.core.states.stylus_state import STYLUS_DOWN_M
from gantry_driver.core.wire.watch import Segment, Vector

DOWN_MM = 1000.0 * STYLUS_DOWN_M
CLEAR_FRAME = "G92.1"
FEED_WORD = re.compile(r"F([\d.]+)")
"""Feed that a line sets: its first word."""
LINE_S = 0.035
"""Maximum seconds to send a line and receive its answer: twice the 16 ms of a USB adapter."""
STAGE_S = 0.2
"""Maximum seconds for the proof of a stage and the modes of the next one."""
SURPLUS_S = 2.0
"""Seconds added to twice the expected duration of a goal."""
_TURNED_BACK = -0.99
_SAME_MM = 0.01
"""Maximum difference of two frames that count as equal: half a motor step is lost at the start of a frame."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SendLine:
    """A line, the maximum duration of its dwell in seconds, and the distance along a program's path at its end."""

    text: str
    dwell_s: float = 0.0
    along_mm: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Confirm:
    """Lines after which ``$G`` must report ``modes``; the driver sends no further line before it does."""

    lines: tuple[str, ...]
    modes: RequiredModes


Item = SendLine | Confirm
Part = StraightMove | StylusOrder


@dataclass(slots=True, kw_only=True)
class MotionStage:
    """A part of a goal that ends at rest.

    Parameters
    ----------
    start_mm, end_mm
        Machine positions in mm; None if the lines are a program, which has one path for all its lines.
    parts
        Moves, and orders to a stylus without a Z axis.
    touching
        Whether the stylus is extended during the stage.
    head
        Lines that are sent first and cause no motion: modes, and the frame.
    tail
        Lines that are sent at the end.
    frame
        Whether the lines of this stage are written in the frame, and the frame must be in force before them.
    """

    start_mm: Vector | None = None
    end_mm: Vector | None = None
    parts: list[Part] = field(default_factory=list)
    touching: bool = False
    head: list[Item] = field(default_factory=list)
    tail: list[Item] = field(default_factory=list)
    frame: bool = False

    @property
    def moves(self) -> list[StraightMove]:
        return [part for part in self.parts if isinstance(part, StraightMove)]

    def segments(self) -> list[Segment]:
        """Return the path with which reports are compared."""
        return [Segment(start_mm=m.start_mm, end_mm=m.end_mm, feed_mm_min=float(m.feed)) for m in self.moves]

    def items(self, offset_mm: Sequence[float] | None, feed: str, config: DriverConfig) -> Iterator[Item]:
        """Yield the lines and confirmations to send.

        Parameters
        ----------
        offset_mm
            The work offset of the frame as the board reports it; None outside a frame.
        feed
            The number of the F word in force, empty if there is none.
        """
        yield from self.head
        inside = offset_mm if self.frame else None
        for part in self.parts:
            if isinstance(part, StylusOrder):
                yield from _stylus_items(part, config)
                continue
            line, new = move_words(part, inside), not same_feed(part.feed, feed)
            if new and self.touching:
                yield confirm_feed(part.feed)
            yield SendLine(text=f"F{part.feed}{line}" if new and not self.touching else line)
            feed = part.feed if new else feed
        yield from self.tail


@dataclass(frozen=True, slots=True, kw_only=True)
class Script:
    """Stages of a motion, and its maximum duration in seconds without pauses."""

    stages: list[MotionStage]
    origin_mm: Vector | None
    """Frame in which the path is written, None outside a frame."""
    limit_s: float

    def lines(self, config: DriverConfig) -> list[str]:
        """Return the lines of all stages, as they are sent if every proof succeeds at the first try."""
        lines: list[str] = []
        feed = ""
        for stage in self.stages:
            for item in stage.items(self.origin_mm, feed, config):
                new = [item.text] if isinstance(item, SendLine) else [*item.lines, ASK_MODES]
                feed = next((match[1] for text in new if (match := FEED_WORD.match(text))), feed)
                lines += new
        return lines


def same_feed(feed: str, before: str) -> bool:
    """Whether a feed differs from the one in force only by rounding."""
    return bool(before) and abs(float(feed) - float(before)) <= SAME_FEED * float(before)


def move_words(move: StraightMove, offset_mm: Sequence[float] | None = None) -> str:
    """Return the line of a move, in machine coordinates or in a frame with this work offset."""
    words = []
    for axis, letter in enumerate("XYZ"):
        start, end = move.start_mm[axis], move.end_mm[axis]
        if axis >= move.axes or plain(end) == plain(start):
            continue
        if offset_mm is not None:
            end -= offset_mm[axis]
            # Z0 is the deepest position; a rounded value below it would need a minus sign.
            end = max(end, 0.0) if axis == 2 else end
        words.append(f"{letter}{plain(end)}")
    return "".join(words) + ("G53G1" if offset_mm is None else "G1")


def confirm_feed(feed: str) -> Confirm:
    """Return the order that only sets a feed."""
    return Confirm(
        lines=(f"F{feed}",), modes=RequiredModes(words=frozenset({"G21", "G90", "G94"}), feed_mm_min=float(feed))
    )


def frame_origin(deepest_mm: float, config: DriverConfig) -> Vector:
    """Return the machine position of the frame's zero: X and Y start at a power of ten, Z at the deepest point."""
    x, y, _ = config.machine.travel_mm
    base = 100.0 if max(config.machine.travel_mm) < 900.0 and config.machine.travel_mm[2] < 100.0 else 1000.0
    return -x - base, -y - base, round(deepest_mm, 3)


def make_script(
    motion: TrajectoryMotion, config: DriverConfig, *, framed: bool, frame_mm: Sequence[float] | None, feed: str = ""
) -> Script:
    """Return the stages of a motion.

    Parameters
    ----------
    framed
        Whether the board keeps a ``G92`` until its reset and no longer.
    frame_mm
        Work offset of the active frame.
    """
    z_axis = config.stylus.kind == "z_axis"
    framed = framed and config.machine.sign(2) < 0.0
    stages = _z_stages(motion, config, framed) if z_axis else _order_stages(motion)
    stages = stages or [MotionStage(start_mm=motion.start_mm, end_mm=motion.start_mm)]
    first = next((n for n, stage in enumerate(stages) if stage.touching), None)
    origin = None
    if z_axis and first is not None:
        places = [motion.start_mm, *(move.end_mm for move in motion.moves)]
        deepest = max(places, key=lambda place: depth_mm(place, config))[2]
        origin = frame_origin(deepest, config) if framed else None
        first = _prepare(stages, first, origin, frame_mm, config)
    if first != 0 and not stages[0].head:
        stages[0].head.append(SendLine(text=MODES))
    if origin is not None and depth_mm(motion.end_mm, config) <= DOWN_MM:
        stages[-1].tail.append(SendLine(text=CLEAR_FRAME))
    stages[-1].tail.append(SendLine(text=SYNCHRONISE))
    return Script(stages=stages, origin_mm=origin, limit_s=_limit_s(motion, stages, config))


def _prepare(
    stages: list[MotionStage], first: int, origin: Vector | None, frame_mm: Sequence[float] | None, config: DriverConfig
) -> int | None:
    """Order modes, feed and frame before the first stage that touches; return its number, None for a retreat only."""
    kept = origin is not None and frame_mm is not None and _same_frame(origin, frame_mm)
    lifts = origin is not None and frame_mm is not None and frame_mm[2] <= origin[2] + _SAME_MM
    retreat = first == 0 and all(_only_rises(stage) for stage in stages if stage.touching)
    if retreat and lifts:
        for stage in stages:
            stage.frame = stage.touching
            stage.touching = False  # no part of it goes down, so it needs no proof before it starts
        return None
    if first == 0:
        stages.insert(0, MotionStage(start_mm=stages[0].start_mm, end_mm=stages[0].start_mm))
        first = 1
    feed = stages[first].moves[0].feed
    words, here = f"F{feed}{MODES}", stages[first].start_mm
    if origin is not None and not kept and here is not None:
        words += "".join(f"{letter}{plain(p - o)}" for letter, p, o in zip("XYZ", here, origin)) + "G92"
    # In one line with G90 and G94: a G92 that noise has changed into one of these is rejected (error:21) and moves
    # nothing.
    stages[first - 1].tail.append(Confirm(lines=(words,), modes=confirm_feed(feed).modes))
    for stage in stages[first:]:
        stage.frame = origin is not None
        stage.touching = True
    return 0 if first == 1 and not stages[0].parts else first


def _same_frame(origin: Sequence[float], frame_mm: Sequence[float]) -> bool:
    return all(abs(a - b) <= _SAME_MM for a, b in zip(origin, frame_mm))


def _only_rises(stage: MotionStage) -> bool:
    return all(m.start_mm[:2] == m.end_mm[:2] and m.end_mm[2] >= m.start_mm[2] for m in stage.moves)


def depth_mm(place: Sequence[float], config: DriverConfig) -> float:
    """Return the extension of the stylus at a machine position, in mm."""
    return (place[2] - config.machine.homed_mpos_mm()[2]) * config.machine.sign(2)


def _direction(move: StraightMove, config: DriverConfig) -> int:
    change = depth_mm(move.end_mm, config) - depth_mm(move.start_mm, config)
    return 0 if abs(change) < 5e-4 else (1 if change > 0 else -1)


def _turns_back(one: StraightMove, other: StraightMove) -> bool:
    first, second = ([b - a for a, b in zip(m.start_mm, m.end_mm)] for m in (one, other))
    product = math.hypot(*first) * math.hypot(*second)
    return product > 0.0 and sum(a * b for a, b in zip(first, second)) < _TURNED_BACK * product


def _z_stages(motion: TrajectoryMotion, config: DriverConfig, framed: bool) -> list[MotionStage]:
    moves: list[StraightMove] = []
    ends: set[int] = set()
    """Numbers of the moves at whose end a stage ends."""
    run: list[StraightMove] = []
    for move in [*motion.moves, None]:
        if run and (move is None or _direction(move, config) != 1):
            if framed and all(m.start_mm[:2] == m.end_mm[:2] for m in run):
                # It starts at rest above its target, and no damaged line of the frame goes deeper than its end.
                moves += run
            else:
                _go_down(run, moves, ends, config)
            run = []
        if move is not None:
            (run if _direction(move, config) == 1 else moves).append(move)
    for number, (move, after) in enumerate(itertools.pairwise(moves)):
        if _direction(move, config) != _direction(after, config) or _turns_back(move, after):
            ends.add(number)
    ends.add(len(moves) - 1)
    stages, begin = [], 0
    for end in sorted(ends) if moves else ():
        part = moves[begin : end + 1]
        down = any(depth_mm(p, config) > DOWN_MM for m in part for p in (m.start_mm, m.end_mm))
        stages.append(MotionStage(start_mm=part[0].start_mm, end_mm=part[-1].end_mm, parts=[*part], touching=down))
        begin = end + 1
    return stages


def _go_down(run: Sequence[StraightMove], moves: list[StraightMove], ends: set[int], config: DriverConfig) -> None:
    """Append the moves of one descent, divided at ``clearance_m`` above its end."""
    stop = depth_mm(run[-1].end_mm, config) - 1000.0 * config.clearance_m
    if stop - depth_mm(run[0].start_mm, config) < DOWN_MM:
        stop = -math.inf  # the descent starts there
    for move in run:
        start, end = depth_mm(move.start_mm, config), depth_mm(move.end_mm, config)
        if start < stop <= end:
            share = (stop - start) / (end - start)
            x, y, z = (round(a + share * (b - a), 3) for a, b in zip(move.start_mm, move.end_mm))
            moves.append(move.part(move.start_mm, (x, y, z)))
            ends.add(len(moves) - 1)
            move = move.part((x, y, z), move.end_mm)
            if move.start_mm == move.end_mm:
                continue
        moves.append(move)


def _order_stages(motion: TrajectoryMotion) -> list[MotionStage]:
    """Divide a path before each order to go down, and at each reversal."""
    stages: list[MotionStage] = []
    here, parts = motion.start_mm, list[Part]()
    for number, part in enumerate(motion.parts):
        before = motion.parts[number - 1] if number else None
        turn = isinstance(part, StraightMove) and isinstance(before, StraightMove) and _turns_back(before, part)
        if parts and (turn or (isinstance(part, StylusOrder) and part.down)):
            stages.append(MotionStage(start_mm=here, end_mm=_end(here, parts), parts=parts))
            here, parts = _end(here, parts), []
        parts.append(part)
    if parts:
        stages.append(MotionStage(start_mm=here, end_mm=_end(here, parts), parts=parts))
    return stages


def _end(here: Vector, parts: Sequence[Part]) -> Vector:
    return next((part.end_mm for part in reversed(parts) if isinstance(part, StraightMove)), here)


def _stylus_items(order: StylusOrder, config: DriverConfig) -> Iterator[Item]:
    """Yield an order to a servo or solenoid, to be confirmed by ``$G``, and its dwell."""
    line, _ = stylus_lines(order.down, config)
    if config.stylus.kind == "servo_m3":
        spindle = config.stylus.servo_down if order.down else config.stylus.servo_up
        modes = RequiredModes(words=frozenset({"M3"}), spindle=spindle)
    else:
        modes = RequiredModes(words=frozenset({line}))
    yield Confirm(lines=(line,), modes=modes)
    yield SendLine(text=stylus_dwell(config), dwell_s=config.stylus.dwell_s)


def _limit_s(motion: TrajectoryMotion, stages: Sequence[MotionStage], config: DriverConfig) -> float:
    """Return twice the expected duration and a surplus.

    The expected duration includes the moves (at their feeds, or at an axis's rate if that is lower), the acceleration
    and deceleration at every corner of the path. It also includes the dwells, the lines, and the proofs.
    """
    orders = len(motion.parts) - len(motion.moves)
    seconds = STAGE_S * len(stages) + LINE_S * len(motion.parts) + config.stylus.dwell_s * orders
    slowest = min(config.machine.acceleration_mm_s2)
    before: StraightMove | None = None
    for move in motion.moves:
        change = [abs(b - a) for a, b in zip(move.start_mm, move.end_mm)]
        length = math.hypot(*change)
        rates = zip(change, config.machine.max_rate_mm_min)
        seconds += 60.0 * max(length / float(move.feed), *(c / rate for c, rate in rates))
        if before is None or _corner(before, move):
            limits = [a * length / c for a, c in zip(config.machine.acceleration_mm_s2, change) if c > 0.0]
            speed, acceleration = float(move.feed) / 60.0, min(limits, default=slowest)
            seconds += min(speed / acceleration, 2.0 * math.sqrt(length / acceleration))
        before = move
    return 2.0 * seconds + SURPLUS_S


def _corner(one: StraightMove, other: StraightMove) -> bool:
    first, second = ([b - a for a, b in zip(m.start_mm, m.end_mm)] for m in (one, other))
    product = math.hypot(*first) * math.hypot(*second)
    return product <= 0.0 or sum(a * b for a, b in zip(first, second)) < 0.99 * product
