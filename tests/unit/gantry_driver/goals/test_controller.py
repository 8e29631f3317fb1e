"""The controller's state machine: every answer, every trajectory, every way a goal can end."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

import numpy as np
import pytest
from unit.gantry_driver.controller_bench import (
    BASE_FROM_PANEL,
    CAMERA,
    CAMERA_FROM_BASE,
    CAMERA_FROM_PANEL,
    MS,
    Bench,
    config,
)

from gantry_driver.core.goals.controller import Controller
from gantry_driver.core.job import controller_messages as msg
from gantry_driver.core.job.controller_config import ControllerConfig
from gantry_driver.core.job.goal_job import LOOKING, MOVING, GoalPhase, PhaseEnd
from icu_common.core.configuration.config import ConfigError, from_mapping
from icu_common.core.geometry.geometry import Transform
from icu_common.core.goals.results import Felt, GoalResult, Outcome
from icu_common.core.reasons.message import Message, joined
from icu_common.core.reasons.state_text import because

RUN_STOP = BASE_FROM_PANEL.apply([0.208, 0.127, 0.003])
PRESS_PHASES = [GoalPhase.APPROACH, GoalPhase.LOOK, GoalPhase.TOUCH, GoalPhase.CONTACT, GoalPhase.LIFT]


def outcomes(bench: Bench) -> list[Outcome]:
    return [r.outcome for r in bench.results]


# --- answers and trajectories -------------------------------------------------------------------------------------


def test_move_in_base_link_without_any_calibration() -> None:
    bench = Bench()
    bench.calibration = None
    bench.talking -= {"camera"}
    bench.start()
    assert bench.controller.state == "waiting: not calibrated"
    result = bench.go(0.12, 0.08, -0.01, stamp_ns=bench.now_ns)
    assert outcomes(bench) == [Outcome.ACCEPTED, Outcome.REACHED]
    assert {r.goal_id for r in bench.results} == {str(bench.now_ns - round(result.duration_s * 1000) * MS)}
    np.testing.assert_allclose(bench.paths[0], [[0.119, 0.079, 0.0], [0.12, 0.08, 0.0], [0.12, 0.08, 0.01]], atol=1e-12)
    assert result.error_m == pytest.approx(0.0, abs=1e-9) and result.duration_s > 1.0
    assert dict(result.details)["measured_by"] == "readings"
    targets = [a.in_base for a in bench.actions if isinstance(a, msg.ShowTarget)]
    np.testing.assert_allclose(targets, [[0.12, 0.08, -0.01]])


def test_second_move_retracts_first_and_uses_the_axes_of_the_calibration() -> None:
    bench = Bench()
    axes = np.array([[1.004, 0.003], [0.0, 0.997]])
    bench.calibration = (CAMERA_FROM_BASE, axes)
    bench.start()
    bench.readings = np.array([0.05, 0.05, 0.02])
    bench.run(0.1)
    result = bench.go(0.12, 0.08)
    q = np.linalg.solve(axes, [0.12, 0.08])
    np.testing.assert_allclose(bench.paths[0], [[0.05, 0.05, 0.0], [*(q - 0.001), 0.0], [*q, 0.0]], atol=1e-12)
    assert result.outcome is Outcome.REACHED and result.error_m == pytest.approx(0.0, abs=1e-9)


def test_a_goal_where_the_machine_stands_needs_no_trajectory() -> None:
    bench = Bench().start()
    result = bench.go(0.0, 0.0)
    assert result.outcome is Outcome.REACHED and bench.paths == []


def test_a_move_above_or_below_the_last_one_moves_the_stylus_alone() -> None:
    bench = Bench().start()
    for z in (0.0, -0.01, -0.004):
        assert bench.go(0.12, 0.08, z).outcome is Outcome.REACHED
    across, down, up = bench.paths
    np.testing.assert_allclose(across, [[0.119, 0.079, 0.0], [0.12, 0.08, 0.0]], atol=1e-12)
    np.testing.assert_allclose(down, [[0.12, 0.08, 0.01]], atol=1e-12)
    np.testing.assert_allclose(up, [[0.12, 0.08, 0.0], [0.12, 0.08, 0.004]], atol=1e-12)


def _push(bench: Bench) -> None:
    for x in (0.121, 0.12):
        bench.readings = np.array([x, 0.08, 0.0])
        bench.run(0.1)


def _disable(bench: Bench) -> None:
    for state in ("disabled", "idle"):
        bench.tell(msg.DriverState(text=state))
        bench.run(0.1)


@pytest.mark.parametrize("meanwhile", [_push, _disable, lambda bench: bench.do("press:RUN_STOP")])
def test_a_position_is_entered_again_after_any_other_motion(meanwhile: Callable[[Bench], object]) -> None:
    bench = Bench().start()
    bench.go(0.12, 0.08)
    meanwhile(bench)
    bench.go(0.12, 0.08, -0.01)
    np.testing.assert_allclose(bench.paths[-1][-3], [0.119, 0.079, 0.0], atol=1e-12)


def test_press_takes_exactly_these_trajectories() -> None:
    bench = Bench().start()
    result = bench.do("press:RUN_STOP id=a1")
    assert [(r.goal_id, r.outcome) for r in bench.results] == [("a1", Outcome.ACCEPTED), ("a1", Outcome.REACHED)]
    x, y, z = RUN_STOP
    hover, touch = -(z + 0.002 + 0.008), -(z + 0.002 - 0.0023)
    approach, down, up = bench.paths
    np.testing.assert_allclose(approach, [[x - 0.001, y - 0.001, 0.0], [x, y, 0.0], [x, y, hover]], atol=1e-9)
    np.testing.assert_allclose(down, [[x, y, touch - 0.003], [x, y, touch]], atol=1e-9)
    np.testing.assert_allclose(up, [[x, y, 0.0]], atol=1e-9)
    assert [s for s in bench.states if not s.startswith("waiting")] == [
        "ready", "moving", "looking", "touching", "moving", "ready",
    ]  # fmt: skip
    assert result.error_m < 1e-5  # the surface that stops the ball leans
    details = dict(result.details)
    assert details["control"] == "RUN_STOP" and details["measured_by"] == "cameras" and details["corrections"] == "0"
    # Speeds: quickly to 0.7 mm above the key's top, then 10 mm/s to 2.3 mm below it.
    plunge = [a.path for a in bench.actions if isinstance(a, msg.SendTrajectory)][1]
    np.testing.assert_allclose(np.diff(plunge.times_s), [0.3])
    assert plunge.times_s[0] == pytest.approx((touch - 0.003 - hover) / 0.05)


@pytest.mark.parametrize(
    "goal",
    [
        ("panel_link", 0.208, 0.127),
        ("camera_left_optical_frame", *CAMERA.project(CAMERA_FROM_PANEL.apply([[0.208, 0.127, 0.003]]))[0]),
    ],
)
def test_points_on_panel_and_picture_are_pressed(goal: tuple[str, float, float]) -> None:
    frame, x, y = goal
    bench = Bench().start()
    stamp = bench.now_ns - 100 * MS
    result = bench.go(x, y, frame=frame, stamp_ns=stamp)
    assert result.outcome is Outcome.REACHED and result.goal_id == str(stamp)
    assert dict(result.details)["control"] == "RUN_STOP"
    np.testing.assert_allclose(bench.paths[1][-1][:2], RUN_STOP[:2], atol=1e-7)
    np.testing.assert_allclose(bench.paths[1][-1][2], -RUN_STOP[2] + 0.0003, atol=1e-7)


def test_hold_stays_down_for_its_time() -> None:
    bench = Bench().start()
    down = []
    bench.on_phase[GoalPhase.CONTACT] = lambda b: down.append(b.now_ns)
    bench.on_phase[GoalPhase.LIFT] = lambda b: down.append(b.now_ns)
    assert bench.do("hold:SCREEN:2.5").outcome is Outcome.REACHED
    assert 2.5 <= (down[1] - down[0]) / 1e9 <= 2.5 + 0.05


def test_press_stays_down_for_its_time() -> None:
    bench = Bench().start()
    down = []
    bench.on_phase[GoalPhase.CONTACT] = lambda b: down.append(b.now_ns)
    bench.on_phase[GoalPhase.LIFT] = lambda b: down.append(b.now_ns)
    assert bench.do("press:RUN_STOP").outcome is Outcome.REACHED
    assert 0.3 <= (down[1] - down[0]) / 1e9 <= 0.35


def test_turn_follows_the_arc_at_depth() -> None:
    bench = Bench().start()
    result = bench.do("turn:CH1_SCALE:30")
    assert result.outcome is Outcome.REACHED
    assert [len(p) for p in bench.paths] == [3, 2, 15, 1]
    arc = bench.paths[2]
    centre = BASE_FROM_PANEL.apply([0.211, 0.092, 0.015])
    ball_in_panel = BASE_FROM_PANEL.inverse().apply(np.column_stack([arc[:, :2], -arc[:, 2]]))
    offset = ball_in_panel[:, :2] - [0.211, 0.092]
    np.testing.assert_allclose(np.linalg.norm(offset, axis=1), 0.0054, atol=2e-5)
    np.testing.assert_allclose(arc[:, 2], -(centre[2] + 0.001), atol=1e-4)
    last = math.degrees(math.atan2(offset[-1, 1], offset[-1, 0]))
    assert last == pytest.approx(-90 + 15, abs=0.2)


def test_stylus_with_two_positions_looks_from_above() -> None:
    motion = {"motion.stylus_two_positions": True, "motion.stylus_max_m": 0.032}
    bench = Bench(config(motion=from_mapping(ControllerConfig, motion).motion)).start()
    assert bench.do("press:RUN_STOP").outcome is Outcome.REACHED
    assert {float(p[2]) for path in bench.paths for p in path} == {0.0, 0.032}
    assert bench.do("turn:CH1_SCALE:30").outcome is Outcome.REACHED
    assert {float(p[2]) for path in bench.paths for p in path} == {0.0, 0.032}
    sent = len(bench.paths)
    assert "z = -0.01 m: this stylus has only two positions" in bench.go(0.1, 0.1, -0.01).reason
    assert "needs an extension of 0.033" in bench.do("press:SCREEN").reason
    assert len(bench.paths) == sent


def test_a_command_without_id_is_answered_by_its_text() -> None:
    bench = Bench().start()
    assert bench.do("press:RUN_STOP").goal_id == "press:RUN_STOP"


def test_tips_from_before_the_standstill_do_not_count() -> None:
    bench = Bench().start()
    seen_after = []

    def stale(b: Bench) -> None:
        b.talking.discard("tip")
        # Ten observations, all stamped before the end of the motion plus the settling time of 0.1 s.
        for i in range(10):
            b.tell(msg.TipSeen(in_camera=CAMERA_FROM_BASE.apply(np.zeros(3)), stamp_ns=b.now_ns + (90 - i) * MS))
        seen_after.append(b.controller.phase)
        b.talking.add("tip")

    bench.on_phase[GoalPhase.LOOK] = stale
    result = bench.do("press:RUN_STOP")
    assert seen_after == [GoalPhase.LOOK]
    assert result.outcome is Outcome.REACHED and dict(result.details)["corrections"] == "0"


# --- rejections ---------------------------------------------------------------------------------------------------


def rejected(bench: Bench, result: GoalResult, *words: str) -> None:
    assert result.outcome is Outcome.REJECTED, result
    for word in words:
        assert word in result.reason, result.reason
    assert bench.paths == [] and bench.controller.phase is GoalPhase.IDLE
    assert math.isnan(result.error_m)


@pytest.mark.parametrize(
    ("xyz", "frame", "words"),
    [
        ((float("nan"), 0.1, 0.0), "base_link", ["nan", "not finite"]),
        ((0.1, float("inf"), 0.0), "base_link", ["inf", "not finite"]),
        ((0.1, 0.1, float("-inf")), "base_link", ["-inf", "not finite"]),
        ((0.4, 0.1, 0.0), "base_link", ["gantry_x_joint = 0.4000", "0.3590"]),
        ((-0.01, 0.1, 0.0), "base_link", ["gantry_x_joint = -0.0100", "0.0000"]),
        ((0.1, 0.25, 0.0), "base_link", ["gantry_y_joint = 0.2500", "0.2190"]),
        ((0.1, 0.1, -0.08), "base_link", ["stylus_joint = 0.0800", "0.0590"]),
        ((0.1, 0.1, 0.01), "base_link", ["z = 0.01", "limit 0"]),
        ((0.1, 0.1, -0.04), "base_link", ["z = -0.0400", "touch the panel", "press"]),
        ((0.1, 0.1, 0.0), "map", ["'map'", "base_link", "panel_link", "camera_left_optical_frame"]),
        ((0.1, 0.1, 0.0), "", ["''"]),
        ((0.1, 0.1, 0.01), "panel_link", ["z = 0.01", "expected 0"]),
        ((0.5, 0.1, 0.0), "panel_link", ["0.5000", "outside the panel"]),
        ((2000.0, 10.0, 0.0), "camera_left_optical_frame", ["2000", "1280 x 720"]),
    ],
)
def test_bad_points_are_rejected(xyz: tuple[float, float, float], frame: str, words: list[str]) -> None:
    bench = Bench().start()
    rejected(bench, bench.go(*xyz, frame=frame), *words)
    assert outcomes(bench) == [Outcome.REJECTED]


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("press:RUN_STOPPP id=q", ["unknown control 'RUN_STOPPP'", "RUN_STOP"]),
        ("press:CH1_IN id=q", ["connector", "never"]),
        ("turn:RUN_STOP:20 id=q", ["button", "only a knob"]),
        ("press:RUN_STOP:3 id=q", ["press takes no argument"]),
        ("push:RUN_STOP id=q", ["'push'", "press, long, double, hold, turn"]),
        ("turn:CH1_SCALE:nan id=q", ["not finite"]),
        ("hold:CH1:31 id=q", ["hold needs seconds above 0 and up to 30"]),
        ("press:0.1,0.1@world id=q", ["'world'"]),
        ("press:0.36,0.1@base_link id=q", ["outside the panel"]),
    ],
)
def test_bad_commands_are_rejected_under_their_id(command: str, words: list[str]) -> None:
    bench = Bench().start()
    result = bench.do(command)
    rejected(bench, result, *words)
    assert result.goal_id == "q"


def test_a_refusal_names_what_was_asked_for_beside_the_reading() -> None:
    bench = Bench()
    bench.calibration = (CAMERA_FROM_BASE, np.diag([1.0035, 1.0]))
    rejected(bench.start(), bench.go(0.9, 0.1), "move to (0.9, 0.1, 0) m in base_link", "= 0.8969 m", "0.3590 m")


def test_reachable_area_counts_for_touches_too() -> None:
    bench = Bench(config(motion=from_mapping(ControllerConfig, {"motion.x_max_m": 0.2}).motion)).start()
    rejected(bench, bench.do("press:RUN_STOP"), "gantry_x_joint = 0.22", "0.2000")


@pytest.mark.parametrize(("age_ms", "good"), [(499, True), (501, False), (5000, False), (-501, False), (-100, True)])
def test_stale_and_future_stamps(age_ms: int, good: bool) -> None:
    bench = Bench().start()
    result = bench.go(0.1, 0.1, stamp_ns=bench.now_ns - age_ms * MS)
    if good:
        assert result.outcome is Outcome.REACHED
    else:
        rejected(bench, result, "stale", f"{age_ms / 1000:.3f} s", "0.5 s")
        assert ("the stamp is in the future: do the clocks agree?" in result.reason) is (age_ms < 0)


@pytest.mark.parametrize(
    "driver",
    [
        "disconnected: no port",
        "connecting",
        "unhomed",
        "homing",
        "moving",
        "stopped: by hand",
        "alarm: 1",
        "mismatch: $100",
        "disabled",
    ],
)
def test_driver_that_is_not_idle(driver: str) -> None:
    bench = Bench()
    bench.driver = driver
    bench.start()
    rejected(bench, bench.do("press:RUN_STOP"), f"the driver is {driver!r}", "expected 'idle'")
    rejected(bench, bench.go(0.1, 0.1), f"the driver is {driver!r}")
    state = driver.partition(":")[0]
    assert bench.controller.state == (driver if state in ("stopped", "alarm") else bench.controller.state)
    assert state in ("stopped", "alarm") or bench.controller.state.startswith("waiting: ")


@pytest.mark.parametrize(
    ("driver", "state"),
    [("disabled", "waiting: not enabled"), ("disabled: by the ward", "waiting: not enabled: by the ward")],
)
def test_a_machine_that_is_not_enabled_is_waited_for(driver: str, state: str) -> None:
    bench = Bench()
    bench.driver = driver
    bench.start()
    assert bench.controller.state == state
    bench.tell(msg.DriverState(text="idle"))
    assert bench.controller.state == "ready"


@pytest.mark.parametrize(
    ("silent", "words", "base_goals_too", "state"),
    [
        ("heartbeat", ["no operator heartbeat", "(limit 0.6 s)"], True, "waiting: no operator (heartbeat)"),
        ("joints", ["no joint_states", "(limit 1 s)"], True, "waiting: no joint_states"),
        (
            "camera",
            ["no image from the left camera", "(limit 1 s)"],
            False,
            "waiting: no image from the left camera",
        ),
    ],
)
@pytest.mark.parametrize("later", [False, True])
def test_what_falls_silent(silent: str, words: list[str], base_goals_too: bool, state: str, later: bool) -> None:
    bench = Bench()
    if not later:
        bench.talking -= {silent}
    bench.start()
    bench.talking -= {silent}
    bench.run(4.5)  # what is only late is waited for: see test_controller_patience
    assert bench.controller.state == state
    rejected(bench, bench.do("press:RUN_STOP"), *words)
    result = bench.go(0.1, 0.1)
    if base_goals_too:
        rejected(bench, result, *words)
    else:
        assert result.outcome is Outcome.REACHED


def test_a_driver_that_died_while_moving_does_not_count_as_moving() -> None:
    bench = Bench()
    bench.start()
    bench.tell(msg.DriverState(text="moving"))
    assert bench.controller.state == "waiting: the driver is moving"
    bench.talking -= {"joints"}
    bench.run(1.5)
    assert bench.controller.state == "waiting: no joint_states"


def test_no_calibration() -> None:
    bench = Bench()
    bench.calibration = None
    bench.start()
    rejected(bench, bench.do("press:RUN_STOP"), "not calibrated")
    rejected(bench, bench.go(0.1, 0.1, frame="panel_link"), "not calibrated")
    rejected(bench, bench.do("press:0.1,0.1@base_link"), "not calibrated")


def test_panel_never_seen_unsure_or_old() -> None:
    bench = Bench()
    bench.talking -= {"panel"}
    bench.start()
    rejected(bench, bench.do("press:RUN_STOP"), "is 0.00", "at least 0.3")
    bench.tell(msg.PanelConfidence(value=0.9))
    rejected(bench, bench.do("press:RUN_STOP"), "no recognition of the panel", "no pose")
    bench.tell(msg.PanelPose(camera_from_panel=CAMERA_FROM_PANEL, stamp_ns=bench.now_ns))
    bench.tell(msg.PanelConfidence(value=0.9))
    rejected(bench, bench.do("press:RUN_STOP"), "no recognition of the panel", "no controls")

    bench = Bench()
    bench.confidence = 0.25
    bench.start()
    rejected(bench, bench.do("press:RUN_STOP"), "confidence of the panel", "0.25", "at least 0.3")
    assert bench.controller.state == "waiting: panel not recognised"
    bench.confidence = float("nan")
    bench.run(0.2)
    rejected(bench, bench.do("press:RUN_STOP"), "confidence nan")

    bench = Bench().start()
    bench.talking -= {"panel"}
    bench.run(8.5)
    rejected(bench, bench.do("press:RUN_STOP"), "no pose of the panel for 8.", "at most 2 s")
    assert bench.controller.state == "waiting: panel pose is old"


def test_one_goal_at_a_time() -> None:
    bench = Bench().start()
    bench.tell(msg.Command(text="press:RUN_STOP id=first"))
    bench.run(0.5)
    bench.tell(msg.Command(text="press:SINGLE id=second"))
    assert bench.results[-1].goal_id == "second" and bench.results[-1].outcome is Outcome.REJECTED
    assert "busy with 'press:RUN_STOP id=first'" in bench.results[-1].reason
    bench.tell(msg.PointGoal(frame="base_link", xyz=np.array([0.1, 0.1, 0.0]), stamp_ns=bench.now_ns))
    assert bench.results[-1].outcome is Outcome.REJECTED
    assert bench.run_goal().goal_id == "first" and bench.finals[-1].outcome is Outcome.REACHED
    assert bench.do("press:SINGLE id=third").outcome is Outcome.REACHED


# --- ends before the end ------------------------------------------------------------------------------------------


def silence(what: str) -> Callable[[Bench], None]:
    return lambda b: b.talking.discard(what)


def shift_panel(b: Bench) -> None:
    t = b.camera_from_panel
    b.camera_from_panel = Transform(t.rotation, t.translation + [0.003, 0.0, 0.0])


def aborted(bench: Bench, result: GoalResult, *words: str) -> None:
    assert outcomes(bench) == [Outcome.ACCEPTED, Outcome.ABORTED], bench.results
    for word in words:
        assert word in result.reason, result.reason
    assert result.duration_s >= 0
    sent = len(bench.paths)
    bench.talking = {"heartbeat", "joints", "camera", "tip", "panel", "driver"}
    bench.run(3.0)
    assert len(bench.paths) == sent and len(bench.results) == 2, "nothing resumes by itself"


def stylus_is_up(bench: Bench) -> None:
    assert bench.readings[2] == 0.0
    np.testing.assert_allclose(bench.paths[-1][-1][2], 0.0)
    assert bench.stops == 0


@pytest.mark.parametrize("phase", PRESS_PHASES)
@pytest.mark.parametrize(
    "state", ["stopped: by hand", "alarm: 1 hard limit", "disconnected: unplugged", "mismatch: $100", "unhomed"]
)
def test_driver_fault_in_every_phase(phase: GoalPhase, state: str) -> None:
    bench = Bench().start()

    def fail(b: Bench) -> None:
        b._motion = None
        b._say_driver(state)

    bench.on_phase[phase] = fail
    result = bench.do("press:RUN_STOP")
    sent = len(bench.paths)
    aborted(bench, result, f"the driver is {state!r}", "no further motion")
    assert len(bench.paths) == sent == {"APPROACH": 1, "LOOK": 1, "TOUCH": 2, "CONTACT": 2, "LIFT": 3}[phase.name]


@pytest.mark.parametrize("outcome", [Outcome.REJECTED, Outcome.ABORTED])
@pytest.mark.parametrize("phase", [GoalPhase.APPROACH, GoalPhase.TOUCH, GoalPhase.LIFT])
def test_trajectory_refused_or_broken_off(phase: GoalPhase, outcome: Outcome) -> None:
    bench = Bench().start()

    def fail(b: Bench) -> None:
        b.answer, b.answer_reason = outcome, "soft limit"

    bench.on_phase[phase] = fail
    aborted(bench, bench.do("press:RUN_STOP"), f"the driver {outcome.value} the motion: soft limit")


@pytest.mark.parametrize(("outcome", "stops"), [(Outcome.REJECTED, 1), (Outcome.ABORTED, 0)])
@pytest.mark.parametrize("phase", [GoalPhase.TOUCH, GoalPhase.LIFT])
def test_a_refused_motion_does_not_leave_the_stylus_down(phase: GoalPhase, outcome: Outcome, stops: int) -> None:
    """A driver that breaks a motion off lifts by itself."""
    bench = Bench().start()

    def fail(b: Bench) -> None:
        b.answer, b.answer_reason = outcome, "stale"

    bench.on_phase[phase] = fail
    aborted(bench, bench.do("press:RUN_STOP"), "stale", "ordered a stop" if stops else "no further motion")
    assert bench.stops == stops


def test_a_motion_that_ends_elsewhere_with_the_stylus_down_is_a_stop() -> None:
    bench = Bench().start()

    def claim(b: Bench) -> None:
        action = next(a for a in reversed(b.actions) if isinstance(a, msg.SendTrajectory))
        b.readings = np.array([*b.readings[:2], 0.02])
        b._answer(action, Outcome.REACHED)

    bench.on_phase[GoalPhase.LIFT] = claim
    result = bench.do("press:RUN_STOP")
    aborted(bench, result, "mm off its target (limit 0.2 mm)", "ordered a stop")
    assert bench.stops == 1


def test_what_is_not_corrected_must_be_good_enough_to_touch() -> None:
    with pytest.raises(ConfigError, match=r"tolerance_m = 0.001.*max_error_m = 0.0005"):
        ControllerConfig(tolerance_m=0.001)


def test_hidden_tip() -> None:
    bench = Bench().start()
    bench.on_phase[GoalPhase.LOOK] = silence("tip")
    aborted(bench, bench.do("press:RUN_STOP"), "the cameras saw the tip 0 times (at least 4 times", "the stylus is up")
    stylus_is_up(bench)
    assert min(z for _, _, z in bench.lowest) >= RUN_STOP[2] + 0.009


@pytest.mark.parametrize("phase", [GoalPhase.TOUCH, GoalPhase.CONTACT])
def test_a_long_contact_ends_when_the_stylus_tracker_falls_silent(phase: GoalPhase) -> None:
    bench = Bench().start()
    moments: list[int] = []

    def silence_tracker(b: Bench) -> None:
        moments.append(b.now_ns)
        b.talking -= {"tip", "tracker"}

    bench.on_phase[phase] = silence_tracker
    bench.on_phase[GoalPhase.BREAK_OFF] = lambda b: moments.append(b.now_ns)
    result = bench.do("hold:SCREEN:6")
    aborted(bench, result, "touched, but not measured: no image that the stylus tracker has evaluated for 1.", "is up")
    stylus_is_up(bench)
    silent_ns, lifting_ns = moments
    assert (lifting_ns - silent_ns) / 1e9 < 1.5


@pytest.mark.parametrize("command", ["press:RUN_STOP", "hold:RUN_STOP:1", "turn:CH1_SCALE:30"])
@pytest.mark.parametrize("silent", ["tip", "camera"])
def test_hidden_contact(command: str, silent: str) -> None:
    bench = Bench().start()
    down = contact_times(bench)
    bench.on_phase[GoalPhase.CONTACT] = lambda b: (down.append(b.now_ns), b.talking.discard(silent))
    result = bench.do(command)
    stalled = silent == "camera" and not command.startswith("press")
    words = (
        "the camera has stalled"
        if stalled
        else "touched, but not measured: the cameras saw the tip 0 times (at least 3 times"
    )
    sent = len(bench.paths)
    aborted(bench, result, words, "the stylus is up")
    stylus_is_up(bench)
    assert sent == 3, "the knob is not turned"
    if command.startswith("press"):
        assert 0.6 <= (down[1] - down[0]) / 1e9 <= 0.65, "a press stays a press"


def contact_times(bench: Bench) -> list[int]:
    """Return a list that the times of the end of the touch will be appended to."""
    times: list[int] = []
    bench.on_phase[GoalPhase.LIFT] = lambda b: times.append(b.now_ns)
    return times


def test_a_press_is_short_and_its_late_pictures_count() -> None:
    bench = Bench().start()
    times = contact_times(bench)
    stamps: list[int] = []

    def late(b: Bench) -> None:
        times.append(b.now_ns)
        b.talking.discard("tip")
        stamps.extend(b.now_ns + ms * MS for ms in (100, 200, 300, 700))

    def arrive(b: Bench) -> None:
        # The last is of the time after the contact, when the tip is elsewhere.
        offsets = (0.0001, 0.0002, 0.0003, 0.1)
        for stamp, offset in zip(stamps, offsets):
            seen = RUN_STOP + [offset, 0.0, 0.001]
            b.tell(msg.TipSeen(in_camera=CAMERA_FROM_BASE.apply(seen), stamp_ns=stamp))

    bench.on_phase[GoalPhase.CONTACT], bench.on_phase[GoalPhase.MEASURE] = late, arrive
    result = bench.do("press:RUN_STOP")
    assert result.outcome is Outcome.REACHED
    # Three are needed; the stylus is already up when they come.
    assert result.error_m == pytest.approx(0.0002, abs=1e-9)
    assert 0.6 <= (times[1] - times[0]) / 1e9 <= 0.65


def test_hidden_tip_is_allowed_when_servoing_is_not_required() -> None:
    bench = Bench(config(require_servo=False)).start()
    bench.talking -= {"tip"}
    result = bench.do("press:RUN_STOP")
    # The control is touched, but without a sighting the goal is not reached.
    assert result.outcome is Outcome.ABORTED and math.isnan(result.error_m)
    assert result.touch is Felt.UNKNOWN and result.code == "contact_unknown"
    assert dict(result.details)["measured_by"] == "nothing"
    np.testing.assert_allclose(bench.paths[1][-1], [*RUN_STOP[:2], -RUN_STOP[2] + 0.0003], atol=1e-9)


def test_jumping_tip_is_not_averaged() -> None:
    bench = Bench().start()
    bench.noise_m = np.array([0.003, 0.003, 0.0])
    aborted(bench, bench.do("press:RUN_STOP"), "times within 0.6 mm)", "the stylus is up")
    stylus_is_up(bench)


@pytest.mark.parametrize(("phase", "limit_s"), [(GoalPhase.APPROACH, 4), (GoalPhase.LOOK, 4), (GoalPhase.TOUCH, 1)])
def test_stalled_camera_in_every_phase(phase: GoalPhase, limit_s: int) -> None:
    bench = Bench().start()
    bench.on_phase[phase] = silence("camera")
    words = "the camera has stalled", f"no image for {limit_s}.0 s", "the stylus is up"
    aborted(bench, bench.do("press:RUN_STOP"), *words)
    stylus_is_up(bench)


def test_stalled_camera_does_not_stop_a_move() -> None:
    bench = Bench().start()
    bench.on_phase[GoalPhase.MOVE] = silence("camera")
    assert bench.go(0.3, 0.2).outcome is Outcome.REACHED


@pytest.mark.parametrize("phase", [GoalPhase.APPROACH, GoalPhase.LOOK, GoalPhase.CONTACT])
def test_moved_panel_while_in_the_air_or_still(phase: GoalPhase) -> None:
    bench = Bench().start()
    bench.on_phase[phase] = shift_panel
    aborted(bench, bench.do("press:RUN_STOP"), "the panel has moved by 3.0 mm", "1.5 mm", "the stylus is up")
    stylus_is_up(bench)
    assert min(z for _, _, z in bench.lowest) >= (RUN_STOP[2] + 0.009 if phase is not GoalPhase.CONTACT else -1)


@pytest.mark.parametrize(
    ("phase", "command"), [(GoalPhase.TOUCH, "press:RUN_STOP"), (GoalPhase.TURN, "turn:CH1_SCALE:90")]
)
def test_moved_panel_while_pushing_stops_at_once(phase: GoalPhase, command: str) -> None:
    bench = Bench().start()
    bench.on_phase[phase] = shift_panel
    aborted(bench, bench.do(command), "the panel has moved by 3.0 mm", "ordered a stop")
    assert bench.stops == 1 and bench.controller.state == "stopped: on request"


def test_moved_panel_stops_at_once_also_a_stylus_that_is_to_go_up_for_another_reason_at_the_end_of_its_way() -> None:
    """The camera stalls while something is drawn, and shows a panel that has moved when it is back."""
    bench = Bench().start()
    bench.on_phase[GoalPhase.TURN] = silence("camera")
    bench.tell(msg.Command(text="drag:0.02,0.06@panel_link:0.18,0.06@panel_link"))
    while bench.controller.phase is not GoalPhase.TURN:
        bench.run(0.02)
    bench.run(1.3)
    assert bench.controller.phase is GoalPhase.TURN and bench.stops == 0
    bench.talking.add("camera")
    shift_panel(bench)
    cause = "the camera has stalled: no image for 1.0 s; then the panel has moved by 3.0 mm"
    aborted(bench, bench.run_goal(), cause, "ordered a stop")
    assert bench.stops == 1 and bench.controller.state == "stopped: on request"


ALARM = "by marker 4X4_50 7 the panel is 6.0 mm from where its print is (limit 2 mm)"
WITHDRAWN = msg.Axes(base_from_reading=None)


def test_panel_in_doubt_refuses_every_goal_until_the_alarm_ends() -> None:
    bench = Bench().start()
    bench.tell(msg.PanelAlarm(text=ALARM))
    bench.run(0.2)
    assert bench.controller.state == f"waiting: {ALARM}"
    rejected(bench, bench.do("press:RUN_STOP"), ALARM)
    rejected(bench, bench.do("press:0.1,0.1@base_link"), ALARM)
    bench.tell(msg.PanelAlarm(text=""))
    assert bench.do("press:RUN_STOP").outcome is Outcome.REACHED


@pytest.mark.parametrize("phase", [GoalPhase.APPROACH, GoalPhase.LOOK, GoalPhase.CONTACT])
def test_panel_in_doubt_ends_a_touch(phase: GoalPhase) -> None:
    bench = Bench().start()
    bench.on_phase[phase] = lambda b: b.tell(msg.PanelAlarm(text=ALARM))
    aborted(bench, bench.do("press:RUN_STOP"), ALARM)
    assert bench.readings[2] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("phase", "command"),
    [
        (GoalPhase.TOUCH, "press:RUN_STOP"),
        (GoalPhase.TURN, "turn:CH1_SCALE:90"),
        (GoalPhase.TURN, "drag:0.05,0.06@panel_link:0.15,0.06@panel_link"),
    ],
)
@pytest.mark.parametrize("calibrated", [False, True])
def test_panel_or_calibration_in_doubt_while_pushing_stops_at_once(
    calibrated: bool, phase: GoalPhase, command: str
) -> None:
    """The stylus pressed first, or drew to the end, what was known not to be there, and only then went up."""
    bench = Bench().start()
    bench.on_phase[phase] = lambda b: b.tell(msg.PanelAlarm(text=ALARM) if calibrated else WITHDRAWN)
    aborted(bench, bench.do(command), ALARM if calibrated else "the calibration is no longer valid", "ordered a stop")
    assert bench.stops == 1 and bench.controller.state == "stopped: on request"
    assert len(bench.paths) == {GoalPhase.TOUCH: 2, GoalPhase.TURN: 3}[phase], "the driver lifts"


@pytest.mark.parametrize("phase", [GoalPhase.APPROACH, GoalPhase.LOOK, GoalPhase.CONTACT])
def test_a_calibration_that_is_withdrawn_ends_a_touch(phase: GoalPhase) -> None:
    """It was touched, measured and answered `reached` by a calibration that was known not to fit."""
    bench = Bench().start()
    bench.on_phase[phase] = lambda b: b.tell(WITHDRAWN)
    aborted(bench, bench.do("press:RUN_STOP"), "the calibration is no longer valid", "the stylus is up")
    stylus_is_up(bench)
    assert min(z for _, _, z in bench.lowest) >= (RUN_STOP[2] + 0.009 if phase is not GoalPhase.CONTACT else -1)


def test_small_shift_and_dip_of_confidence_are_tolerated() -> None:
    bench = Bench().start()

    def dip(b: Bench) -> None:
        b.confidence = 0.1
        t = b.camera_from_panel
        b.camera_from_panel = Transform(t.rotation, t.translation + [0.05, 0.0, 0.0])

    def small(b: Bench) -> None:
        b.confidence = 0.9
        t = CAMERA_FROM_PANEL
        b.camera_from_panel = Transform(t.rotation, t.translation + [0.001, 0.0, 0.0])

    bench.on_phase[GoalPhase.LOOK], bench.on_phase[GoalPhase.TOUCH] = dip, small
    assert bench.do("press:RUN_STOP").outcome is Outcome.REACHED


@pytest.mark.parametrize("phase", [GoalPhase.APPROACH, GoalPhase.LOOK, GoalPhase.CONTACT])
def test_lost_operator(phase: GoalPhase) -> None:
    bench = Bench().start()
    bench.on_phase[phase] = silence("heartbeat")
    result = bench.do("hold:RUN_STOP:3")
    aborted(bench, result, "lost the operator: no heartbeat for 0.6 s", "the stylus is up")
    stylus_is_up(bench)


def test_lost_operator_and_a_driver_that_holds_by_itself() -> None:
    bench = Bench().start()
    bench.on_phase[GoalPhase.LIFT] = silence("heartbeat")

    def hold(b: Bench) -> None:
        b.talking.discard("heartbeat")

    bench.on_phase[GoalPhase.APPROACH] = hold
    bench.tell(msg.Command(text="press:RUN_STOP"))
    bench.run(0.9)
    bench._motion = None
    bench._say_driver("stopped: operator's heartbeat lost")
    aborted(bench, bench.finals[-1], "lost the operator", "then the driver is 'stopped: operator's heartbeat lost'")


@pytest.mark.parametrize("phase", [GoalPhase.APPROACH, GoalPhase.TOUCH])
def test_silent_driver(phase: GoalPhase) -> None:
    bench = Bench().start()
    bench.on_phase[phase] = silence("joints")
    aborted(bench, bench.do("press:RUN_STOP"), "no joint_states for 1.0 s", "ordered a stop")
    assert bench.stops == 1


@pytest.mark.parametrize("phase", [GoalPhase.APPROACH, GoalPhase.TOUCH, GoalPhase.LIFT])
def test_no_result_of_the_motion(phase: GoalPhase) -> None:
    bench = Bench().start()
    bench.on_phase[phase] = silence("driver")
    aborted(bench, bench.do("press:RUN_STOP"), "no result of the motion from the driver for", "ordered a stop")
    assert bench.stops == 1


def test_driver_that_claims_to_have_arrived() -> None:
    bench = Bench().start()

    def answer_at_once(b: Bench) -> None:
        action = next(a for a in reversed(b.actions) if isinstance(a, msg.SendTrajectory))
        b._answer(action, Outcome.REACHED)

    bench.on_phase[GoalPhase.APPROACH] = answer_at_once
    bench.tell(msg.Command(text="press:RUN_STOP"))
    answer_at_once(bench)
    bench.run(0.3)
    aborted(bench, bench.finals[-1], "mm off its target (limit 0.2 mm)", "no further motion")


def test_results_of_other_trajectories_are_not_ours() -> None:
    bench = Bench().start()
    bench.tell(msg.Command(text="press:RUN_STOP"))
    bench.run(0.1)
    for outcome in (Outcome.REACHED, Outcome.ABORTED):
        bench.tell(msg.MotionResult(result=GoalResult(goal_id="12345", goal="", outcome=outcome)))
    assert bench.controller.phase is GoalPhase.APPROACH
    assert bench.run_goal().outcome is Outcome.REACHED


def test_tip_far_from_its_place_means_a_wrong_calibration() -> None:
    bench = Bench()
    bench.tip_offset = np.array([0.006, 0.0, 0.0])
    bench.start()
    aborted(bench, bench.do("press:RUN_STOP"), "6.00 mm to the side", "5", "calibrate again", "the stylus is up")
    stylus_is_up(bench)
    bench = Bench()
    bench.tip_offset = np.array([0.0, 0.0, -0.004])
    bench.start()
    aborted(bench, bench.do("press:RUN_STOP"), "-4.00 mm above", "limits 5 and 3 mm", "the stylus is up")
    assert min(z for _, _, z in bench.lowest) >= RUN_STOP[2] + 0.010 - 0.0041


@pytest.mark.parametrize("off_m", [(0.0, 0.0, -0.010), (0.012, 0.0, 0.0)])
def test_a_stylus_that_is_longer_or_bent_is_not_lowered_when_it_was_seen_at_rest(off_m: tuple[float, ...]) -> None:
    bench = Bench()
    bench.start()
    assert bench.do("press:RUN_STOP").outcome is Outcome.REACHED
    bench.run(1.0)
    assert bench.do("press:CH1").outcome is Outcome.REACHED, "one that is where it should be may go on"
    bench.lowest.clear()
    bench.tip_offset = np.array(off_m)  # 10 mm are more than the height at which the tip is looked at
    bench.run(1.0)
    paths = len(bench.paths)
    result = bench.do("press:RUN_STOP")
    assert result.outcome is Outcome.ABORTED and len(bench.paths) == paths
    assert "its target (limits 5 and 3 mm): calibrate again; the stylus may be bent, or another" in result.reason
    bench.tip_offset = np.zeros(3)
    bench.run(1.0)
    assert bench.do("press:RUN_STOP").outcome is Outcome.REACHED


def test_error_that_corrections_do_not_cure() -> None:
    bench = Bench().start()

    def slip(b: Bench) -> None:
        # A loose carriage: each correction is followed by a new error.
        b.tip_offset = np.array([0.001 if b.tip_offset[0] <= 0 else -0.001, 0.0, 0.0])
        b.on_phase[GoalPhase.LOOK] = slip

    bench.on_phase[GoalPhase.LOOK] = slip
    aborted(bench, bench.do("press:RUN_STOP"), "after 3 corrections", "(limit 0.5 mm)", "the stylus is up")
    stylus_is_up(bench)
    assert min(z for _, _, z in bench.lowest) >= RUN_STOP[2] + 0.009


def test_a_touch_beside_the_target_is_not_called_reached() -> None:
    bench = Bench().start()

    def bend(b: Bench) -> None:
        b.tip_offset = np.array([0.0, 0.0007, 0.0])

    bench.on_phase[GoalPhase.CONTACT] = bend
    result = bench.do("press:RUN_STOP")
    aborted(bench, result, "touched 0.70 mm off the target (limit 0.5 mm)", "the stylus is up")
    assert result.error_m == pytest.approx(0.0007, abs=1e-5)  # the surface that stops the ball leans


@pytest.mark.parametrize("command", ["press:RUN_STOP", "double:RUN_STOP", "turn:CH1_SCALE:30"])
def test_a_tip_that_is_seen_in_the_air_has_not_touched(command: str) -> None:
    bench = Bench().start()
    hovering: list[float] = []

    def stick(b: Bench) -> None:
        # The axis counts its steps, the stylus stays where it is; a camera that repeats its picture shows the same.
        hovering.append(b.tip_in_base()[2])
        b.tip_seen_in_base = lambda: np.array([*b.tip_in_base()[:2], hovering[0]])  # type: ignore[method-assign]

    bench.on_phase[GoalPhase.TOUCH] = stick
    result = bench.do(command)
    sent = len(bench.paths)
    words = "the tip was 8.0 mm above the surface when it should touch (limit 3 mm)"
    aborted(bench, result, words, "the stylus is up")
    assert sent == 3, "down and up, and no arc is followed in the air"


GONE_DOWN = "the stylus had already touched: check the panel before you try again"


@pytest.mark.parametrize(
    ("fault", "end"),
    [
        (shift_panel, "the stylus is up"),
        (lambda b: b.talking.discard("joints"), "ordered a stop"),
        (lambda b: b._say_driver("stopped: by hand"), "no further motion"),
    ],
)
@pytest.mark.parametrize("phase", [GoalPhase.APPROACH, GoalPhase.CONTACT])
def test_who_is_told_that_a_press_was_broken_off_is_told_that_it_may_have_acted(
    phase: GoalPhase, fault: Callable[[Bench], None], end: str
) -> None:
    bench = Bench().start()
    bench.on_phase[phase] = fault
    result = bench.do("hold:RUN_STOP:2")
    assert result.outcome is Outcome.ABORTED and end in result.reason
    # First, as where there is little room only the beginning is read.
    assert result.reason.startswith(f"{GONE_DOWN}; ") is (phase is GoalPhase.CONTACT), result.reason


def test_correction_that_leaves_the_table() -> None:
    panel = BASE_FROM_PANEL.apply([0.208, 0.127, 0.003])
    limits = from_mapping(ControllerConfig, {"motion.x_max_m": float(panel[0]) + 0.0005}).motion
    bench = Bench(config(motion=limits))
    bench.tip_offset = np.array([-0.001, 0.0, 0.0])
    bench.start()
    aborted(bench, bench.do("press:RUN_STOP"), "corrected aim: gantry_x_joint", "the stylus is up")
    stylus_is_up(bench)


def test_clock_that_jumps_back_stops_everything() -> None:
    bench = Bench().start()
    bench.tell(msg.Command(text="press:RUN_STOP"))
    bench.run(0.2)
    bench.now_ns -= 3_600_000 * MS
    bench.tell(msg.Tick())
    result = bench.finals[-1]
    assert result.outcome is Outcome.ABORTED and "the clock jumped back by 3600.0 s" in result.reason
    assert bench.stops == 1 and bench.controller.phase is GoalPhase.IDLE
    # Data that was fresh before the jump is not fresh any more.
    bench.tell(msg.DriverState(text="idle"))
    bench.tell(msg.Joints(readings=np.zeros(3)))
    bench.tell(msg.PointGoal(frame="base_link", xyz=np.array([0.1, 0.1, 0.0]), stamp_ns=0))
    assert "heartbeat" in bench.finals[-1].reason


def test_a_pose_from_before_a_clock_that_jumped_back_is_not_believed_after_it() -> None:
    """It would stay young until the clock has come back there."""
    bench = Bench().start()
    assert bench.controller.state == "ready"
    bench.tell(msg.PanelPose(camera_from_panel=bench.camera_from_panel, stamp_ns=bench.now_ns))
    bench.now_ns -= 3_600_000 * MS
    bench.tell(msg.Tick())
    bench.tell(msg.PanelConfidence(value=0.9))
    for event in (
        msg.DriverState(text="idle"),
        msg.Joints(readings=np.zeros(3)),
        msg.OperatorHeartbeat(),
        msg.CameraSeen(camera=CAMERA, stamp_ns=bench.now_ns),
        msg.Tick(),
    ):
        bench.tell(event)
    assert bench.controller.state == "waiting: panel pose is old"


def test_motions_after_a_clock_that_jumped_back_have_stamps_of_the_new_time() -> None:
    """The driver refuses a stamp that is ahead of its clock."""
    bench = Bench().start()
    assert bench.do("press:RUN_STOP").outcome is Outcome.REACHED
    bench.now_ns -= 3_600_000 * MS
    bench.run(0.5)
    assert bench.do("press:RUN_STOP").outcome is Outcome.REACHED
    sent = [action.stamp_ns for action in bench.actions if isinstance(action, msg.SendTrajectory)]
    assert sent[-1] <= bench.now_ns


def test_a_panel_is_still_after_a_clock_that_jumped_back() -> None:
    """With cameras on the carriage only a pose from after the last motion counts."""
    bench = Bench(config(camera_on_carriage=True)).start()
    bench.tell(msg.PointGoal(frame="base_link", xyz=np.array([0.1, 0.1, 0.0]), stamp_ns=0))
    bench.run(3.0)
    assert bench.finals[-1].outcome is Outcome.REACHED
    bench.now_ns -= 3_600_000 * MS
    bench.run(1.0)
    assert bench.controller.state == "ready"


def test_shutdown_stops_a_goal_in_work() -> None:
    bench = Bench().start()
    bench.tell(msg.Command(text="press:RUN_STOP"))
    actions = bench.controller.close(bench.now_ns)
    assert [type(a) for a in actions] == [msg.CallStop, msg.PublishResult, msg.PublishState]
    assert isinstance(actions[1], msg.PublishResult) and "shutting down" in actions[1].result.reason
    assert bench.controller.handle(msg.Command(text="press:RUN_STOP"), bench.now_ns) == []
    idle = Bench().start()
    assert [type(a) for a in idle.controller.close(idle.now_ns)] == [msg.PublishState]


# --- the table and the configuration --------------------------------------------------------------------------------


def test_the_table_has_an_entry_for_every_end_of_every_phase() -> None:
    seeing = {*LOOKING, GoalPhase.SIGHT, GoalPhase.WAIT, GoalPhase.READ}
    expected = {(p, PhaseEnd.ARRIVED) for p in MOVING} | {
        (p, s) for p in seeing for s in (PhaseEnd.SEEN, PhaseEnd.UNSEEN)
    }
    assert set(Controller._NEXT) == expected
    assert set(MOVING) | seeing | {GoalPhase.IDLE} == set(GoalPhase)


def test_axes_far_from_the_identity_are_no_calibration() -> None:
    for wrong in (np.diag([1.2, 1.0]), np.full((2, 2), np.nan), np.eye(3)):
        with pytest.raises(ValueError, match="axes"):
            msg.Axes(base_from_reading=wrong)


def test_configuration_refuses_nonsense() -> None:
    with pytest.raises(ConfigError, match="tolerance_m"):
        from_mapping(ControllerConfig, {"tolerance_m": 0.5})
    with pytest.raises(ConfigError, match=re.escape("has no setting touch.hover")):
        from_mapping(ControllerConfig, {"touch.hover": 0.5})


# --- what was left behind -----------------------------------------------------------------------------------------


def test_started_with_the_stylus_extended_it_asks_for_a_stop_and_says_why() -> None:
    bench = Bench()
    bench.readings = np.array([0.05, 0.05, 0.02])
    bench.driver = "moving"  # what the controller before had sent goes on
    bench.start()
    assert bench.stops == 0
    bench._say_driver("idle")
    rejected(bench, bench.go(0.1, 0.1), "extended by 20.0 mm")
    bench.run(0.1)
    assert bench.stops == 1 and bench.driver == "stopped: on request"
    assert "the controller started with the stylus extended by 20.0 mm" in bench.controller.state
    assert bench.controller.state.startswith("stopped: on request")
    bench.readings = np.array([0.05, 0.05, 0.0])
    bench._say_driver("idle")
    bench.run(0.2)
    assert bench.controller.state == "ready" and bench.do("press:RUN_STOP").outcome is Outcome.REACHED
    assert bench.stops == 1


@pytest.mark.parametrize(
    ("driver", "state"),
    [
        ("unhomed", "waiting: not homed"),
        ("idle", "waiting: no joint_states"),
        ("disconnected: link lost: unplugged", "waiting: driver disconnected: link lost: unplugged"),
        ("alarm: 3 reset while moving", "alarm: 3 reset while moving"),
        ("stopped: stop requested", "stopped: stop requested"),
    ],
)
def test_a_stylus_that_a_lost_driver_has_left_down_is_told_until_it_is_up(driver: str, state: str) -> None:
    bench = Bench().start()

    def die(b: Bench) -> None:
        b._motion = None
        b.talking -= {"joints"}  # the position is not known any more, and a new one has none

    bench.on_phase[GoalPhase.CONTACT] = die
    assert bench.do("hold:RUN_STOP:5").outcome is Outcome.ABORTED
    bench._say_driver(driver)
    left = f"{1000 * bench.readings[2]:.1f}"
    assert float(left) > 20.0
    words = f"the last extension of the stylus was {left} mm, and it may still press: homing lifts it"
    assert bench.controller.state == f"{state}; {words}"
    bench._say_driver("homing")
    assert bench.controller.state == "waiting: homing"
    bench.readings, bench.talking = np.zeros(3), {*bench.talking, "joints"}
    bench._say_driver("idle")
    bench.run(0.2)
    assert bench.controller.state == "ready"
    bench._say_driver("unhomed")
    assert bench.controller.state == "waiting: not homed"


@pytest.mark.parametrize(
    "told", [Message("stylus.stylus_not_lifted_may_still"), Message("stylus.solenoid_without_power_stylus_up")]
)
def test_what_the_driver_has_told_of_a_stylus_left_down_is_not_told_twice(told: Message) -> None:
    bench = Bench().start()
    bench.readings = np.array([0.1, 0.1, 0.02])
    bench.run(0.2)
    state = because("alarm", joined(["ALARM:1", told]))
    bench._say_driver(state)
    assert bench.controller.state == state == f"alarm: ALARM:1; {told}"


def test_a_stylus_whose_position_was_lost_is_reported_clear_when_images_show_it_off_the_panel() -> None:
    bench = Bench().start()
    bench.readings = np.array([0.1, 0.1, 0.02])
    bench.run(1.5)  # images of before the loss show it at 10 mm
    bench.talking -= {"joints"}
    bench._say_driver("unhomed: link lost")
    bench.run(2.0)
    assert clear_heights(bench) == []
    assert bench.controller.state.endswith(
        "extension of the stylus was 20.0 mm, and it may still press: homing lifts it"
    )
    bench.readings = np.zeros(3)  # a person has lifted it by hand
    bench.run(1.0)
    assert clear_heights(bench) == [], "images of before still count"
    bench.run(4.0)
    heights = clear_heights(bench)
    assert 1 <= len(heights) <= 4 and all(abs(height_m - height(bench)) < 0.001 for height_m in heights)
    assert bench.controller.state == "waiting: not homed: link lost"


def test_nothing_is_reported_clear_while_the_driver_knows_the_position() -> None:
    bench = Bench().start()
    bench.run(4.0)
    assert clear_heights(bench) == []


def clear_heights(bench: Bench) -> list[float]:
    return [action.height_m for action in bench.actions if isinstance(action, msg.ReportClear)]


def height(bench: Bench) -> float:
    """Return the tip's height above the panel, by the bench's own geometry."""
    return float(BASE_FROM_PANEL.inverse().apply(bench.tip_in_base())[2])


@pytest.mark.parametrize("reason", ["a cable that may press on the plug", "it may still press"])
def test_words_of_the_drivers_reason_do_not_hide_how_far_the_stylus_was_extended(reason: str) -> None:
    bench = Bench().start()
    bench.readings = np.array([0.1, 0.1, 0.02])
    bench.run(0.2)
    bench._say_driver(f"disconnected: {reason}")
    words = "the last extension of the stylus was 20.0 mm, and it may still press: homing lifts it"
    assert bench.controller.state == f"waiting: driver disconnected: {reason}; {words}"


def test_a_stop_that_nobody_heard_is_asked_for_again() -> None:
    bench = Bench()
    bench.readings = np.array([0.05, 0.05, 0.02])
    bench._say_driver = lambda text: None  # type: ignore[method-assign]
    bench.tell(msg.DriverState(text="idle"))
    bench.run(2.0)
    assert 3 <= bench.stops <= 6
    assert bench.controller.state == "waiting: the controller started with the stylus extended by 20.0 mm"


def test_after_its_start_a_stylus_that_rests_extended_is_no_reason() -> None:
    bench = Bench().start()
    assert bench.go(0.1, 0.1, -0.01).outcome is Outcome.REACHED
    bench.run(1.0)
    assert bench.stops == 0 and bench.controller.state == "ready"


# --- the way up ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("end", ["after the contact", "after a fault"])
def test_the_stylus_is_lifted_where_it_stands_also_when_that_lies_outside_the_limits_now(end: str) -> None:
    bench = Bench().start()

    def narrow(b: Bench) -> None:
        motion = from_mapping(ControllerConfig, {"motion.x_max_m": 0.1, "motion.y_max_m": 0.1}).motion
        b.controller.config = config(motion=motion)
        if end == "after a fault":
            b.talking.discard("heartbeat")

    bench.on_phase[GoalPhase.CONTACT] = narrow
    result = bench.do("press:RUN_STOP" if end == "after the contact" else "hold:RUN_STOP:5")
    assert result.outcome is (Outcome.REACHED if end == "after the contact" else Outcome.ABORTED)
    np.testing.assert_allclose(bench.paths[-1], [[*RUN_STOP[:2], 0.0]], atol=1e-9)
    assert bench.readings[2] == 0.0


def test_after_an_error_nothing_is_sent_any_more_and_what_was_answered_stays_answered() -> None:
    bench = Bench().start()
    controller = bench.controller
    controller._go = lambda *arguments: 1 / 0  # type: ignore[method-assign,assignment,return-value]
    with pytest.raises(ZeroDivisionError):
        controller.handle(msg.Command(text="press:RUN_STOP id=a1"), bench.now_ns)
    actions = controller.fail("error in the controller: x", bench.now_ns)
    assert [a.result.outcome for a in actions if isinstance(a, msg.PublishResult)] == [
        Outcome.ACCEPTED, Outcome.ABORTED,
    ]  # fmt: skip
    assert isinstance(actions[0], msg.CallStop) and not any(isinstance(a, msg.SendTrajectory) for a in actions)
    assert actions[-1] == msg.PublishState(text="stopped: error in the controller: x")
    assert controller.handle(msg.Tick(), bench.now_ns) == controller.close(bench.now_ns) == []
    assert controller.fail("again", bench.now_ns) == []


def test_operator_is_lost_by_the_wall_clock_and_nothing_else_is() -> None:
    """Where time is simulated the machine's limits are of its time, those that guard people of the wall's."""
    bench = Bench().start()
    bench.talking.discard("heartbeat")
    controller, wall_ns = bench.controller, 5 * 10**9
    controller.handle(msg.OperatorHeartbeat(), bench.now_ns, wall_ns)
    for late_ms in range(50, 550, 50):
        controller.handle(msg.Tick(), bench.now_ns, wall_ns + late_ms * 1_000_000)
    assert controller.state == "ready"
    for late_ms in range(550, 750, 50):  # a longer pause between two ticks would be the controller's own
        controller.handle(msg.Tick(), bench.now_ns, wall_ns + late_ms * 1_000_000)
    assert controller.state == "waiting: no operator (heartbeat)"
    controller.handle(msg.OperatorHeartbeat(), bench.now_ns, wall_ns + 700_000_000)
    assert controller.state == "ready"
