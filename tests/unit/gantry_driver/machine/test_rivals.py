"""Two sources of one topic stop controller and driver, which name both; a heartbeat's age is that of its stamp."""

from __future__ import annotations

import pytest
from unit.gantry_driver.controller_bench import BASE_FROM_PANEL, CAMERA_FROM_PANEL, Bench
from unit.gantry_driver.protocol_board import HOMED, Rig

from gantry_driver.core.grbl.trajectory_gcode import Waypoint
from gantry_driver.core.job import controller_messages as msg
from gantry_driver.core.job.goal_job import GoalPhase
from icu_common.core.geometry.frames import JOINTS
from icu_common.core.goals.results import Outcome

POSE = "two programs publish panel/pose: /foreign and /panel/recognition"
WAY = "two programs publish gantry/trajectory: /foreign and /gantry/gantry_controller"
RUN_STOP = BASE_FROM_PANEL.apply([0.208, 0.127, 0.003])


@pytest.mark.parametrize(
    "phase", [GoalPhase.APPROACH, GoalPhase.LOOK, GoalPhase.TOUCH, GoalPhase.CONTACT, GoalPhase.LIFT]
)
def test_second_source_ends_a_press_by_a_stop_that_names_both(phase: GoalPhase) -> None:
    bench = Bench().start()
    bench.on_phase[phase] = lambda b: b.tell(msg.Rivals(topic="panel/pose", text=POSE))
    result = bench.do("press:RUN_STOP")
    assert result.outcome is Outcome.ABORTED and f"{POSE}; the controller has ordered a stop" in result.reason
    assert bench.stops == 1 and bench.controller.state == f"stopped: {POSE}"


def test_second_source_stops_a_machine_at_rest_and_one_act_of_a_person_lets_it_go_on() -> None:
    bench = Bench().start()
    bench.tell(msg.Rivals(topic="panel/pose", text=POSE))
    assert bench.stops == 1 and bench.controller.state == f"stopped: {POSE}"
    refused = bench.do("press:RUN_STOP")
    assert refused.outcome is Outcome.REJECTED and refused.reason == POSE
    bench._say_driver("idle")  # a reset does not help while the second one is there
    assert bench.do("press:RUN_STOP").reason == POSE
    bench._say_driver("stopped: stop requested")
    bench.tell(msg.Rivals(topic="panel/pose", text=""))
    assert bench.controller.state == f"stopped: stop requested; {POSE}"
    assert bench.do("press:RUN_STOP").outcome is Outcome.REJECTED, "nobody has reset the stop"
    bench._say_driver("idle")
    assert bench.controller.state == "ready"
    assert bench.do("press:RUN_STOP").outcome is Outcome.REACHED
    assert bench.stops == 1


def test_all_topics_with_two_sources_are_named_and_each_must_be_alone_again() -> None:
    bench = Bench().start()
    bench.tell(msg.Rivals(topic="panel/pose", text=POSE))
    bench.tell(msg.Rivals(topic="joint_states", text="two programs publish joint_states: /a and /b"))
    assert bench.controller.state == f"stopped: {POSE}; two programs publish joint_states: /a and /b"
    bench.tell(msg.Rivals(topic="panel/pose", text=""))
    bench._say_driver("idle")
    assert bench.controller.state == "stopped: two programs publish joint_states: /a and /b"


def test_no_motion_is_planned_by_a_pose_that_two_programs_publish() -> None:
    bench = Bench().start()
    bench.tell(msg.Rivals(topic="panel/pose", text=POSE))
    bench.tell(msg.PanelPose(camera_from_panel=CAMERA_FROM_PANEL, stamp_ns=bench.now_ns))
    bench.do("press:RUN_STOP")
    bench.go(*RUN_STOP[:2])
    assert bench.paths == []


def test_heartbeat_of_1970_does_not_count() -> None:
    bench = Bench()
    bench.talking -= {"heartbeat"}
    bench.start()
    bench.tell(msg.OperatorHeartbeat(age_ns=bench.now_ns - 1_000_000_000))
    bench.run(0.1)
    assert bench.controller.state == "waiting: no operator (heartbeat)"
    assert bench.do("press:RUN_STOP").outcome is Outcome.REJECTED and bench.paths == []


def test_old_heartbeat_does_not_make_a_young_one_old() -> None:
    bench = Bench().start()
    bench.tell(msg.OperatorHeartbeat())
    bench.tell(msg.OperatorHeartbeat(age_ns=10**18))
    assert bench.controller.state == "ready"


def test_driver_holds_and_lifts_when_a_second_program_publishes_trajectories() -> None:
    rig = Rig().homed()
    rig.go((0.1, 0.1, 0.03), (0.2, 0.1, 0.03))
    rig.until(lambda: rig.board.mpos[2] < -30.9)
    rig.machine.rivals("trajectory", WAY, rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.results[-1].reason == WAY and rig.states[-1] == f"stopped: {WAY}"
    assert rig.board.mpos[2] == HOMED[2], "the stylus is up"
    assert rig.machine.reset(rig.now) == ""
    assert rig.go((0.1, 0.1, 0.0)).reason == WAY == rig.machine.home(rig.now)
    rig.machine.rivals("trajectory", "", rig.now)
    rig.go((0.1, 0.1, 0.0))
    rig.until(lambda: "reached" in rig.outcomes())


@pytest.mark.parametrize("phase", ["HOLDING", "LIFTING", "STOPPED"])
def test_conflict_during_another_stop_is_named_until_it_ends(phase: str) -> None:
    rig = Rig().homed()
    rig.go((0.1, 0.1, 0.03), (0.2, 0.1, 0.03))
    rig.until(lambda: rig.board.mpos[2] < -30.9)
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == phase)
    rig.machine.rivals("trajectory", WAY, rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.states[-1] == f"stopped: stop requested; {WAY}"
    rig.machine.rivals("trajectory", "", rig.now)
    rig.run_for(0.1)
    assert rig.states[-1] == "stopped: stop requested"


def test_driver_follows_no_trajectory_that_it_distrusts() -> None:
    rig = Rig().homed()
    way = [Waypoint(positions_m=(0.1, 0.05, 0.06))]
    answer = rig.machine.run("foreign", JOINTS, way, age_s=0.0, now=rig.now, distrust="from /foreign")
    assert answer.outcome is Outcome.REJECTED and answer.reason == "from /foreign"
    rig.run_for(1.0)
    assert rig.board.mpos == list(HOMED) and rig.state == "idle"
