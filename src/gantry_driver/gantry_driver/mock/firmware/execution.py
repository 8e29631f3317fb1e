"""Execution of lines by the mock board: EEPROM writes, moves, arcs, dwells, probing, homing."""

from __future__ import annotations

import math
from collections.abc import Callable

from gantry_driver.mock.firmware import reports
from gantry_driver.mock.firmware.floats import float32
from gantry_driver.mock.firmware.gcode import check_line
from gantry_driver.mock.firmware.interrupts import EEPROM_BYTE_S
from gantry_driver.mock.firmware.motion import Block
from gantry_driver.mock.firmware.parser_state import PLANE_AXES, CheckedBlock
from gantry_driver.mock.firmware.realtime import DWELL_STEP_S, RealTime
from gantry_driver.mock.firmware.states import (
    ALARM_HOME_DOOR,
    ALARM_HOME_PULL_OFF,
    ALARM_HOME_SEARCH,
    ALARM_PROBE_END,
    ALARM_PROBE_START,
    ALARM_SOFT,
    ERROR_BAD_STATEMENT,
    ERROR_DOOR,
    ERROR_HOMING_OFF,
    ERROR_TRAVEL,
    Abort,
    Answering,
    Firmware,
    Flag,
    Overrides,
    State,
)
from gantry_driver.mock.firmware.words import LETTER, FirmwareGcodeError

MAX_COUNT = 0xFFFF
"""Maximum count in dwells and arcs: the firmware counts with 16 bits, and drops higher bits."""


