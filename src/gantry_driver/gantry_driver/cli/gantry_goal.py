"""Send one goal from the command line, send the operator's heartbeat, and wait for the answer.

Exit codes: 0 reached, 1 rejected or aborted, 2 wrong usage, 3 no answer in time.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from geometry_msgs.msg import PointStamped
from std_msgs.msg import String

from gantry_driver.cli.operator_session import (
    FAILED,
    REACHED,
    TIMED_OUT,
    Interrupted,
    OperatorSession,
    TimedOut,
    complain,
    number,
    operator_session,
    say,
    with_negatives,
)
from gantry_driver.core.job.goal_job import WORKING
from icu_common.adapters.processes.program_end import ends_quietly
from icu_common.core.geometry.frames import BASE, CAMERA_LEFT, PANEL
from icu_common.core.goals.results import EFFECT, EFFECT_MISSING, EffectMissing, GoalResult, Outcome
from icu_common.core.panel.gesture import Gesture, GestureError, Point, parse_gesture
from icu_common.core.processes.delays import ResultCode
from icu_common.nodes import qos
from icu_common.nodes.messages.heads import header
from icu_common.nodes.messages.places import point_message
from icu_common.nodes.runtime import own_arguments

STOP_ANSWER_S = 3.0
STALE_TRIES = 3
"""Maximum number of tries for a goal that the controller rejects because it arrived too late."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GoalRequest:
    """Request in the arguments: a move in base_link (``xyz`` in metres), or a gesture."""

    xyz: tuple[float, float, float] | None = None
    gesture: Gesture | None = None
    timeout_s: float = 60.0


def parse(arguments: Sequence[str]) -> GoalRequest:
    """Read the arguments.

    Raises
    ------
    SystemExit
        With code 2 and the usage for wrong arguments, as argparse does.
    """
    parser = argparse.ArgumentParser(
        prog="gantry_goal",
        description="Send the stylus to a point or a control and wait for the answer. "
        "Without --press a point in base_link is a move; everything else is looked at, touched and left again.",
    )
    parser.add_argument("point", nargs="*", type=number, metavar="X Y", help="metres, or pixels in a camera's frame")
    parser.add_argument("--control", metavar="NAME", help="a control's name, for example RUN_STOP")
    parser.add_argument("--frame", choices=(BASE, PANEL, CAMERA_LEFT), help=f"frame of X Y (default {BASE})")
    parser.add_argument("--z", type=number, metavar="Z", help="height in base_link to lower the tip to, 0 or below")
    parser.add_argument("--press", action="store_true", help="touch and lift (always with --control and other frames)")
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--long", action="store_true", help="press for long")
    how.add_argument("--double", action="store_true", help="press twice, quickly")
    how.add_argument("--hold", type=number, metavar="S", help="stay in contact for S seconds")
    how.add_argument("--turn", type=number, metavar="DEG", help="turn a knob, counter-clockwise positive")
    how.add_argument("--click", type=number, metavar="N", help="turn a knob by N clicks, clockwise positive")
    how.add_argument(
        "--set", type=str.strip, metavar="MARK", help="turn a knob to a mark or to degrees, looking and correcting"
    )
    how.add_argument(
        "--drag-to", nargs=2, type=number, metavar=("X", "Y"), help="draw on to that point, in the frame of the first"
    )
    parser.add_argument("--timeout", type=number, default=60.0, metavar="S", help="whole time allowed (default 60)")
    given = parser.parse_args(with_negatives(arguments))

    if (given.control is None) == (not given.point) or len(given.point) not in (0, 2):
        parser.error("give either X Y or --control NAME")
    if given.control is not None and not given.control.replace("_", "").isalnum():
        parser.error(f"--control {given.control!r}; expected a name of letters, digits and '_'")
    if given.control is not None and given.frame is not None:
        parser.error("--frame belongs to X Y")
    if given.set is not None and len(given.set.split()) != 1:
        parser.error(f"--set {given.set!r}: a mark's name or degrees are needed, without blanks")
    if not given.timeout > 0:
        parser.error(f"--timeout {given.timeout:g}; expected above 0")
    kind, extra = _gesture(given)
    touch = given.press or kind != "press" or given.control is not None or given.frame in (PANEL, CAMERA_LEFT)
    if given.z is not None and given.z > 0:
        parser.error(f"--z {given.z:g}: 0 or below is needed, above it the stylus is retracted")
    if given.z is not None and touch:
        parser.error("--z belongs to a move in base_link; a touch finds the surface itself")
    if not touch:
        x, y = given.point
        return GoalRequest(xyz=(x, y, given.z or 0.0), timeout_s=given.timeout)
    target = given.control or Point(x=given.point[0], y=given.point[1], frame=given.frame or BASE)
    identifier = f"cli-{os.getpid()}-{time.time_ns()}"
    place = target if isinstance(target, str) else f"{target.x!r},{target.y!r}@{target.frame}"
    try:
        gesture = parse_gesture(f"{kind}:{place}{extra} id={identifier}")
    except GestureError as error:
        parser.error(str(error))
    return GoalRequest(gesture=gesture, timeout_s=given.timeout)


