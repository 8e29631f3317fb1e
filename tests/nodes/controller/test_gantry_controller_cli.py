"""gantry_goal and gantry_prepare as a person starts them: processes with arguments, output and exit codes."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped
from nodes.gantry_bench import PRESSED, GantryBench
from std_msgs.msg import Header, String
from std_srvs.srv import SetBool, Trigger

from gantry_driver.cli import gantry_goal, gantry_sequence
from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.processes import preparation
from icu_common.core.processes.delays import Delay, ResultCode
from icu_common.nodes import qos
from icu_common.nodes.messages.heads import stamp_ns
from icu_common.nodes.messages.results import result_message

pytestmark = pytest.mark.long


class Program:
    """A command-line program in the ROS domain of the test's own nodes."""

    def __init__(self, ros: Any, module: str, *arguments: str, changed: str = "") -> None:
        self.ros = ros
        start = ["-m", f"gantry_driver.cli.{module}"]
        if changed:
            start = [
                "-c",
                f"from gantry_driver.cli import {module} as program; program.{changed}; exit(program.main())",
            ]
        environment = {**os.environ, "ROS_DOMAIN_ID": str(ros.context.get_domain_id())}
        self.process = subprocess.Popen(
            [sys.executable, *start, *arguments],
            env=environment,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )

    def end(self, within_s: float = 40.0) -> tuple[int, str]:
        """Spin the test's nodes until the program ends; return its exit code and output."""
        try:
            self.ros.spin_until(lambda: self.process.poll() is not None, within_s)
        finally:
            self.process.kill()
            output, _ = self.process.communicate()
        return self.process.returncode, output


@pytest.fixture
def bench(ros: Any) -> GantryBench:
    """The operator is the program under test, so the bench sends no heartbeat."""
    bench = GantryBench(ros, heartbeat=False)
    bench.node.destroy_publisher(bench.beat)
    bench.see()
    return bench


def test_press_a_control(ros: Any, bench: GantryBench) -> None:
    code, output = Program(ros, "gantry_goal", "--control", "RUN_STOP").end()
    assert code == 0, output
    assert re.search(r"^accepted: press:RUN_STOP id=cli-\d+-\d+$", output, re.MULTILINE), output
    assert re.search(r"^reached \(touched\): .*, error 0\.000 mm \(by cameras\), \d+\.\d s$", output, re.MULTILINE), (
        output
    )
    np.testing.assert_allclose(bench.trajectories[1].points[-1].positions, PRESSED, atol=1e-7)
    assert len(bench.trajectories) == 3, "above it, down, and up"


def test_move_to_a_point_and_press_a_point(ros: Any, bench: GantryBench) -> None:
    code, output = Program(ros, "gantry_goal", "0.10", "0.05", "--z", "-0.005").end()
    assert code == 0 and "error 0.000 mm (by readings)" in output, output
    np.testing.assert_allclose(bench.trajectories[0].points[-1].positions, [0.10, 0.05, 0.005], atol=1e-9)
    code, output = Program(ros, "gantry_goal", "0.05", "0.05", "--press").end()
    assert code == 0 and "error 0.000 mm (by cameras)" in output, output
    np.testing.assert_allclose(bench.trajectories[2].points[-1].positions, [0.05, 0.05, 0.034], atol=1e-7)


def test_rejected(ros: Any, bench: GantryBench) -> None:
    code, output = Program(ros, "gantry_goal", "0.9", "0.05").end()
    assert code == 1 and "rejected: move to (0.9, 0.05, 0) m in base_link: gantry_x_joint = 0.9000 m" in output, output
    assert "lies outside 0.0000 to 0.3590 m" in output
    assert bench.trajectories == []


class RejectingController:
    """Answers the first goals as stale, and then with ``reached``."""

    def __init__(self, ros: Any, stale: int) -> None:
        node = ros.plain("controller")
        self.stamps: list[int] = []
        self._stale = stale
        self._result = node.create_publisher(DiagnosticArray, "/gantry/result", qos.RESULTS)
        node.create_publisher(String, "/gantry/driver_state", qos.LATCHED)
        node.create_subscription(Header, "/operator/heartbeat", lambda message: None, qos.SENSOR)
        node.create_subscription(PointStamped, "/gantry/goal", self._on_goal, qos.COMMAND)
        self._state = node.create_publisher(String, "/gantry/state", qos.LATCHED)
        self._state.publish(String(data="ready"))

    def _on_goal(self, message: PointStamped) -> None:
        self.stamps.append(stamp_ns(message.header.stamp))
        goal = GoalResult(goal_id=str(self.stamps[-1]), goal="move", outcome=Outcome.REACHED, duration_s=1.0)
        if len(self.stamps) <= self._stale:
            late = Delay(code=ResultCode.STALE, what="goal", measured_s=0.7, limit_s=0.5)
            goal = replace(goal, outcome=Outcome.REJECTED, reason="stale", code=late.code.value, details=late.details())
        self._result.publish(result_message(goal, self.stamps[-1]))


