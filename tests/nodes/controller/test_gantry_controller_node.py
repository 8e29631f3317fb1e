"""The controller's node: topics in, topics out, with the names of the whole graph."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped
from nodes.gantry_bench import CAMERA, CAMERA_FROM_PANEL, PRESSED, RUN_STOP, GantryBench
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from std_msgs.msg import Float64MultiArray, Header, String

from icu_common.core.geometry.frames import BASE, CAMERA_LEFT, JOINTS
from icu_common.core.goals.results import Felt, Outcome
from icu_common.nodes.messages.heads import header
from icu_common.nodes.messages.places import point_array, point_message


def positions(bench: GantryBench) -> list[Any]:
    return [np.array([p.positions for p in t.points]) for t in bench.trajectories]


def test_move_before_calibration(ros: Any) -> None:
    bench = GantryBench(ros)
    bench.spin_until_state("waiting: not calibrated")
    bench.connect_goals()
    stamp = bench.now_ns()
    bench.goal.publish(point_message([0.12, 0.08, -0.01], header(stamp, BASE)))
    result = bench.spin_until_final()
    assert [r.outcome for r in bench.results] == [Outcome.ACCEPTED, Outcome.REACHED]
    assert {r.goal_id for r in bench.results} == {str(stamp)}
    assert result.error_m < 1e-9 and 0 < result.duration_s < 20
    (trajectory,) = bench.trajectories
    assert tuple(trajectory.joint_names) == JOINTS and trajectory.header.frame_id == "move/"
    np.testing.assert_allclose(
        positions(bench)[0], [[0.119, 0.079, 0.0], [0.12, 0.08, 0.0], [0.12, 0.08, 0.01]], atol=1e-12
    )
    times = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in trajectory.points]
    way = [np.hypot(0.119, 0.079) / 0.18, np.hypot(0.001, 0.001) / 0.18, 0.01 / 0.05]
    np.testing.assert_allclose(times, np.cumsum(way), atol=1e-6)
    ros.spin_until(lambda: bench.targets, 5.0)
    assert bench.targets[-1].header.frame_id == BASE
    np.testing.assert_allclose(point_array(bench.targets[-1]), [0.12, 0.08, -0.01])


def test_press_with_a_correction(ros: Any) -> None:
    bench = GantryBench(ros)
    bench.tip_error = np.array([0.0006, -0.0004, 0.0])
    bench.see()
    bench.spin_until_state("ready")
    bench.connect_goals()
    bench.command.publish(String(data="press:RUN_STOP id=a1"))
    result = bench.spin_until_final()
    assert [(r.goal_id, r.outcome) for r in bench.results] == [("a1", Outcome.ACCEPTED), ("a1", Outcome.REACHED)]
    x, y, z = RUN_STOP
    hover, touch = -(z + 0.010), PRESSED[2]
    approach, correction, down, up = positions(bench)
    np.testing.assert_allclose(approach[-1], [x, y, hover], atol=1e-7)
    np.testing.assert_allclose(correction[-1], [x - 0.0006, y + 0.0004, hover], atol=1e-7)
    np.testing.assert_allclose(down[-1], [x - 0.0006, y + 0.0004, touch], atol=1e-7)
    np.testing.assert_allclose(up, [[x - 0.0006, y + 0.0004, 0.0]], atol=1e-7)
    assert result.error_m < 1e-6 and dict(result.details)["control"] == "RUN_STOP"
    assert result.touch is Felt.TOUCHED
    bench.spin_until_state("ready")
    seen = [m.data for m in bench.states]
    assert {"moving", "looking", "touching", "ready"} <= set(seen)


def test_a_click_in_the_picture(ros: Any) -> None:
    bench = GantryBench(ros)
    bench.see()
    bench.spin_until_state("ready")
    bench.connect_goals()
    u, v = CAMERA.project(CAMERA_FROM_PANEL.apply([[0.210, 0.126, 0.003]]))[0]
    stamp = bench.now_ns()
    bench.goal.publish(point_message([u, v, 0.0], header(stamp, CAMERA_LEFT)))
    result = bench.spin_until_final()
    assert result.outcome is Outcome.REACHED and result.goal_id == str(stamp)
    np.testing.assert_allclose(positions(bench)[-1][-1], [0.230, 0.151, 0.0], atol=1e-7)


def test_bad_goals_are_answered_and_move_nothing(ros: Any) -> None:
    bench = GantryBench(ros)
    bench.see()
    bench.spin_until_state("ready")
    bench.connect_goals()
    bad: list[tuple[Any, str]] = [
        (PointStamped(header=header(0, "map")), "'map'"),
        (point_message([float("nan"), 0.0, 0.0], header(0, BASE)), "not finite"),
        (point_message([0.9, 0.0, 0.0], header(0, BASE)), "gantry_x_joint = 0.9000 m lies outside"),
        (point_message([0.1, 0.1, 0.0], header(bench.now_ns() - 9_000_000_000, BASE)), "stale"),
        (String(data="press:CH1_IN"), "connector"),
        (String(data="press:NOBODY"), "unknown control 'NOBODY'"),
        (String(data="squeeze:RUN_STOP"), "'squeeze'"),
        (String(data="x" * 500), "500 characters"),
    ]
    for count, (message, words) in enumerate(bad, 1):
        (bench.command if isinstance(message, String) else bench.goal).publish(message)
        result = bench.spin_until_final(count)
        assert result.outcome is Outcome.REJECTED and words in result.reason
    assert bench.trajectories == [] and bench.state == "ready"


def test_goals_that_come_at_once_are_each_answered_and_the_first_is_done(ros: Any) -> None:
    """The last of them was done, and the others vanished without a word, 27 of 40 on a busy computer."""
    bench = GantryBench(ros)
    bench.see()
    bench.spin_until_state("ready")
    bench.connect_goals()
    stamp = bench.now_ns()
    for number in range(4):
        bench.command.publish(String(data=f"press:RUN_STOP id=a{number}"))
    bench.spin_until_final(4)
    for number in range(4):
        bench.goal.publish(point_message([0.1, 0.1 + 0.01 * number, 0.0], header(stamp + number, BASE)))
    bench.spin_until_final(8)
    for ids in (["a0", "a1", "a2", "a3"], [str(stamp + number) for number in range(4)]):
        first, *others = ([r for r in bench.results if r.goal_id == i] for i in ids)
        assert [r.outcome for r in first] == [Outcome.ACCEPTED, Outcome.REACHED]
        for (refused,) in others:
            assert refused.outcome is Outcome.REJECTED and refused.reason == f"busy with {first[0].goal!r}"


def in_a_press(ros: Any) -> GantryBench:
    """Return a bench whose driver has been given the motion of a press, and does not answer."""
    bench = GantryBench(ros)
    bench.see()
    bench.spin_until_state("ready")
    bench.connect_goals()
    bench.obey = False
    bench.command.publish(String(data="press:RUN_STOP"))
    ros.spin_until(lambda: bench.trajectories, 10.0)
    return bench


def test_driver_stopped_in_the_middle(ros: Any) -> None:
    bench = in_a_press(ros)
    bench.driver_state.publish(String(data="stopped: stop requested"))
    result = bench.spin_until_final()
    assert result.outcome is Outcome.ABORTED and "stopped: stop requested" in result.reason
    bench.spin_until_state("stopped: stop requested")
    assert len(bench.trajectories) == 1


def test_a_stop_that_was_reset_while_the_controller_was_held_up_ends_the_goal(ros: Any) -> None:
    """Only the driver's newest state was kept for a node that was held up."""
    bench = in_a_press(ros)
    for state in ("stopped: stop requested", "idle"):
        bench.driver_state.publish(String(data=state))
    result = bench.spin_until_final()
    assert result.outcome is Outcome.ABORTED and "stopped: stop requested" in result.reason


