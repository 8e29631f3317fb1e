"""The G-code parser of the mock board: one line and the modal state in, a checked block or an error number out.

Words, their conflicts and error numbers follow GRBL 1.1's documents (doc/csv/error_codes_en_US.csv,
doc/markdown/commands.md) and RS274/NGC (NIST, 2000), tables 4 and 5. Where these differ from the firmware, the firmware
is right (gcode.c).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum, auto

from gantry_driver.mock.firmware.floats import one_byte
from gantry_driver.mock.firmware.parser_state import PLANE_AXES, CheckedBlock, ParserState
from gantry_driver.mock.firmware.words import FirmwareGcodeError, split_words

MM_PER_INCH = 25.4

NEGATIVE, BAD_JOG = 4, 16
UNSUPPORTED, MODAL_GROUP, NO_FEED, NOT_INTEGER, AXIS_CONFLICT, REPEATED = 20, 21, 22, 23, 24, 25
NO_AXIS, LINE_NUMBER, MISSING, NO_SYSTEM, G53_MODE, AXIS_UNUSED, NO_PLANE_AXIS = 26, 27, 28, 29, 30, 31, 32
BAD_TARGET, BAD_RADIUS, NO_OFFSET, UNUSED, TLO_AXIS, TOO_LARGE = 33, 34, 35, 36, 37, 38

_MAX_LINE_NUMBER, _MAX_TOOL = 10_000_000, 255
_VALUE_LETTERS = "FIJKLNPRSTXYZ"
_NOT_NEGATIVE = "FNPTS"
_G_GROUPS = {
    "motion": (0, 1, 2, 3, 38, 80),
    "plane": (17, 18, 19),
    "feed mode": (93, 94),
    "units": (20, 21),
    "cutter": (40,),
    "length": (43, 49),
    "system": (54, 55, 56, 57, 58, 59),
    "path": (61,),
    "action": (4, 10, 28, 30, 53, 92),
}
_GROUP_OF = {number: group for group, numbers in _G_GROUPS.items() for number in numbers}
_JOG_GROUPS = {"action", "units", "distance"}


class _Use(Enum):
    """Command that uses the axis words of a line."""

    NONE = auto()
    ACTION = auto()
    MOTION = auto()
    LENGTH = auto()


class _BlockReader:
    """Collects the words of one line into a block, then checks them against each other."""

    def __init__(self, state: ParserState, places: Sequence[Sequence[float]], *, jog: bool, mist: bool) -> None:
        self.state = state
        self.places = places
        self.jog = jog
        self.mist_fitted = mist
        self.modes = state.modes.copy()
        if jog:
            self.modes.motion, self.modes.feed_mode = 1, 94
        self.use = _Use.NONE
        self.groups: set[str] = set()
        self.values: dict[str, float] = {}
        self.action: float | None = None
        self.program: int | None = None
        self.length_command: float | None = None

    def read(self, text: str) -> None:
        for letter, value in split_words(text):
            # A command's number is kept in one byte; the rest counts as its decimals, in two bytes.
            whole = one_byte(value)
            hundredths = math.floor(100 * (value - whole) + 0.5) & 0xFFFF
            if letter == "G":
                self._claim(self._read_g(whole, hundredths))
            elif letter == "M":
                if hundredths > 0:
                    raise FirmwareGcodeError(NOT_INTEGER)
                self._claim(self._read_m(whole))
            else:
                self._read_value(letter, value)

    def _claim(self, group: str) -> None:
        if group in self.groups:
            raise FirmwareGcodeError(MODAL_GROUP)
        self.groups.add(group)

    def _take_axes(self, use: _Use) -> None:
        if self.use is not _Use.NONE:
            raise FirmwareGcodeError(AXIS_CONFLICT)
        self.use = use

    def _read_g(self, number: int, hundredths: int) -> str:
        modes = self.modes
        if number in (90, 91):
            if hundredths == 0:
                modes.distance = number
                return "distance"
            if number == 90 or hundredths != 10:
                raise FirmwareGcodeError(UNSUPPORTED)
            return "arc distance"
        group = _GROUP_OF.get(number)
        if group is None:
            raise FirmwareGcodeError(UNSUPPORTED)
        if group == "action":
            if number in (10, 28, 30, 92) and hundredths == 0:
                self._take_axes(_Use.ACTION)
            self.action = float(number)
            if number in (28, 30, 92):
                if hundredths not in (0, 10):
                    raise FirmwareGcodeError(UNSUPPORTED)
                self.action = number + hundredths / 100
                hundredths = 0
        elif group == "motion":
            if number != 80:
                self._take_axes(_Use.MOTION)
            modes.motion = number
            if number == 38:
                if hundredths not in (20, 30, 40, 50):
                    raise FirmwareGcodeError(UNSUPPORTED)
                modes.motion = 38 + hundredths / 100
                hundredths = 0
        elif group == "length":
            self._take_axes(_Use.LENGTH)
            if number == 43 and hundredths != 10:
                raise FirmwareGcodeError(UNSUPPORTED)
            self.length_command = number
            hundredths = 0
        elif group == "path" and hundredths:
            raise FirmwareGcodeError(UNSUPPORTED)
        if hundredths > 0:
            raise FirmwareGcodeError(NOT_INTEGER)
        if group == "plane":
            modes.plane = number
        elif group == "feed mode":
            modes.feed_mode = number
        elif group == "units":
            modes.units = number
        elif group == "system":
            modes.system = number - 54
        return group

    def _read_m(self, number: int) -> str:
        if number in (0, 1, 2, 30):
            if number != 1:  # optional stop is ignored
                self.program = number
            return "program"
        if number in (3, 4, 5):
            self.modes.spindle = number
            return "spindle"
        if number in (8, 9) or (number == 7 and self.mist_fitted):
            self.modes.mist = number == 7 or (self.modes.mist and number != 9)
            self.modes.flood = number == 8 or (self.modes.flood and number != 9)
            return "coolant"
        raise FirmwareGcodeError(UNSUPPORTED)

    def _read_value(self, letter: str, value: float) -> None:
        if letter not in _VALUE_LETTERS:
            raise FirmwareGcodeError(UNSUPPORTED)
        if letter == "T" and value > _MAX_TOOL:
            raise FirmwareGcodeError(TOO_LARGE)
        if letter in self.values:
            raise FirmwareGcodeError(REPEATED)
        if letter in _NOT_NEGATIVE and value < 0:
            raise FirmwareGcodeError(NEGATIVE)
        self.values[letter] = value

    def check(self) -> CheckedBlock:
        values, modes, state = self.values, self.modes, self.state
        self.axes = [i for i, letter in enumerate("XYZ") if letter in values]
        self.unused = set(values)
        if self.axes and self.use is _Use.NONE:
            self.use = _Use.MOTION
        if int(values.get("N", 0)) > _MAX_LINE_NUMBER:
            raise FirmwareGcodeError(LINE_NUMBER)
        self.scale = MM_PER_INCH if modes.units == 20 else 1.0
        block = CheckedBlock(
            modes=modes,
            feed=self._feed(),
            speed=values.get("S", state.speed),
            tool=int(values.get("T", 0)),
            action=self.action,
            program=self.program,
        )
        if self.action == 4:
            if "P" not in values:
                raise FirmwareGcodeError(MISSING)
            self.unused.discard("P")
            block.dwell_s = values["P"]
        if self.use is _Use.LENGTH:
            self._length(block)
        if self.action == 10:
            self._set_system(block)
        elif self.action == 92:
            self._set_g92(block)
        else:
            self._target(block)
        self._motion(block)
        self.unused -= set("NF" if self.jog else "NFST")
        if self.use is not _Use.NONE:
            self.unused -= set("XYZ")
        if self.unused:
            raise FirmwareGcodeError(UNUSED)
        if self.jog and (self.groups - _JOG_GROUPS or self.action not in (None, 53)):
            raise FirmwareGcodeError(BAD_JOG)
        block.moves = self.use is _Use.MOTION
        return block

    def _feed(self) -> float:
        given = self.values.get("F")
        if self.jog:
            if given is None:
                raise FirmwareGcodeError(NO_FEED)
            return given * self.scale
        if self.modes.feed_mode == 93:
            if self.use is _Use.MOTION and self.modes.motion not in (0, 80) and given is None:
                raise FirmwareGcodeError(NO_FEED)
            return given or 0.0
        if self.state.modes.feed_mode == 93:
            return given or 0.0  # the old value was an inverse time and is invalid now
        return self.state.feed if given is None else given * self.scale

    def _length(self, block: CheckedBlock) -> None:
        if self.length_command == 49:
            block.tool_length = 0.0
        elif self.axes != [2]:
            raise FirmwareGcodeError(TLO_AXIS)
        else:
            block.tool_length = self.values["Z"] * self.scale

    def _offset(self, axis: int) -> float:
        """Offset that is added to a work coordinate in addition to its system: G92 and the tool's length."""
        return self.state.g92[axis] + (self.state.tool_length if axis == 2 else 0.0)

    def _set_system(self, block: CheckedBlock) -> None:
        if not self.axes:
            raise FirmwareGcodeError(NO_AXIS)
        if "P" not in self.values and "L" not in self.values:
            raise FirmwareGcodeError(MISSING)
        index = one_byte(self.values.get("P", 0))
        if index > len(self.places) - 2:
            raise FirmwareGcodeError(NO_SYSTEM)
        mode = one_byte(self.values.get("L", 0))
        if mode not in (2, 20) or (mode == 2 and "R" in self.values):
            raise FirmwareGcodeError(UNSUPPORTED)
        self.unused -= {"P", "L"}
        block.place_index = index - 1 if index else self.modes.system
        block.place = list(self.places[block.place_index])
        for axis in self.axes:
            value = self.values["XYZ"[axis]] * self.scale
            block.place[axis] = self.state.position[axis] - self._offset(axis) - value if mode == 20 else value

    def _set_g92(self, block: CheckedBlock) -> None:
        if not self.axes:
            raise FirmwareGcodeError(NO_AXIS)
        block.place = list(self.state.g92)
        for axis in self.axes:
            value = self.values["XYZ"[axis]] * self.scale
            tool = self.state.tool_length if axis == 2 else 0.0
            block.place[axis] = self.state.position[axis] - self.places[self.modes.system][axis] - tool - value

    def _target(self, block: CheckedBlock) -> None:
        position = self.state.position
        # Without an axis word the firmware leaves the target at 0, so a jog goes to machine zero.
        block.target = [0.0, 0.0, 0.0] if self.jog and not self.axes else list(position)
        if self.use is not _Use.LENGTH:
            for axis in self.axes:
                value = self.values["XYZ"[axis]] * self.scale
                if self.action == 53:
                    block.target[axis] = value
                elif self.modes.distance == 91:
                    block.target[axis] = position[axis] + value
                else:
                    block.target[axis] = value + self.places[self.modes.system][axis] + self._offset(axis)
        if self.action in (28, 30):
            block.place = list(self.places[-2 if self.action == 28 else -1])
            if self.axes:
                block.place = [block.place[i] if i in self.axes else position[i] for i in range(3)]
            else:
                self.use = _Use.NONE
        elif self.action == 53 and self.modes.motion not in (0, 1):
            raise FirmwareGcodeError(G53_MODE)

    def _motion(self, block: CheckedBlock) -> None:
        motion = self.modes.motion
        if motion == 80:
            if self.axes:
                raise FirmwareGcodeError(AXIS_UNUSED)
            return
        if self.use is not _Use.MOTION:
            return
        if motion != 0 and block.feed == 0:
            raise FirmwareGcodeError(NO_FEED)
        if motion in (0, 1):
            if not self.axes:
                self.use = _Use.NONE
            return
        if not self.axes:
            raise FirmwareGcodeError(NO_AXIS)
        if motion in (2, 3):
            self._arc(block)
        elif block.target == self.state.position:
            raise FirmwareGcodeError(BAD_TARGET)

    def _arc(self, block: CheckedBlock) -> None:
        first, second, _ = PLANE_AXES[self.modes.plane]
        if first not in self.axes and second not in self.axes:
            raise FirmwareGcodeError(NO_PLANE_AXIS)
        dx = block.target[first] - self.state.position[first]
        dy = block.target[second] - self.state.position[second]
        if "R" in self.values:
            self.unused.discard("R")
            if block.target == self.state.position:
                raise FirmwareGcodeError(BAD_TARGET)
            radius = self.values["R"] * self.scale
            chord = math.hypot(dx, dy)
            if abs(radius) < chord / 2:
                raise FirmwareGcodeError(BAD_RADIUS)
            # The centre is on the chord's bisector: to the left for the short counter-clockwise arc.
            side = 1.0 if (self.modes.motion == 3) == (radius > 0) else -1.0
            height = side * math.sqrt(radius**2 - chord**2 / 4)
            if chord == 0:
                raise FirmwareGcodeError(BAD_TARGET)
            block.center = (dx / 2 - dy / chord * height, dy / 2 + dx / chord * height)
            block.radius = abs(radius)
            return
        offsets = "IJK"[first], "IJK"[second]
        if not any(letter in self.values for letter in offsets):
            raise FirmwareGcodeError(NO_OFFSET)
        self.unused -= set("IJK")
        i, j = (self.values.get(letter, 0.0) * self.scale for letter in offsets)
        block.center, block.radius = (i, j), math.hypot(i, j)
        error = abs(math.hypot(dx - i, dy - j) - block.radius)
        if error > 0.5 or (error > 0.005 and error > 0.001 * block.radius):
            raise FirmwareGcodeError(BAD_TARGET)


def check_line(
    text: str, state: ParserState, places: Sequence[Sequence[float]], *, jog: bool = False, mist: bool = False
) -> CheckedBlock:
    """Read and check one line.

    Parameters
    ----------
    text
        Capitals without blanks and comments; for a jog, the text after ``$J=``.
    state
        Modes, position and offsets before the line; not changed.
    places
        G54 to G59, then G28 and G30, each (3,) in mm.
    jog
        Apply the rules of ``$J=``.
    mist
        The board has a mist pin (M7).

    Raises
    ------
    FirmwareGcodeError
        With the board's error number.
    """
    reader = _BlockReader(state, places, jog=jog, mist=mist)
    reader.read(text)
    return reader.check()
