"""State of the stylus, which may be down, and the transitions between the states.

While its position is known, a Z axis is where the board reports it. No report shows a servo or a solenoid: its
position follows from the lines that were sent, after the time that the motion takes. A reset of the board switches a
solenoid off, which lifts it, and ends a servo's pulses, so that it may sink.
"""

from __future__ import annotations

from enum import Enum, auto

from icu_common.core.reasons.message import Message, parts

STYLUS_DOWN_M = 0.0005
"""Extension above which the stylus may touch something and is lifted after a stop."""
MAY_PRESS = Message("stylus.stylus_not_lifted_may_still")
MAY_SINK = Message("stylus.servo_may_without_pulses_sink")
IS_RELEASED = Message("stylus.solenoid_without_power_stylus_up")
LEFT = frozenset(message.code for message in (MAY_PRESS, MAY_SINK, IS_RELEASED))
"""Codes of the clauses of a state's reason that report how the stylus was left."""


class Stylus(Enum):
    """State of the stylus; each transition returns the next state.

    ``kind`` is that of :class:`~gantry_driver.core.configuration.machine_config.StylusConfig`. ``extension_m`` is the
    last reading of the stylus in metres, None while the position is unknown.
    """

    AS_READ = auto()
    """At the last reading: a Z axis at rest. Without a reading, as at the start, the position is unknown."""
    UNDER_WAY = auto()
    """A Z axis with lines in progress that move it: it is at the last reading, and may go down."""
    UP = auto()
    LOWERING = auto()
    """Without a Z axis: ordered down, still moving."""
    DOWN = auto()
    RISING = auto()
    """Without a Z axis: ordered up, still moving; it counts as down until the time of the motion has passed."""
    LIMP = auto()
    """A servo that was up and may have lost its pulses: some boards end them at an alarm, all at a reset or a door."""
    LIMP_DOWN = auto()
    """A servo that was not up when the board was reset, and has lost its pulses."""
    RELEASED = auto()
    """A solenoid that was not up when the board cut its power, which lifts it."""
    LEFT_SEEN = auto()
    """The position was lost with the stylus down according to the last reading."""
    LEFT_UNSEEN = auto()
    """The position was lost with a stylus that may be down although no reading showed it."""

    def presses(self, extension_m: float | None) -> bool:
        """Whether the stylus may press."""
        if self in (Stylus.AS_READ, Stylus.UNDER_WAY):
            return _extended(extension_m)
        return self not in (Stylus.UP, Stylus.RELEASED)

    def ordered(self, down: bool) -> Stylus:
        """A line that moves a stylus without a Z axis has been queued."""
        if down:
            return Stylus.LOWERING
        return Stylus.UP if self in (Stylus.UP, Stylus.RELEASED) else Stylus.RISING

    def settled(self) -> Stylus:
        """The time of the stylus's motion has passed, or the path has ended."""
        ends = {Stylus.UNDER_WAY: Stylus.AS_READ, Stylus.LOWERING: Stylus.DOWN, Stylus.RISING: Stylus.UP}
        return ends.get(self, self)

    @staticmethod
    def lifted(kind: str) -> Stylus:
        """Homing, or the retreat after a stop, is complete."""
        return Stylus.AS_READ if kind == "z_axis" else Stylus.UP

    def seen_clear(self, kind: str) -> Stylus:
        """Note that images show a stylus of unknown position off the panel; only a Z axis holds its position."""
        return Stylus.AS_READ if kind == "z_axis" and self in (Stylus.LEFT_SEEN, Stylus.LEFT_UNSEEN) else self

    def lost(self, extension_m: float | None) -> Stylus:
        """The position is no longer known; lines in progress may have lowered the stylus since the last reading."""
        if self in (Stylus.LIMP, Stylus.LEFT_SEEN, Stylus.LEFT_UNSEEN):
            return self
        if self is not Stylus.UNDER_WAY and not self.presses(extension_m):
            return self
        return Stylus.LEFT_SEEN if _extended(extension_m) else Stylus.LEFT_UNSEEN

    def powerless(self, kind: str) -> Stylus:
        """The pulses may have ended (alarm, reset, open door): nothing holds a servo that is not known to be down."""
        limp = kind == "servo_m3" and self in (Stylus.AS_READ, Stylus.UP)
        return Stylus.LIMP if limp else self

    def was_reset(self, kind: str) -> Stylus:
        """The board was reset and has discarded the lines in progress."""
        if kind == "solenoid_m8":
            return Stylus.UP if self in (Stylus.AS_READ, Stylus.UNDER_WAY, Stylus.UP) else Stylus.RELEASED
        ends = {
            Stylus.UNDER_WAY: Stylus.AS_READ,
            Stylus.UP: Stylus.LIMP,
            **dict.fromkeys((Stylus.LOWERING, Stylus.DOWN, Stylus.RISING), Stylus.LIMP_DOWN),
        }
        return ends.get(self, self)

    def limp(self) -> bool:
        """Whether a servo may have lost its pulses and has received no order since."""
        return self in (Stylus.LIMP, Stylus.LIMP_DOWN)

    def may_be_limp(self, kind: str) -> bool:
        """Whether the stylus is a servo that may have no pulses."""
        return self is Stylus.LIMP or (kind == "servo_m3" and self in (Stylus.LEFT_SEEN, Stylus.LEFT_UNSEEN))


def tells_of_stylus(state_text: str) -> bool:
    """Whether the driver's ``state: reason`` has a clause on how the stylus was left.

    Examples
    --------
    >>> tells_of_stylus(Message("state.because", state="unhomed", reason=MAY_SINK))
    True
    >>> tells_of_stylus("unhomed: the cable may press on it")
    False
    """
    return not LEFT.isdisjoint(part.code for part in parts(state_text))


def _extended(extension_m: float | None) -> bool:
    return extension_m is not None and extension_m > STYLUS_DOWN_M