def test_operator_lost_and_back(ros: Any) -> None:
    bench = GantryBench(ros, {"heartbeat_timeout_s": 2.0})
    bench.see()
    bench.spin_until_state("ready")
    bench.heartbeat = False
    bench.spin_until_state("waiting: no operator (heartbeat)")
    bench.connect_goals()
    bench.command.publish(String(data="press:RUN_STOP"))
    assert "no operator heartbeat for" in bench.spin_until_final().reason
    bench.heartbeat = True
    bench.spin_until_state("ready")
    assert bench.trajectories == []


def test_a_goal_that_waited_is_judged_by_what_came_before_it(ros: Any) -> None:
    """A controller that was held up finds both waiting; it said that there was no heartbeat yet."""
    bench = GantryBench(ros, heartbeat=False)
    bench.spin_until_state("waiting: no operator (heartbeat)")
    bench.connect_goals()
    ros.spin_until(lambda: bench.beat.get_subscription_count(), 10.0)
    bench.beat.publish(Header())
    assert bench.beat.wait_for_all_acked(Duration(seconds=10))
    bench.goal.publish(point_message([0.1, 0.1, 0.0], header(bench.now_ns(), BASE)))
    assert bench.goal.wait_for_all_acked(Duration(seconds=10))
    assert bench.spin_until_final().outcome is Outcome.REACHED


def test_closing_the_node_stops_the_machine(ros: Any) -> None:
    bench = GantryBench(ros)
    bench.see()
    bench.spin_until_state("ready")
    bench.connect_goals()
    ros.spin_until(lambda: bench.node.count_publishers("/gantry/stop_request"), 10.0)
    bench.obey = False
    bench.command.publish(String(data="press:RUN_STOP"))
    ros.spin_until(lambda: bench.trajectories, 10.0)
    bench.controller.close()
    result = bench.spin_until_final()
    assert result.outcome is Outcome.ABORTED and "shutting down" in result.reason
    ros.spin_until(lambda: bench.stops, 10.0)
    bench.spin_until_state("waiting: the controller has ended")