@pytest.mark.parametrize(("stale", "sent", "code"), [(0, 1, 0), (2, 3, 0), (3, 3, 1)])
def test_a_goal_that_arrives_too_late_is_sent_again(ros: Any, stale: int, sent: int, code: int) -> None:
    controller = RejectingController(ros, stale)
    ended, output = Program(ros, "gantry_goal", "0.10", "0.05").end()
    assert ended == code, output
    assert len(controller.stamps) == len(set(controller.stamps)) == sent
    again = [f"the goal arrived too late; sending it again, try {n} of 3" for n in range(2, sent + 1)]
    assert [line for line in output.splitlines() if "too late" in line] == again


def test_nobody_there(ros: Any) -> None:
    code, output = Program(ros, "gantry_goal", "0.1", "0.05", "--timeout", "1.5").end()
    assert code == 3 and "error: nobody takes /gantry/goal" in output, output


def test_an_answer_that_cannot_be_read_does_not_end_gantry_sequence(ros: Any, bench: GantryBench) -> None:
    probe = ros.plain()
    sequences = ros.collect(probe, String, "/gantry/sequence", qos.COMMAND)
    answer = probe.create_publisher(DiagnosticArray, "/gantry/sequence_result", qos.RESULTS)
    program = Program(ros, "gantry_sequence", "press:RUN_STOP")
    ros.spin_until(lambda: sequences and answer.get_subscription_count(), 30.0)
    run_id = yaml.safe_load(sequences[0].data)["id"]
    answer.publish(DiagnosticArray())
    odd = GoalResult(goal_id=run_id, goal="1 step", outcome=Outcome.REACHED, details=(("steps_done", "many"),))
    answer.publish(result_message(odd, 0))
    code, output = program.end()
    assert code == 0 and "Traceback" not in output, output
    assert "gantry/sequence_result: not the answer to a goal" in output and "done: 1 step" in output, output


def test_each_step_of_a_sequence_is_told_although_the_whole_is_answered_first(ros: Any, bench: GantryBench) -> None:
    probe = ros.plain()
    sequences = ros.collect(probe, String, "/gantry/sequence", qos.COMMAND)
    steps = probe.create_publisher(DiagnosticArray, "/gantry/result", qos.RESULTS)
    answer = probe.create_publisher(DiagnosticArray, "/gantry/sequence_result", qos.RESULTS)
    # It waits a second for the last step, which a busy machine may not report within that time.
    program = Program(ros, "gantry_sequence", "press:RUN_STOP", "press:CH1_IN", changed="LAST_STEP_S = 20.0")
    ros.spin_until(lambda: sequences and answer.get_subscription_count() and steps.get_subscription_count(), 30.0)
    run_id = yaml.safe_load(sequences[0].data)["id"]

    def tell(publisher: Any, goal_id: str, goal: str, *details: tuple[str, str]) -> None:
        result = GoalResult(goal_id=goal_id, goal=goal, outcome=Outcome.REACHED, duration_s=1.0, details=details)
        publisher.publish(result_message(result, probe.get_clock().now().nanoseconds))

    tell(steps, f"{run_id}.1", f"press:RUN_STOP id={run_id}.1", ("effect", "lamp red -> green"))
    tell(answer, run_id, "2 steps", ("steps_done", "2"))
    until = time.monotonic() + 0.2  # the answer of the whole has come by then
    ros.spin_until(lambda: time.monotonic() > until, 5.0)
    tell(steps, f"{run_id}.2", f"press:CH1_IN id={run_id}.2", ("effect", "screen changed"))
    code, output = program.end()
    assert code == 0, output
    assert output.splitlines() == [
        "reached: press:RUN_STOP lamp red -> green",
        "reached: press:CH1_IN screen changed",
        "done: 2 steps, 1.0 s",
    ]


def test_ctrl_c_stops_the_machine(ros: Any, bench: GantryBench) -> None:
    bench.obey = False
    program = Program(ros, "gantry_goal", "0.3", "0.2")
    ros.spin_until(lambda: bench.trajectories, 30.0)
    program.process.send_signal(signal.SIGINT)
    # The driver would answer a stop with its state; the program waits for the controller's answer to that.
    ros.spin_until(lambda: bench.stops, 10.0)
    bench.driver_state.publish(String(data="stopped: stop requested"))
    code, output = program.end()
    assert code == 1, output
    assert "interrupted: stopping" in output and "aborted: the driver is 'stopped: stop requested'" in output, output
    assert "accepted" not in output.partition("interrupted")[2], "told again, it reads as if the stop had been too late"


