"""Prepare the machine for goals: enable, home, calibrate if necessary, and wait for "ready".

Exit codes: 0 ready, 1 rejected or failed (with the reason), 2 wrong usage, 3 not ready in time.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

from std_srvs.srv import SetBool, Trigger

from gantry_driver.cli.operator_session import (
    FAILED,
    REACHED,
    TIMED_OUT,
    Ends,
    Interrupted,
    OperatorSession,
    TimedOut,
    complain,
    number,
    operator_session,
    say,
)
from icu_common.adapters.processes.processor_load import LoadMeter, measure_processor_load
from icu_common.adapters.processes.program_end import ends_quietly
from icu_common.core.processes.preparation import (
    PreparationCause,
    PreparationReport,
    PreparationStage,
    calibration_report,
    to_line,
)
from icu_common.core.processes.processor_load import ProcessorLoad
from icu_common.core.reasons.codes import DriverCode
from icu_common.core.reasons.state_text import state_name
from icu_common.nodes.messages.answers import answer_of
from icu_common.nodes.runtime import own_arguments

DRIVER, CALIBRATION, CONTROLLER = "gantry/driver_state", "calibration/state", "gantry/state"
_BROKEN = ("disconnected", "stopped", "alarm", "mismatch")
TIMEOUT_S = 400.0
GROWTH = 4.0
"""Factor up to which limits grow while other programs use the processor."""
MEASURE_S = 10.0
CONNECT_S = 60.0
CAMERA_S = 120.0
HOME_S = 10.0
"""Seconds during which homing is requested again: on a busy computer the first heartbeats may still be in transit."""
RETRY_S = 1.0
CODE_S = 3.0
"""Maximum seconds to wait for the code of a state, which arrives on another topic than its text."""


class PreparationFailed(Exception):
    """A step was rejected or has failed; the message gives the reason."""


_ADVICE = {
    DriverCode.HOMED_ELSEWHERE.value: (
        "; a switch may have been touched: call gantry/reset and prepare once more, which homes again; where it "
        "ends at the same place, correct travel_mm, pull_off_mm or homing_direction_mask of the configured machine"
    ),
    DriverCode.SETTINGS_DIFFER.value: (
        "; call gantry/write_settings to give the board the configured ones (gantry_gcode settings --write does so "
        "without a driver), correct machine.* of the configuration where the board is right, or call "
        "gantry/accept_settings to go on with these differences"
    ),
}
"""How to leave a mismatch, as the end of a sentence, by the code of its reason."""


class Narrator:
    """Prints sentences for people, or the codes of ``icu_common.core.processes.preparation`` for bring-up."""

    def __init__(self, *, json: bool = False) -> None:
        self._json = json
        self.stage = PreparationStage.CONNECTING

    def begin(self, stage: PreparationStage) -> None:
        """Note the next step."""
        self.stage = stage
        if self._json:
            say(to_line(PreparationReport(stage=stage)))

    def say(self, text: str) -> None:
        """Print a sentence about the current step."""
        say(to_line(PreparationReport(stage=self.stage, text=text)) if self._json else text)

    def state(self, what: str, text: str) -> None:
        """Print a state that the current step follows."""
        if self._json and self.stage is PreparationStage.CALIBRATING:
            say(to_line(calibration_report(text)))
        else:
            self.say(f"{what}: {text}")

    def fail(self, cause: PreparationCause, reason: str) -> None:
        """Print why the current step has failed."""
        if self._json:
            say(
                to_line(
                    PreparationReport(stage=PreparationStage.FAILED, failed_at=self.stage, cause=cause, text=reason)
                )
            )
        elif cause is PreparationCause.INTERRUPTED:
            say(reason)
        else:
            complain(reason)


def prepare(
    session: OperatorSession,
    *,
    home: bool,
    calibrate: bool,
    timeout_s: float,
    growth: float = GROWTH,
    narrator: Narrator | None = None,
) -> None:
    """Carry out the steps; ``home`` and ``calibrate`` request these steps even if they are not necessary.

    On a busy computer all limits grow up to ``growth`` times their values.

    Raises
    ------
    PreparationFailed, TimedOut, Interrupted
    """
    for topic in (DRIVER, CALIBRATION):
        session.watch(topic)
    session.watch_codes(DRIVER)
    narrator = narrator or Narrator()
    steps = _PreparationSteps(session, timeout_s, growth, narrator=narrator)
    narrator.begin(PreparationStage.CONNECTING)
    steps.connect()
    narrator.begin(PreparationStage.ENABLING)
    steps.call(SetBool, "gantry/enable", SetBool.Request(data=True))
    # The state may still be the one before the call: homed, but not enabled.
    if home or state_name(session.latest(DRIVER)) not in ("idle", "disabled"):
        narrator.begin(PreparationStage.HOMING)
        steps.call(Trigger, "gantry/home", Trigger.Request(), patience_s=HOME_S)
        steps.follow(DRIVER, "homing", done=lambda text: text == "idle", failed=_BROKEN)
    narrator.begin(PreparationStage.CAMERAS)
    # A stored calibration counts once the cameras have shown that it belongs to them.
    steps.wait(
        lambda: session.latest(CALIBRATION) and "waiting" not in session.latest(CALIBRATION),
        lambda: f"calibration/state: {session.latest(CALIBRATION) or 'nothing'}",
    )
    calibration = state_name(session.latest(CALIBRATION))
    if calibrate or calibration != "calibrated":
        if calibration != "calibrating":
            # Cameras can take longer to start than a machine to home.
            steps.call(Trigger, "calibration/run", Trigger.Request(), patience_s=CAMERA_S)
        narrator.begin(PreparationStage.CALIBRATING)
        steps.follow(CALIBRATION, "calibration", done=lambda t: state_name(t) == "calibrated", failed=("failed",))
    narrator.begin(PreparationStage.CONTROLLER)
    steps.wait_ready()
    narrator.begin(PreparationStage.READY)


class _PreparationSteps:
    def __init__(
        self,
        session: OperatorSession,
        timeout_s: float,
        growth: float = GROWTH,
        load: LoadMeter | None = None,
        narrator: Narrator | None = None,
    ) -> None:
        self._session = session
        self._narrator = narrator or Narrator()
        self._started = time.monotonic()
        self._timeout_s, self._growth = timeout_s, growth
        self._factor = 1.0
        self._load = load or LoadMeter()
        self._seen_before_call: dict[str, int] = {}
        self._publishers_before_call: dict[str, Ends] = {}

    @property
    def _until(self) -> float:
        return self._started + self._timeout_s * self._factor

    def _patiently(self, wait: Callable[[float], Any], base_s: float = math.inf) -> Any:
        """Carry out a wait with a deadline, which is extended while the computer is busy.

        ``base_s`` is the limit of this wait; the deadline of the whole preparation applies as well.
        """
        began = time.monotonic()
        while True:
            until = min(self._until, began + base_s * self._factor)
            try:
                return wait(until)
            except TimedOut as error:
                if time.monotonic() <= until or not self._grow(str(error)):
                    raise

    def _grow(self, missing: str) -> bool:
        """Double all limits if the computer is busy and the bound is not reached; print what uses the processor."""
        if 2 * self._factor > self._growth:
            return False
        measured: list[ProcessorLoad | None] = []
        self._load.measure(measured.append)
        self._session.wait_for(lambda: measured, time.monotonic() + MEASURE_S, lambda: missing)
        load = measured[0]
        if load is None or not load.busy:
            return False
        self._factor *= 2
        self._narrator.say(
            f"{missing}; the computer is busy ({load.text()}): all limits are {self._factor:g} times as long now"
        )
        return True

    def connect(self) -> None:
        """Wait for the driver, and longer for a board that is still connecting."""
        session = self._session
        text = self.wait(lambda: session.latest(DRIVER), "no gantry/driver_state: is the driver running?")
        self._narrator.say(f"driver: {text}")
        self._patiently(session.wait_until_heard)
        try:
            self._patiently(
                lambda until: session.wait_for(
                    lambda: state_name(session.latest(DRIVER)) not in ("disconnected", "connecting", "homing"),
                    until,
                    lambda: f"the driver is {session.latest(DRIVER)!r}",
                ),
                CONNECT_S,
            )
        except TimedOut as error:
            raise PreparationFailed(str(error)) from error
        text = session.latest(DRIVER)
        if state_name(text) in _BROKEN:
            raise PreparationFailed(f"the driver is {text!r}{self._advice(text)}")

    def _advice(self, text: str) -> str:
        """Return how to leave a driver's state, as the end of a sentence; empty if the state's reason includes it."""
        session, state = self._session, state_name(text)
        if state in ("stopped", "alarm"):
            return "; look at the machine, then call gantry/reset"
        if state != "mismatch":
            return ""
        with contextlib.suppress(TimedOut):  # the driver reports the code with the text, and again every second
            until = time.monotonic() + CODE_S
            session.wait_for(lambda: session.code_of(DRIVER, text) is not None, until, lambda: "no code")
        return _ADVICE.get(session.code_of(DRIVER, text) or "", "")

    def wait(self, condition: Callable[[], Any], missing: str | Callable[[], str]) -> Any:
        """Wait for a condition until the deadline of the whole preparation."""
        say_missing = missing if callable(missing) else lambda: missing
        return self._patiently(lambda until: self._session.wait_for(condition, until, say_missing))

    def call(self, service_type: Any, name: str, request: Any, *, patience_s: float = 0.0) -> None:
        """Call a service, and repeat the call while it is rejected, within limits; the last rejection is a failure."""
        session = self._session
        client = session.node.create_client(service_type, name)
        self.wait(client.service_is_ready, f"service {name} is not offered")
        began = time.monotonic()
        refusal = ""
        while True:
            self._seen_before_call = {topic: len(texts) for topic, texts in session.states.items()}
            self._publishers_before_call = {topic: session.publishers(topic) for topic in session.states}
            future = client.call_async(request)
            self.wait(future.done, f"service {name} does not answer")
            answer = future.result()
            if answer.success:
                break
            again = time.monotonic() + RETRY_S
            late = again > min(began + patience_s * self._factor, self._until)
            if late and not (patience_s and self._grow(f"{name} is refused so far: {answer_of(answer.message)}")):
                raise PreparationFailed(f"{name} was refused: {answer_of(answer.message)}")
            if answer_of(answer.message) != refusal:
                refusal = answer_of(answer.message)
                self._narrator.say(f"{name} is refused so far: {refusal}")
            self._pause_until(again)
        session.node.destroy_client(client)
        self._narrator.say(f"{name}: {answer_of(answer.message) or 'accepted'}")

    def _pause_until(self, when: float) -> None:
        self.wait(lambda: time.monotonic() > when, "out of time")

    def follow(self, topic: str, what: str, *, done: Callable[[str], bool], failed: tuple[str, ...]) -> None:
        """Print the states on a topic after the last call, until they show success or failure."""
        texts = self._session.states[topic]
        shown = self._seen_before_call.get(topic, 0)
        asked = self._publishers_before_call.get(topic) or self._session.publishers(topic)

        def ended() -> bool:
            nonlocal shown
            if self._session.publishers(topic) - asked:  # the state of a restarted program is not that of this step
                raise PreparationFailed(f"{what} did not end: its program has restarted")
            for text in texts[shown:]:
                shown += 1
                self._narrator.state(what, text)
                if state_name(text) in failed:
                    raise PreparationFailed(f"{what}: {text}{self._advice(text)}")
                if done(text):
                    return True
            return False

        missing = lambda: f"{what} has not ended: {self._session.latest(topic)!r}"  # noqa: E731
        self._patiently(lambda until: self._session.wait_for_answer(ended, topic, lambda: "", until, missing))

    def wait_ready(self) -> None:
        """Wait for the controller, printing each of its states."""
        session = self._session
        last = ""

        def ready() -> bool:
            nonlocal last
            text = session.latest(CONTROLLER)
            if text != last:
                last = text
                self._narrator.say(f"controller: {text}")
            if state_name(text) in ("stopped", "alarm"):
                raise PreparationFailed(f"the controller is {text!r}")
            return text == "ready"

        missing = lambda: f"the controller is {session.latest(CONTROLLER)!r}, not ready"  # noqa: E731
        self._patiently(lambda until: session.wait_for(ready, until, missing))


@ends_quietly
def main(arguments: Sequence[str] | None = None) -> int:
    arguments = list(sys.argv if arguments is None else arguments)
    parser = argparse.ArgumentParser(
        prog="gantry_prepare",
        description="Enable and home the machine, run the hand-eye calibration when there is none, wait until ready.",
    )
    parser.add_argument("--home", action="store_true", help="home even if the machine is homed")
    parser.add_argument("--calibrate", action="store_true", help="calibrate even if a calibration is loaded")
    parser.add_argument(
        "--timeout",
        type=number,
        metavar="S",
        help=f"whole time allowed (default {TIMEOUT_S:g}, on a busy computer up to {GROWTH:g} times as long)",
    )
    parser.add_argument("--json", action="store_true", help="print progress as JSON, one object a line, for programs")
    given = parser.parse_args(own_arguments(arguments))
    if given.timeout is not None and not given.timeout > 0:
        parser.error(f"--timeout {given.timeout:g}: above 0 is needed")
    with operator_session("gantry_prepare", arguments) as session:
        narrator = Narrator(json=given.json)
        try:
            limits = (TIMEOUT_S, GROWTH) if given.timeout is None else (given.timeout, 1.0)
            prepare(
                session,
                home=given.home,
                calibrate=given.calibrate,
                timeout_s=limits[0],
                growth=limits[1],
                narrator=narrator,
            )
        except PreparationFailed as error:
            narrator.fail(PreparationCause.REFUSED, str(error))
            return FAILED
        except TimedOut as error:
            load = measure_processor_load()
            narrator.fail(PreparationCause.TIMED_OUT, f"{error}; {load.text()}" if load.busy else str(error))
            return TIMED_OUT
        except Interrupted:
            narrator.fail(PreparationCause.INTERRUPTED, "interrupted: stopping")
            session.stop()
            return FAILED
        return REACHED


if __name__ == "__main__":
    raise SystemExit(main())