def _gesture(given: argparse.Namespace) -> tuple[str, str]:
    """Return the gesture's name, and its argument in the form of the grammar."""
    if given.drag_to is not None:
        x, y = given.drag_to
        return "drag", f":{x!r},{y!r}@{given.frame or (PANEL if given.control else BASE)}"
    for kind in ("hold", "turn", "click", "set"):
        value = getattr(given, kind)
        if value is not None:
            return kind, f":{value}"
    return ("long" if given.long else "double" if given.double else "press"), ""


def carry_out(session: OperatorSession, request: GoalRequest) -> int:
    """Publish the goal and wait for its final answer."""
    until = time.monotonic() + request.timeout_s
    node = session.node
    points = node.create_publisher(PointStamped, "gantry/goal", qos.COMMAND)
    commands = node.create_publisher(String, "gantry/command", qos.COMMAND)
    publisher = points if request.gesture is None else commands
    goal_id, stamp = "", 0
    try:
        session.wait_until_taken(publisher, "gantry/result", until)
        for count in range(1, STALE_TRIES + 1):
            if request.gesture is None:
                assert request.xyz is not None
                # The stamp is the goal's name, and simulated time may be paused between two tries.
                stamp = max(stamp + 1, session.now_ns())
                goal_id = str(stamp)
                points.publish(point_message(request.xyz, header(stamp, BASE)))
            else:
                # An answer to an earlier try must not count as one to this try.
                gesture = replace(request.gesture, id=request.gesture.id + (f"-{count}" if count > 1 else ""))
                goal_id = gesture.id
                commands.publish(String(data=gesture.text()))
            result = _follow(session, goal_id, until)
            stale = result.outcome is Outcome.REJECTED and result.code == ResultCode.STALE
            if not stale or count == STALE_TRIES:
                break
            say(f"the goal arrived too late; sending it again, try {count + 1} of {STALE_TRIES}")
        code = REACHED if result.outcome is Outcome.REACHED else FAILED
        if code == REACHED and request.xyz is not None and request.xyz[2] < 0:
            say("the stylus is down: without an operator the driver now stops and lifts it, then needs gantry/reset")
        return code
    except TimedOut as error:
        complain(str(error))
        if goal_id:
            # A program that abandons a goal must not leave it running without an operator.
            session.stop()
        return TIMED_OUT
    except Interrupted:
        return _stop(session, goal_id)


def _follow(session: OperatorSession, goal_id: str, until: float, *, stopping: bool = False) -> GoalResult:
    shown = 0

    def final() -> GoalResult | None:
        nonlocal shown
        mine = [result for result in session.results if result.goal_id == goal_id]
        for result in mine[shown:]:
            if result.outcome.final or not stopping:  # "accepted" now would look as if the stop had been too late
                say(describe(result))
        shown = len(mine)
        return mine[-1] if mine and mine[-1].outcome.final else None

    def resting() -> str:
        state = session.latest("gantry/state")
        return "" if state in WORKING else f"the controller has been {state!r}"

    result: GoalResult = session.wait_for_answer(
        final,
        "gantry/result",
        resting,
        until,
        lambda: f"no final answer; the controller was last {session.latest('gantry/state')!r}",
    )
    return result


def _stop(session: OperatorSession, goal_id: str) -> int:
    if not goal_id:
        say("interrupted before the goal was sent")
        return FAILED
    say("interrupted: stopping")
    session.stop()
    session.interrupted = False
    try:
        _follow(session, goal_id, time.monotonic() + STOP_ANSWER_S, stopping=True)
    except (TimedOut, Interrupted):
        say("stop was requested; no answer from the controller")
    return FAILED


def describe(result: GoalResult) -> str:
    """Return one line for people."""
    if result.outcome is not Outcome.REACHED:
        reason = f": {result.reason}" if result.reason else f": {result.goal}"
        return f"{result.outcome.value}{_felt(result)}{reason}"
    details = dict(result.details)
    by = details.get("measured_by", "")
    effect = details.get(EFFECT, "")
    seen = f", {effect}" if effect and details.get(EFFECT_MISSING) != EffectMissing.NOT_LOOKED_FOR else ""
    error = "not measured" if math.isnan(result.error_m) else f"{1000 * result.error_m:.3f} mm (by {by})"
    noted = f"; {result.reason}" if result.reason else ""
    return f"reached{_felt(result)}: {result.goal}, error {error}{seen}, {result.duration_s:.1f} s{noted}"


def _felt(result: GoalResult) -> str:
    """Return whether the touch was felt, as text for people; empty without a touch."""
    return "" if result.touch is None else f" ({result.touch.value.replace('_', ' ')})"


@ends_quietly
def main(arguments: Sequence[str] | None = None) -> int:
    arguments = list(sys.argv if arguments is None else arguments)
    request = parse(own_arguments(arguments))
    with operator_session("gantry_goal", arguments) as session:
        return carry_out(session, request)


if __name__ == "__main__":
    raise SystemExit(main())