def test_an_answer_from_before_the_interrupt_that_comes_after_it_is_not_told(capsys: pytest.CaptureFixture) -> None:
    answer = GoalResult(goal_id="g", goal="press:RUN", outcome=Outcome.ACCEPTED)
    session: Any = SimpleNamespace(results=[], interrupted=True, latest=lambda topic: "touching")
    session.stop = lambda: session.results.extend([answer, replace(answer, outcome=Outcome.ABORTED, reason="stopped")])
    session.wait_for_answer = lambda final, *others: final()
    assert gantry_goal._stop(session, "g") == gantry_goal.FAILED
    assert capsys.readouterr().out.splitlines() == ["interrupted: stopping", "aborted: stopped"]


def test_a_controller_that_dies_with_the_goal_is_not_waited_for(ros: Any, bench: GantryBench) -> None:
    bench.obey = False
    program = Program(ros, "gantry_goal", "0.3", "0.2", "--timeout", "600")
    ros.spin_until(lambda: bench.trajectories, 30.0)
    ros.executor.remove_node(bench.controller)
    ros.nodes.remove(bench.controller)
    bench.controller.destroy_node()
    code, output = program.end()
    assert code == 3 and "error: who answers on /gantry/result has gone; no final answer" in output, output
    ros.spin_until(lambda: bench.stops, 10.0)


def test_a_sequencer_that_was_started_anew_is_not_waited_for(ros: Any, bench: GantryBench) -> None:
    probe = ros.plain()
    sequences = ros.collect(probe, String, "/gantry/sequence", qos.COMMAND)
    probe.create_publisher(DiagnosticArray, "/gantry/sequence_result", qos.RESULTS)
    state = probe.create_publisher(String, "/gantry/sequence_state", qos.LATCHED)
    program = Program(ros, "gantry_sequence", "press:RUN_STOP")
    ros.spin_until(lambda: sequences and state.get_subscription_count(), 30.0)
    state.publish(String(data="step 1/1: press:RUN_STOP"))
    state.publish(String(data="idle"))
    code, output = program.end()
    assert code == 3 and "error: the sequencer has been idle for 5 s without an answer" in output, output
    ros.spin_until(lambda: bench.stops, 10.0)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "give either X Y or --control NAME"),
        (["0.1"], "give either X Y or --control NAME"),
        (["0.1", "0.2", "0.3"], "give either X Y"),
        (["0.1", "nan"], "'nan' is not finite"),
        (["0.1", "a"], "invalid"),
        (["0.1", "0.1", "--control", "RUN_STOP"], "give either"),
        (["--control", "RUN_STOP", "--frame", "base_link"], "--frame belongs to X Y"),
        (["--control", "RUN STOP"], "'RUN STOP': a name of letters"),
        (["--control", "CH1_SCALE:90"], "'CH1_SCALE:90': a name of letters"),
        (["--control", "RUN_STOP", "--hold", "99"], "up to 30"),
        (["--control", "CH1_SCALE", "--turn", "0"], "not zero"),
        (["--control", "CH1_SCALE", "--turn", "30", "--hold", "1"], "not allowed with"),
        (["0.1", "0.1", "--z", "-0.01", "--press"], "--z belongs to a move"),
        (["0.1", "0.1", "--timeout", "0"], "above 0 is needed"),
    ],
)
def test_wrong_usage(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        gantry_goal.parse(arguments)
    assert ended.value.code == 2
    assert words in capsys.readouterr().err


def test_a_sequence_file_that_is_no_text_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.yaml").write_bytes(b"steps: [press:CAF\xc9]")
    with pytest.raises(SystemExit) as ended:
        gantry_sequence.parse(["--file", str(tmp_path / "bad.yaml")])
    assert ended.value.code == 2 and "bad.yaml is no text: 'utf-8' codec" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--control", "RUN_STOP"], "press:RUN_STOP"),
        (["--control", "MENU", "--hold", "2"], "hold:MENU:2.0"),
        (["--control", "CH1_SCALE", "--turn", "-30"], "turn:CH1_SCALE:-30.0"),
        (["0.1", "0.2", "--press"], "press:0.1,0.2@base_link"),
        (["0.1", "0.2", "--frame", "panel_link"], "press:0.1,0.2@panel_link"),
        (
            ["640", "360", "--frame", "camera_left_optical_frame", "--hold", "1"],
            "hold:640.0,360.0@camera_left_optical_frame:1.0",
        ),
    ],
)
def test_gestures(arguments: list[str], text: str) -> None:
    gesture = gantry_goal.parse(arguments).gesture
    assert gesture is not None and gesture.text().partition(" id=")[0] == text and gesture.id


