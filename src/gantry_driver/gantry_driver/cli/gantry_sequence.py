"""Run gestures one after the other, check each before the next, and send the operator's heartbeat meanwhile.

    gantry_sequence press:AUTO_SET "click:CH1_SCALE:2 => screen" "press:RUN_STOP => lamp:RUN_STOP=red"
    gantry_sequence --file capture.yaml

Exit codes: 0 all done, 1 rejected or a step failed, 2 wrong usage, 3 no answer in time.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from collections.abc import Sequence

import yaml
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
)
from icu_common.adapters.processes.program_end import ends_quietly
from icu_common.core.configuration.option_bounds import named_path
from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.goals.sequence import SequenceError, parse_file, parse_steps
from icu_common.nodes import qos
from icu_common.nodes.runtime import own_arguments

LAST_STEP_S = 1.0
"""Maximum seconds for the answer of the last step to arrive after that of the whole sequence."""


def parse(arguments: Sequence[str]) -> tuple[str, float]:
    """Return the sequence's text and the seconds allowed; argparse ends the program on wrong usage."""
    parser = argparse.ArgumentParser(
        prog="gantry_sequence", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("steps", nargs="*", metavar="STEP", help="gesture:target[:argument][ => checks]")
    parser.add_argument("--file", type=named_path, help="YAML file with steps")
    parser.add_argument("--timeout", type=number, default=600.0, metavar="S", help="whole time (default: %(default)s)")
    given = parser.parse_args(arguments)
    if (given.file is None) == (not given.steps):
        parser.error("give either steps or --file")
    if not given.timeout > 0:
        parser.error(f"--timeout {given.timeout:g}; expected above 0")
    try:
        if given.file is None:
            parse_steps(given.steps)
            return yaml.safe_dump({"steps": given.steps}, width=10**6), given.timeout
        text = given.file.read_text(encoding="utf-8")
        parse_file(text, str(given.file))
    except UnicodeDecodeError as error:
        parser.error(f"{given.file} is no text: {error}")
    except (OSError, SequenceError) as error:
        parser.error(str(error))
    return text, given.timeout


def carry_out(session: OperatorSession, text: str, timeout_s: float) -> int:
    """Publish the sequence, follow its steps, and return the exit code."""
    until = time.monotonic() + timeout_s
    run_id = f"cli-{os.getpid()}-{time.time_ns() % 10**9}"
    answers = session.hear("gantry/sequence_result")
    session.watch("gantry/sequence_state")
    publisher = session.node.create_publisher(String, "gantry/sequence", qos.COMMAND)
    sent = False
    heard = done = 0
    told_by = math.inf

    def final() -> GoalResult | None:
        nonlocal heard, done, told_by
        for step in [r for r in session.results if r.goal_id.startswith(run_id + ".")][heard:]:
            heard += 1
            if step.outcome.final:
                done += step.outcome is Outcome.REACHED
                effect = dict(step.details).get("effect", "")
                say(f"{step.outcome.value}: {step.goal.partition(' id=')[0]} {step.reason or effect}".rstrip())
        answer = next((r for r in answers if r.goal_id == run_id and r.outcome.final), None)
        if answer is None:
            return None
        # Another node answers the steps: the last such answer may arrive after that of the whole sequence.
        told_by = min(told_by, time.monotonic() + LAST_STEP_S)
        told = dict(answer.details).get("steps_done", "")
        missing = told.isdecimal() and done < int(told)
        return None if missing and time.monotonic() < told_by else answer

    def resting() -> str:
        return "the sequencer has been idle" if session.latest("gantry/sequence_state") == "idle" else ""

    try:
        session.wait_until_taken(publisher, "gantry/sequence_result", until)
        publisher.publish(String(data=f"id: {run_id}\n{text}"))
        sent = True
        result = session.wait_for_answer(
            final, "gantry/sequence_result", resting, until, lambda: "the sequence has not ended"
        )
    except TimedOut as error:
        complain(str(error))
        if sent:
            session.stop()
        return TIMED_OUT
    except Interrupted:
        say("interrupted: stopping" if sent else "interrupted before the sequence was sent")
        if sent:
            session.stop()
        return FAILED
    if result.outcome is Outcome.REACHED:
        say(f"done: {result.goal}, {result.duration_s:.1f} s")
        return REACHED
    complain(f"{result.outcome.value}: {result.reason}")
    return FAILED


@ends_quietly
def main(arguments: Sequence[str] | None = None) -> int:
    arguments = list(sys.argv if arguments is None else arguments)
    text, timeout_s = parse(own_arguments(arguments))
    with operator_session("gantry_sequence", arguments) as session:
        return carry_out(session, text, timeout_s)


if __name__ == "__main__":
    raise SystemExit(main())