def test_messages_that_cannot_be_used_are_ignored(ros: Any) -> None:
    bench = GantryBench(ros)
    bench.spin_until_state("waiting: not calibrated")
    bench.see()
    bench.spin_until_state("ready")
    # Neither a wrong number of values nor a wild matrix replaces the calibration: the press below still works.
    bench.axes.publish(Float64MultiArray(data=[1.0, 0.0, 0.0]))
    bench.axes.publish(Float64MultiArray(data=[2.0, 0.0, 0.0, 1.0]))
    bench.pose.publish(bench.pose.msg_type(header=header(bench.now_ns(), "odom")))
    bench.connect_goals()
    bench.command.publish(String(data="press:RUN_STOP"))
    assert bench.spin_until_final().outcome is Outcome.REACHED
    np.testing.assert_allclose(positions(bench)[-1][-1], [*RUN_STOP[:2], 0.0], atol=1e-7)


def test_what_a_camera_with_a_clock_ahead_has_seen_does_not_count(ros: Any) -> None:
    """Its last picture would be young for as long as the clock is ahead, and the tip seen after a move before it."""
    bench = GantryBench(ros)
    bench.ahead_s = 3600.0
    bench.see()
    bench.spin_until_state("waiting: no image from the left camera")
    bench.connect_goals()
    bench.command.publish(String(data="press:RUN_STOP id=ahead"))
    assert bench.spin_until_final().reason.startswith("no image from the left camera yet")
    assert "ready" not in [state.data for state in bench.states] and bench.trajectories == []
    bench.ahead_s = 0.05  # as far as machines' clocks may differ
    bench.spin_until_state("ready")


def test_readings_that_no_machine_has_are_ignored(ros: Any) -> None:
    """A path from there would take forever, and did not fit the message."""
    bench = GantryBench(ros, {"joints_timeout_s": 1.0})
    bench.spin_until_state("waiting: not calibrated")
    bench.connect_goals()
    bench.readings = np.array([1e308, 0.0, 0.0])
    bench.spin_until_state("waiting: no joint_states")
    bench.goal.publish(point_message([0.1, 0.1, 0.0], header(0, BASE)))
    refused = bench.spin_until_final(1)
    assert refused.outcome is Outcome.REJECTED and refused.reason.startswith("no joint_states for ")
    bench.readings = np.zeros(3)
    assert bench.controller.set_parameters([Parameter("joints_timeout_s", value=5.0)])[0].successful
    bench.spin_until_state("waiting: not calibrated")
    bench.goal.publish(point_message([0.1, 0.1, 0.0], header(0, BASE)))
    assert bench.spin_until_final(2).outcome is Outcome.REACHED


def test_parameters_change_while_running(ros: Any) -> None:
    bench = GantryBench(ros, {"motion.x_max_m": 0.30})
    bench.spin_until_state("waiting: not calibrated")
    bench.connect_goals()
    bench.goal.publish(point_message([0.31, 0.1, 0.0], header(0, BASE)))
    assert "0.0000 to 0.3000 m" in bench.spin_until_final(1).reason
    answer = bench.controller.set_parameters([Parameter("tolerance_m", value=0.5)])[0]
    assert not answer.successful and "tolerance_m" in answer.reason
    assert bench.controller.set_parameters([Parameter("motion.x_max_m", value=0.32)])[0].successful
    bench.goal.publish(point_message([0.31, 0.1, 0.0], header(0, BASE)))
    assert bench.spin_until_final(2).outcome is Outcome.REACHED


@pytest.mark.parametrize("name", ["wrong_key", "motion.x_maximum_m"])
def test_unknown_parameter_is_refused(ros: Any, name: str) -> None:
    with pytest.raises(ValueError, match=name):
        GantryBench(ros, {name: 1.0})


def test_an_unexpected_error_stops_the_machine_answers_the_goal_and_ends_the_node(
    ros: Any, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    bench = GantryBench(ros)
    bench.see()
    bench.spin_until_state("ready")
    bench.connect_goals()
    ros.spin_until(lambda: bench.node.count_publishers("/gantry/stop_request"), 10.0)
    bench.obey = False
    bench.command.publish(String(data="press:RUN_STOP id=a1"))
    ros.spin_until(lambda: bench.trajectories and len(bench.results) == 1, 10.0)

    def slip(job: object) -> None:
        raise ZeroDivisionError("a slip in the plan")

    monkeypatch.setattr(bench.controller._controller, "_fault", slip)
    with pytest.raises(ZeroDivisionError, match="a slip in the plan"):
        ros.spin_until(lambda: False, 10.0)
    ros.executor.remove_node(bench.controller)
    result = bench.spin_until_final()
    assert result.outcome is Outcome.ABORTED and result.goal_id == "a1"
    assert "error in the controller: ZeroDivisionError('a slip in the plan')" in result.reason
    ros.spin_until(lambda: bench.stops, 10.0)
    bench.spin_until_state("stopped: error in the controller: ZeroDivisionError('a slip in the plan')")
    bench.controller.close()
    seen = len(bench.results)
    bench.joints.publish(bench.joints.msg_type())
    assert len(bench.results) == seen == 2
    assert "Traceback" in (log := capfd.readouterr().err) and "in slip" in log