def test_negative_coordinates_are_numbers() -> None:
    assert gantry_goal.parse(["-0.01", "0.2"]).xyz == (-0.01, 0.2, 0.0)


class Machine:
    """Driver and hand-eye as gantry_prepare sees them: services that answer at once, and latched states."""

    def __init__(
        self,
        bench: GantryBench,
        *,
        calibrated: bool,
        homed: bool = False,
        disabled: bool = False,
        calibration_fails: bool = False,
        calibration_states: tuple[str, ...] = (),
    ) -> None:
        self.bench = bench
        self.calls: list[str] = []
        last = "failed: 3 of 12 samples" if calibration_fails else "calibrated: sigma 0.1 mm"
        self.calibration_states = calibration_states or ("calibrating 1/12", last)
        self.refusals = self.home_refusals = 0
        self.disabled = disabled
        node = bench.node
        self.calibration = node.create_publisher(String, "/calibration/state", qos.LATCHED)
        self.calibration.publish(String(data="calibrated: from file" if calibrated else "uncalibrated"))
        bench.driver_state.publish(String(data="disabled" if disabled else "idle" if homed else "unhomed"))
        node.create_service(SetBool, "/gantry/enable", self._enable)
        node.create_service(Trigger, "/gantry/home", self._home)
        node.create_service(Trigger, "/calibration/run", self._calibrate)

    def _enable(self, request: Any, response: Any) -> Any:
        self.calls.append(f"enable {request.data}")
        if self.disabled:
            # As in the graph, where the state is another topic than the answer and may come later.
            self.bench.node.create_timer(0.3, lambda: self.bench.driver_state.publish(String(data="idle")))
        response.success, response.message = True, "enabled"
        return response

    def _home(self, request: Any, response: Any) -> Any:
        self.calls.append("home")
        if self.home_refusals:
            self.home_refusals -= 1
            response.success, response.message = False, "refused: no operator's heartbeat yet"
            return response
        for text in ("homing", "idle"):
            self.bench.driver_state.publish(String(data=text))
        response.success = True
        return response

    def _calibrate(self, request: Any, response: Any) -> Any:
        self.calls.append("calibrate")
        if self.refusals:
            self.refusals -= 1
            response.success, response.message = False, "no camera_info yet"
            return response
        for text in self.calibration_states:
            self.calibration.publish(String(data=text))
        response.success = True
        return response


def test_prepare_does_what_is_needed(ros: Any, bench: GantryBench) -> None:
    machine = Machine(bench, calibrated=False)
    code, output = Program(ros, "gantry_prepare", "--timeout", "30").end()
    assert code == 0, output
    assert machine.calls == ["enable True", "home", "calibrate"]
    for line in ("driver: unhomed", "homing: idle", "calibration: calibrated: sigma 0.1 mm", "controller: ready"):
        assert line in output, output


def test_prepare_reports_its_progress_for_programs(ros: Any, bench: GantryBench) -> None:
    Machine(bench, calibrated=False)
    code, output = Program(ros, "gantry_prepare", "--json", "--timeout", "30").end()
    assert code == 0, output
    reports = [preparation.from_line(line) for line in output.splitlines() if line.startswith("{")]
    stages = list(dict.fromkeys(report.stage for report in reports))
    assert stages == [
        stage for stage in preparation.PreparationStage if stage is not preparation.PreparationStage.FAILED
    ], output
    assert (1, 12) in [(report.done, report.total) for report in reports]


def test_prepare_reports_what_failed_for_programs(ros: Any, bench: GantryBench) -> None:
    Machine(bench, calibrated=False, homed=True, calibration_fails=True)
    code, output = Program(ros, "gantry_prepare", "--json", "--timeout", "30").end()
    assert code == 1, output
    last = preparation.from_line(output.splitlines()[-1])
    assert (
        last.stage is preparation.PreparationStage.FAILED and last.failed_at is preparation.PreparationStage.CALIBRATING
    )
    assert last.cause is preparation.PreparationCause.REFUSED and "3 of 12 samples" in last.text


