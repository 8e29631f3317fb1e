"""The `$` settings of GRBL 1.1 and the other data in the board's EEPROM, with the bench's values.

Numbers, names and limits are those of GRBL's settings document (gnea/grbl, doc/markdown/settings.md and
doc/csv/setting_codes_en_US.csv).
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from gantry_driver.mock.firmware.floats import MAX_NUMBER, float32, print_number

N_SYSTEMS = 6
MASKS = (2, 3, 10, 23)
BOOLEANS = (4, 5, 6, 13, 20, 21, 22, 32)
BYTES = (0, 1, 26)
ROUNDED = (30, 31)
STEPS_PER_MM = (100, 101, 102)
INTEGERS = (*BYTES, *MASKS, *BOOLEANS)

BENCH: dict[int, float] = {
    0: 10, 1: 255, 2: 0, 3: 0, 4: 0, 5: 0, 6: 0,
    10: 3, 11: 0.010, 12: 0.002, 13: 0,
    20: 1, 21: 1, 22: 1, 23: 3, 24: 300.0, 25: 6000.0, 26: 50, 27: 1.0,
    30: 1000.0, 31: 0.0, 32: 0,
    100: 80.0, 101: 80.0, 102: 400.0,
    110: 12000.0, 111: 12000.0, 112: 3000.0,
    120: 1500.0, 121: 1500.0, 122: 400.0,
    130: 360.0, 131: 220.0, 132: 60.0,
}  # fmt: skip
"""Settings of the simulated bench, in the order of `$$`; mm, mm/min, mm/s^2, steps per mm."""

ERROR_INVALID_STATEMENT, ERROR_NEGATIVE, ERROR_STEP_PULSE, ERROR_SOFT_LIMITS = 3, 4, 6, 10


class SettingsError(ValueError):
    """A settings file or a ``--set`` argument cannot be used; the message names the line and the reason."""


@dataclass(slots=True)
class Eeprom:
    """Data that survive a reset and a power cycle.

    ``defaults`` are the values that ``$RST=$`` restores; ``systems`` are G54 to G59, then G28 and G30, in mm.
    """

    defaults: Mapping[int, float] = field(default_factory=lambda: dict(BENCH))
    values: dict[int, float] = field(init=False)
    systems: list[list[float]] = field(init=False)
    startup: list[str] = field(default_factory=lambda: ["", ""])
    build_info: str = ""
    g92: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    """The last ``G92``, in mm; only grblHAL loads it at power-up."""

    def __post_init__(self) -> None:
        self.values = dict(self.defaults)
        self.systems = [[0.0, 0.0, 0.0] for _ in range(N_SYSTEMS + 2)]

    def flag(self, number: int) -> bool:
        """Return whether a boolean setting is on."""
        return self.values[number] != 0

    def axis_values(self, first: int) -> tuple[float, float, float]:
        """Return the three values of a group of axis settings, for example 110 for the maximum rates."""
        return self.values[first], self.values[first + 1], self.values[first + 2]

    def image(self) -> bytes:
        """Return the stored bytes; the number of changed ones determines the duration of a write."""
        numbers = b"".join(
            struct.pack("<B", int(value) & 0xFF) if number in INTEGERS else struct.pack("<f", value)
            for number, value in self.values.items()
        )
        stored = (min(max(v, -MAX_NUMBER), MAX_NUMBER) for system in self.systems for v in system)
        places = struct.pack(f"<{3 * len(self.systems)}f", *stored)
        texts = [text.encode("ascii", "replace").ljust(80, b"\0") for text in (*self.startup, self.build_info)]
        return numbers + places + b"".join(texts)

    def store(self, number: int, value: float) -> int:
        """Store one setting as ``$number=value`` does; return 0 or the number of the error."""
        if value < 0:
            return ERROR_NEGATIVE
        if number not in self.values:
            return ERROR_INVALID_STATEMENT
        if number in INTEGERS:
            value = int(value) & 0xFF  # the firmware reads these into one byte
        if number in BOOLEANS:
            value = float(value != 0)
        if number == 0 and value < 3:
            return ERROR_STEP_PULSE
        if number == 20 and value and not self.flag(22):
            return ERROR_SOFT_LIMITS
        self.values[number] = float32(value)
        if number == 22 and not value:
            self.values[20] = 0  # soft limits are meaningless without homing
        return 0

    def store_startup(self, number: int, line: str) -> None:
        """Store a startup line; a third one would overlap the build information, whose checksum is then wrong.

        Higher numbers are in or beyond it as well, which the mock does not simulate.
        """
        if number < len(self.startup):
            self.startup[number] = line
        elif number == len(self.startup):
            self.build_info = ""

    def clear_places(self) -> None:
        """Zero the work coordinate systems and the G28 and G30 positions."""
        for system in self.systems:
            system[:] = [0.0, 0.0, 0.0]


def shown(number: int, value: float) -> str:
    """Return a setting's value as ``$$`` prints it."""
    if number in INTEGERS:
        return str(round(value))
    return print_number(value, 0 if number in ROUNDED else 3)


_ASSIGNMENT = re.compile(r"\$?(\d+)\s*=\s*([-+0-9.eE]+)")


def parse_assignment(text: str) -> tuple[int, float]:
    """Read ``N=VALUE`` or ``$N=VALUE``.

    Raises
    ------
    SettingsError
        If the text has another form, the setting does not exist, or its value is rejected.
    """
    match = _ASSIGNMENT.fullmatch(text.strip())
    if match is None:
        raise SettingsError(f"{text!r} is not of the form N=VALUE")
    try:
        number, value = int(match[1]), float(match[2])
    except ValueError:
        raise SettingsError(f"{match[2]!r} in {text!r} is not a number") from None
    if number not in BENCH:
        raise SettingsError(f"GRBL 1.1 has no setting ${number}")
    if value > MAX_NUMBER:
        raise SettingsError(f"${number}={match[2]} is above {MAX_NUMBER:g}")
    return number, value


def make_eeprom(assignments: Mapping[int, float]) -> Eeprom:
    """Return a fresh EEPROM with the bench's settings and ``assignments`` on top.

    Raises
    ------
    SettingsError
        If the board would reject a value; the message has the board's error number.
    """
    trial = Eeprom(defaults={**BENCH, 20: 0.0, 22: 0.0})
    wanted = {**BENCH, **assignments}
    for number in sorted(wanted, key=lambda n: (n == 20, n)):  # $20 needs $22 first
        error = trial.store(number, wanted[number])
        if error:
            raise SettingsError(f"${number}={wanted[number]:g} is refused with error:{error}")
        if number in STEPS_PER_MM and not wanted[number]:
            raise SettingsError(f"${number}=0: a machine is built with more than 0 steps per mm")
    return Eeprom(defaults=dict(trial.values))


def read_settings_file(path: Path) -> dict[int, float]:
    """Read a text file of ``$N=VALUE`` lines, such as a saved answer to ``$$``; ``ok`` and comments are skipped."""
    assignments: dict[int, float] = {}
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise SettingsError(f"{path} is no text: {error}") from error
    for line in lines:
        text = re.split(r"[;(#]", line, maxsplit=1)[0].strip()
        if text and text != "ok":
            number, value = parse_assignment(text)
            assignments[number] = value
    return assignments