class Execution(RealTime):
    """Plans and waits like the firmware's motion control."""

    def _write_eeprom(self, change: Callable[[], None]) -> Firmware:
        """Change the stored data; during the write of each changed byte the board receives nothing."""
        yield from self._buffer_sync()
        before = self.eeprom.image()
        change()
        changed = sum(a != b for a, b in zip(before, self.eeprom.image()))
        if changed == 0 and self.eeprom_pause is None:
            return
        busy_s = (changed + 1) * EEPROM_BYTE_S  # one more for the checksum
        tail_s = 0.0
        if self.eeprom_pause is not None:
            (busy_s, tail_s), self.eeprom_pause = self.eeprom_pause, None
        self._deaf_from, self._deaf_until = self.now, self.now + busy_s + tail_s
        self.journal.note(self.now, "eeprom", bytes=changed, deaf_s=round(busy_s + tail_s, 6))
        yield self.now + busy_s

    # ---- moves

    def _beyond(self, target: list[float]) -> bool:
        travel = self.eeprom.axis_values(130)
        return any(float32(t) > 0.0 or float32(t) < -m for t, m in zip(target, travel))

    def _line_to(
        self,
        target: list[float],
        rate: float,
        *,
        rapid: bool = False,
        inverse_time: bool = False,
        fixed_rate: bool = False,
        checked: bool = False,
    ) -> Firmware:
        """Plan a straight move, waiting for room."""
        if not checked and self.eeprom.flag(20) and self._beyond(target):
            yield from self._soft_limit_alarm()
        if self.state is State.CHECK:
            return
        while True:
            yield from self._checkpoint()
            if self.motion.room:
                break
            if self.state is State.IDLE:
                self._auto_start()
            else:
                yield None
        self.motion.add(
            self._steps(target), self.now, rate=rate, rapid=rapid, inverse_time=inverse_time, fixed_rate=fixed_rate
        )

    def _soft_limit_alarm(self) -> Firmware:
        self._soft_limit = True
        if self.state is State.RUN:
            self._flags.add(Flag.HOLD)
            yield from self._until(lambda: self.state is State.IDLE)
        self.raise_alarm(ALARM_SOFT)
        yield from self._checkpoint()

    def _gcode(self, line: str) -> Answering:
        if line.startswith("$"):  # only in a startup line; it is read as a jog, whatever the next two characters are
            return (yield from self._jog_words(line[3:])) if len(line) > 2 else LETTER
        try:
            block = check_line(line, self.parser, self.eeprom.systems, mist=self.options.mist)
        except FirmwareGcodeError as error:
            return error.number
        try:
            yield from self._execute(block)
        except Abort:
            if block.program:  # an aborted line is processed to its end
                self._say(reports.PROGRAM_END)
            raise
        return 0

    def _jog_words(self, words: str) -> Answering:
        try:
            block = check_line(words, self.parser, self.eeprom.systems, jog=True)
        except FirmwareGcodeError as error:
            return error.number
        if self.eeprom.flag(20) and self._beyond(block.target):
            return ERROR_TRAVEL
        yield from self._line_to(block.target, block.feed / 60.0, fixed_rate=True, checked=True)
        self.parser.position = list(block.target)
        if self.state is State.IDLE and self.motion.blocks:
            self.state = State.JOG
            self.motion.start(self.now)
        return 0

    def _execute(self, block: CheckedBlock) -> Firmware:
        """Carry out a checked block in the order of RS274/NGC."""
        p, new = self.parser, block.modes
        p.modes.feed_mode, p.feed = new.feed_mode, block.feed
        active = self.state is not State.CHECK
        if p.speed != block.speed:
            if p.modes.spindle != 5 and active:
                yield from self._buffer_sync()
                self._set_spindle(p.modes.spindle, block.speed)
            p.speed = block.speed
        p.tool = block.tool
        if p.modes.spindle != new.spindle:
            if active:
                yield from self._buffer_sync()
                self._set_spindle(new.spindle)
            p.modes.spindle = new.spindle
        if (p.modes.flood, p.modes.mist) != (new.flood, new.mist):
            if active:
                yield from self._buffer_sync()
                self._set_coolant(new.flood, new.mist)
            p.modes.flood, p.modes.mist = new.flood, new.mist
        if block.action == 4 and active:
            yield from self._dwell(block.dwell_s)
        p.modes.plane, p.modes.units = new.plane, new.units
        if block.tool_length is not None and block.tool_length != p.tool_length:
            p.tool_length = block.tool_length
            yield from self._offset_changed()
        if p.modes.system != new.system:
            p.modes.system = new.system
            yield from self._offset_changed()
        p.modes.distance = new.distance
        yield from self._act(block)
        p.modes.motion = new.motion
        if block.moves and new.motion != 80:
            yield from self._move(block)
        if block.program is not None:
            yield from self._program(block.program)

    def _offset_changed(self) -> Firmware:
        yield from self._buffer_sync()
        self._wco_wait = 0

    def _dwell(self, seconds: float) -> Firmware:
        yield from self._buffer_sync()
        for _ in range(math.ceil(seconds / DWELL_STEP_S - 1e-9) & MAX_COUNT):
            yield from self._checkpoint()
            yield self.now + DWELL_STEP_S

    def _act(self, block: CheckedBlock) -> Firmware:
        p, places = self.parser, self.eeprom.systems
        if block.action == 10:
            yield from self._write_eeprom(lambda: places.__setitem__(block.place_index, list(block.place)))
            if block.place_index == p.modes.system:
                yield from self._offset_changed()
        elif block.action in (28, 30):
            if block.target != p.position:
                yield from self._line_to(block.target, 0.0, rapid=True)
            yield from self._line_to(block.place, 0.0, rapid=True)
            p.position = list(block.place)
        elif block.action in (28.1, 30.1):
            index = len(places) - (2 if block.action == 28.1 else 1)
            here = list(p.position)
            yield from self._write_eeprom(lambda: places.__setitem__(index, here))
        elif block.action == 92:
            p.g92 = self.eeprom.g92 = list(block.place)
            yield from self._offset_changed()
        elif block.action == 92.1:
            p.g92 = self.eeprom.g92 = [0.0, 0.0, 0.0]
            yield from self._offset_changed()

    def _move(self, block: CheckedBlock) -> Firmware:
        motion = block.modes.motion
        inverse = block.modes.feed_mode == 93
        if motion == 0:
            yield from self._line_to(block.target, 0.0, rapid=True)
        elif motion == 1:
            yield from self._line_to(block.target, block.feed / 60.0, inverse_time=inverse)
        elif motion in (2, 3):
            yield from self._arc(block, inverse)
        else:
            yield from self._probe(block)
            return
        self.parser.position = list(block.target)

    def _arc(self, block: CheckedBlock, inverse: bool) -> Firmware:
        """Trace an arc by chords that stay within the arc tolerance $12."""
        first, second, normal = PLANE_AXES[block.modes.plane]
        start = list(self.parser.position)
        center = (start[first] + block.center[0], start[second] + block.center[1])
        begin = math.atan2(start[second] - center[1], start[first] - center[0])
        end = math.atan2(block.target[second] - center[1], block.target[first] - center[0])
        sweep = end - begin
        clockwise = block.modes.motion == 2
        if clockwise and sweep >= -5e-7:
            sweep -= 2 * math.pi
        elif not clockwise and sweep <= 5e-7:
            sweep += 2 * math.pi
        tolerance = self.eeprom.values[12]
        chord = 2 * math.sqrt(max(tolerance * (2 * block.radius - tolerance), 1e-12))
        count = max(int(abs(sweep) * block.radius / chord) & MAX_COUNT, 1)
        rate = block.feed / 60.0 * (count if inverse else 1)
        for i in range(1, count):
            angle = begin + sweep * i / count
            point = list(start)
            point[first] = center[0] + block.radius * math.cos(angle)
            point[second] = center[1] + block.radius * math.sin(angle)
            point[normal] += (block.target[normal] - start[normal]) * i / count
            yield from self._line_to(point, rate, inverse_time=inverse)
        yield from self._line_to(block.target, rate, inverse_time=inverse)

    def _program(self, number: int) -> Firmware:
        yield from self._buffer_sync()
        if number == 0:
            if self.state is not State.CHECK:
                self._flags.add(Flag.HOLD)
                yield from self._checkpoint()
            return
        modes = self.parser.modes
        modes.motion, modes.plane, modes.distance, modes.feed_mode, modes.system = 1, 17, 90, 94, 0
        modes.spindle, modes.flood, modes.mist = 5, False, False
        self.overrides = Overrides()
        self.motion.override(self.now, feed=1.0, rapid=1.0)
        if self.state is not State.CHECK:
            self._wco_wait = 0
            self._set_spindle(5)
            self._set_coolant(False, False)
        self._say(reports.PROGRAM_END)

    def _probe(self, block: CheckedBlock) -> Firmware:
        """G38.2 to G38.5: move until the probe closes (or opens), then decelerate."""
        if self.state is State.CHECK:
            self.parser.position = list(block.target)
            return
        yield from self._buffer_sync()
        away = block.modes.motion in (38.4, 38.5)
        must = block.modes.motion in (38.2, 38.4)
        self._probe_ok = False
        self._probe_away = away
        if self._probe_triggered():
            self._halt(slips=False)
            self._alarm = ALARM_PROBE_START
            yield from self._checkpoint()
            self._probe_away = False
            return
        self._probing = self._probe_along
        yield from self._line_to(block.target, block.feed / 60.0, fixed_rate=True)
        self._auto_start()
        yield from self._until(lambda: self.state is State.IDLE)
        self._probing = None
        if not self._probe_ok:
            self._probed_at = self.motion.position(self.now)
            if must:
                self._alarm = ALARM_PROBE_END
        yield from self._checkpoint()
        self.motion.halt(self.now)
        self._probe_away = False
        self._sync_parser()
        self._say(reports.probe(self._mm(self._probed_at), self._probe_ok, self.eeprom.flag(13)))

    def _probe_along(self, block: Block) -> float | None:
        surface, n = self.mechanics.probe_z_mm, block.steps[2]
        # The input must open if a closed one does not count: with $6 or away from the surface, but not with both.
        opens = self.eeprom.flag(6) != self._probe_away
        if surface is None or not n or (n > 0) != opens:
            return None
        steps = abs(self.mechanics.motor[2] - surface * self.mechanics.steps_per_mm[2])
        distance = self.motion.done + steps / abs(n) * block.length
        return distance if distance <= block.length else None

    # ---- homing

    def _homing_command(self, rest: str) -> Answering:
        if not self.eeprom.flag(22):
            return ERROR_HOMING_OFF
        if self.mechanics.door_open:
            return ERROR_DOOR
        if rest != "H" and self.options.dialect != "GRBL":
            return ERROR_BAD_STATEMENT
        self.state = State.HOME
        if rest != "H":
            return ERROR_BAD_STATEMENT  # GRBL stays in Home until a reset
        if self.options.dialect == "grblHAL":
            self._stop_tools()
            modes = self.parser.modes
            modes.spindle, modes.flood, modes.mist, self.parser.speed = 5, False, False, 0.0
        for axes in ((2,), (0, 1)):  # the stylus is lifted before the carriage moves
            yield from self._home_axes(axes)
        self._flags.discard(Flag.STOPPED)
        self._flags.discard(Flag.HOLD)
        while self._alarm is not None or self._flags:
            yield from self._serve()
        self._sync_parser()
        self.state = State.IDLE
        self.journal.count("homings")
        yield from self._run_startup()
        return 0

    def _home_axes(self, axes: tuple[int, ...]) -> Firmware:
        e = self.eeprom
        seek, locate, pull_off = e.values[25], e.values[24], e.values[27]
        search = 1.5 * max(e.values[130 + i] for i in axes)
        self.mechanics.draw_trips()
        phases = ((True, search, seek), (False, pull_off, seek), (True, 5 * pull_off, locate), (False, pull_off, seek))
        for approach, distance, rate in phases:
            yield from self._home_move(axes, approach, distance, rate / 60.0 * math.sqrt(len(axes)))
            if approach and not all(self.mechanics.pressed(i) for i in axes):
                yield from self._homing_failed(ALARM_HOME_SEARCH)
            if not approach and any(self.mechanics.pressed(i) for i in axes):
                yield from self._homing_failed(ALARM_HOME_PULL_OFF)
            yield self.now + e.values[26] / 1000.0
        here = self._mm(self.motion.position(self.now))
        for i in axes:
            here[i] = -e.values[130 + i] + pull_off if self._home_sign(i) < 0 else -pull_off
        steps = self._steps(here)
        self.motion.set_position(steps)
        self.mechanics.renumber(steps)

    def _home_sign(self, axis: int) -> int:
        return -1 if int(self.eeprom.values[23]) >> axis & 1 else 1

    def _home_move(self, axes: tuple[int, ...], approach: bool, distance: float, rate: float) -> Firmware:
        """Move until each axis has met its switch (approach) or by ``distance``; the report stays unanswered."""
        here = self.motion.position(self.now)
        target = list(here)
        scale = self._steps_per_mm()
        for i in axes:
            target[i] += round(distance * scale[i]) * self._home_sign(i) * (1 if approach else -1)
        self._flags.discard(Flag.STOPPED)
        block = self.motion.add((target[0], target[1], target[2]), self.now, rate=rate, fixed_rate=True)
        if block is None:
            return
        if approach:
            x, y, z = (self._along(block, i) for i in range(3))
            block.freeze = (x, y, z)
        self.motion.start(self.now)
        while Flag.STOPPED not in self._flags:
            if Flag.RESET in self._flags:
                yield from self._serve()
            if Flag.DOOR in self._flags:
                yield from self._homing_failed(ALARM_HOME_DOOR)
            yield None

    def _homing_failed(self, number: int) -> Firmware:
        self._alarm = number
        self.soft_reset()
        yield from self._serve()