def test_prepare_asks_for_homing_again_while_the_heartbeat_is_on_its_way(ros: Any, bench: GantryBench) -> None:
    machine = Machine(bench, calibrated=True)
    machine.home_refusals = 1
    code, output = Program(ros, "gantry_prepare", "--timeout", "30").end()
    assert code == 0 and machine.calls == ["enable True", "home", "home"], output
    assert "gantry/home is refused so far: refused: no operator's heartbeat yet" in output


def test_prepare_has_patience_with_cameras_that_start_slowly(ros: Any, bench: GantryBench) -> None:
    machine = Machine(bench, calibrated=False, homed=True)
    machine.refusals = 2
    code, output = Program(ros, "gantry_prepare", "--timeout", "30").end()
    assert code == 0 and machine.calls == ["enable True", "calibrate", "calibrate", "calibrate"], output
    assert output.count("calibration/run is refused so far: no camera_info yet") == 1


def test_prepare_lets_a_stored_calibration_be_checked(ros: Any, bench: GantryBench) -> None:
    machine = Machine(bench, calibrated=True, homed=True)
    machine.calibration.publish(String(data="uncalibrated: waiting for camera_info to check the calibration file"))
    program = Program(ros, "gantry_prepare", "--timeout", "30")
    ros.spin_until(lambda: machine.calls, 30.0)
    machine.calibration.publish(String(data="calibrated: from file"))
    code, output = program.end()
    assert code == 0 and machine.calls == ["enable True"], output


def test_prepare_leaves_alone_what_is_ready(ros: Any, bench: GantryBench) -> None:
    machine = Machine(bench, calibrated=True, homed=True)
    code, output = Program(ros, "gantry_prepare", "--timeout", "30").end()
    assert code == 0 and machine.calls == ["enable True"], output


def test_prepare_enables_a_homed_machine_without_homing_it_again(ros: Any, bench: GantryBench) -> None:
    machine = Machine(bench, calibrated=True, homed=True, disabled=True)
    code, output = Program(ros, "gantry_prepare", "--timeout", "30").end()
    assert code == 0 and machine.calls == ["enable True"], output
    assert "controller: waiting: not enabled" in output or "driver: disabled" in output, output


def test_prepare_does_it_again_when_asked(ros: Any, bench: GantryBench) -> None:
    machine = Machine(bench, calibrated=True, homed=True)
    code, output = Program(ros, "gantry_prepare", "--home", "--calibrate", "--timeout", "30").end()
    assert code == 0 and machine.calls == ["enable True", "home", "calibrate"], output


def test_prepare_reports_a_failed_calibration(ros: Any, bench: GantryBench) -> None:
    Machine(bench, calibrated=False, homed=True, calibration_fails=True)
    code, output = Program(ros, "gantry_prepare", "--timeout", "30").end()
    assert code == 1 and "error: calibration: failed: 3 of 12 samples" in output, output


def test_prepare_does_not_take_the_kept_calibration_for_a_new_one(ros: Any, bench: GantryBench) -> None:
    machine = Machine(bench, calibrated=True, homed=True, calibration_states=("calibrating 1/12",))
    program = Program(ros, "gantry_prepare", "--calibrate", "--timeout", "30")
    ros.spin_until(lambda: machine.calls == ["enable True", "calibrate"], 30.0)
    restarted = bench.node.create_publisher(String, "/calibration/state", qos.LATCHED)
    restarted.publish(String(data="calibrated: from file"))
    code, output = program.end()
    assert code == 1 and "error: calibration did not end: its program has restarted" in output, output


def test_prepare_does_not_wait_for_a_calibration_that_has_died(ros: Any, bench: GantryBench) -> None:
    machine = Machine(bench, calibrated=False, homed=True, calibration_states=("calibrating 1/12",))
    program = Program(ros, "gantry_prepare")
    ros.spin_until(lambda: machine.calls == ["enable True", "calibrate"], 30.0)
    bench.node.destroy_publisher(machine.calibration)
    code, output = program.end()
    assert code == 3 and "error: who answers on /calibration/state has gone; calibration has not ended" in output, (
        output
    )


def test_prepare_does_not_clear_an_alarm(ros: Any, bench: GantryBench) -> None:
    machine = Machine(bench, calibrated=True)
    bench.driver_state.publish(String(data="alarm: 1 hard limit"))
    code, output = Program(ros, "gantry_prepare", "--timeout", "30").end()
    assert code == 1 and "the driver is 'alarm: 1 hard limit'" in output, output
    assert machine.calls == []


def test_prepare_without_a_driver(ros: Any) -> None:
    code, output = Program(ros, "gantry_prepare", "--timeout", "1.5").end()
    assert code == 3 and "no gantry/driver_state" in output, output
