"""A GRBL board on a serial port for one program without ROS: connect, home, run checked G-code.

The calling thread sends the operator's heartbeat while a call waits. The machine holds if this thread hangs, or if the
program ends, while a G-code program runs.
"""

from __future__ import annotations

import dataclasses
import gc
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType

from gantry_driver.adapters.serial_link import SerialLink
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.grbl.settings_profile import differences
from gantry_driver.core.grbl.trajectory_gcode import TrajectoryError
from gantry_driver.core.machine.machine import Machine
from gantry_driver.core.program.gcode_words import GcodeError
from gantry_driver.core.states.machine_states import Answered, Event, Note, StateChanged
from icu_common.core.goals.results import GoalResult, Outcome

TURN_S = 0.1
"""Seconds between heartbeats while a call waits."""
BROKEN = ("stopped", "alarm", "mismatch")
"""States of the board that end a call."""


class GrblError(Exception):
    """The board, or its port, cannot do what was asked; the message gives the reason."""


class GrblClient:
    """A board that this program alone uses; as a context manager it is closed with the stylus up.

    Parameters
    ----------
    port
        Device of the board, opened exclusively; by default that of ``config``.
    config
        The machine: travel, speeds and stylus; by default the driver's defaults. The board's settings must agree.
    on_turn
        Called in the calling thread at each turn of a waiting call, about ten times per second.
    on_text
        Called with changes of state, warnings and errors, in the calling thread at each turn.

    Examples
    --------
    ::

        with GrblClient("/dev/ttyUSB0") as board:
            board.home()
            board.run(["G53 G1 X-100 Y-50 F3000"])
    """

    def __init__(
        self,
        port: str = "",
        config: DriverConfig | None = None,
        *,
        on_turn: Callable[[], None] = lambda: None,
        on_text: Callable[[str], None] = lambda text: None,
    ) -> None:
        config = DriverConfig() if config is None else config
        config = dataclasses.replace(config, enabled_at_start=True, port=port or config.port)
        self._machine = Machine(config)
        self._before_opening = self._machine.state_text
        self._on_turn, self._on_text = on_turn, on_text
        self._result: GoalResult | None = None
        self._texts: list[str] = []
        self._link = SerialLink(self._machine, config.port, config.baud, self._on_events)
        self._link.start()

    def __enter__(self) -> GrblClient:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def state(self) -> str:
        """State of the board, with its reason: ``idle``, ``alarm: hard limit``."""
        return self._machine.state_text

    @property
    def lines_done(self) -> int:
        """Number of lines that the board has executed since it was connected."""
        return self._machine.counts.executed

    @property
    def position_m(self) -> tuple[float, float, float] | None:
        """Last reported x, y and extension of the stylus in metres, 0 at the homed position; None before homing."""
        return self._machine.reading_m

    def connect(self) -> None:
        """Wait until the board answers and its settings are read; the other calls connect by themselves.

        Raises
        ------
        GrblError
        """
        self._turn_until(
            lambda: self._machine.state != "connecting" and self._machine.state_text != self._before_opening
        )
        if self._machine.state == "disconnected":
            raise GrblError(f"the board is {self._machine.state_text}")

    def home(self) -> None:
        """Home the machine and wait for the end of the cycle.

        Raises
        ------
        GrblError
        """

        def home(machine: Machine, now: float) -> str:
            machine.heartbeat(now)
            return machine.home(now)

        self.connect()
        self._need("unhomed", "idle")
        if refusal := self._link.call(home):
            raise GrblError(f"homing was refused: {refusal}")
        self._turn_until(lambda: self._machine.state != "homing")
        self._need("idle")

    def run(self, source: Sequence[str]) -> GoalResult:
        """Check a program from the current position, stream it, and return its result when the machine rests again.

        Parameters
        ----------
        source
            Lines of G-code. No line is sent if one of them leaves the machine's travel, or is no valid G-code.

        Returns
        -------
        GoalResult
            Its outcome is ``Outcome.REACHED``, or its reason says why the program ended early.

        Raises
        ------
        GrblError
            Also for a line that cannot be sent, and for a machine that is not homed.
        """
        self._need("idle")
        self._result = None
        # The check may take seconds; it does not block the link.
        try:
            checker = self._link.call(lambda machine, now: machine.program_checker())
            checked = list(checker.check_all(source))
        except (TrajectoryError, GcodeError) as error:
            raise GrblError(str(error)) from error

        def start(machine: Machine, now: float) -> None:
            machine.heartbeat(now)
            machine.run_checked("program", checker, checked, now)

        # A garbage collection with a long program in memory can take longer than the heartbeat's time-out.
        gc.collect()
        gc.freeze()
        self._link.call(start)
        self._turn_until(lambda: self._result is not None)
        assert self._result is not None
        return self._result

    def pause_or_resume(self) -> str:
        """Hold the running program, or continue a held one; return the reason of a rejection, or ""."""

        def toggle(machine: Machine, now: float) -> str:
            return machine.resume(now) if machine.paused else machine.pause(now)

        return self._link.call(toggle)

    def settings(self) -> dict[int, str]:
        """Return the board's settings by number, as it lists them for ``$$``.

        Raises
        ------
        GrblError
        """
        self.connect()
        return self._machine.settings

    def expected_settings(self) -> dict[int, float]:
        """Return the settings that the configured machine needs on the connected board."""
        return self._machine.expected_settings()

    def write_settings(self, profile: Mapping[int, float]) -> list[str]:
        """Write the settings that differ from a profile and read them back; return those that the board did not keep.

        Raises
        ------
        GrblError
        """
        if refusal := self._link.call(lambda machine, now: machine.write_settings(now, profile)):
            raise GrblError(refusal)
        return differences(self.settings(), profile, "what was written")

    def close(self) -> None:
        """Hold a moving machine, lift the stylus, and close the port."""
        self._link.close("interrupted")
        self._turn()

    def _need(self, *states: str) -> None:
        if self._machine.state not in states:
            raise GrblError(f"the board is {self._machine.state_text}; expected {states[0]!r}")

    def _turn_until(self, condition: Callable[[], bool]) -> None:
        while not condition():
            if self._machine.state in BROKEN and self._result is None:
                raise GrblError(f"the board is {self._machine.state_text}")
            self._turn()
        self._turn()

    def _turn(self) -> None:
        before = self._result
        self._link.call(lambda machine, now: machine.heartbeat(now))
        self._link.wait_for(lambda machine: self._result is not before, TURN_S)
        while self._texts:
            self._on_text(self._texts.pop(0))
        self._on_turn()

    def _on_events(self, events: Sequence[Event]) -> None:
        for event in events:
            if isinstance(event, StateChanged):
                if event.logged:
                    self._texts.append(event.text)
            elif isinstance(event, Note):
                self._texts.append(f"{event.level}: {event.text}")
            elif isinstance(event, Answered) and event.result.outcome is not Outcome.ACCEPTED:
                self._result = event.result
