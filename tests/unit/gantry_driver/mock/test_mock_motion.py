"""The mock board's motion against closed forms: durations, corner speeds, deceleration, arcs, homing."""

from __future__ import annotations

import itertools
import math
import random

import pytest
from unit.gantry_driver.mock_rig import Rig

from gantry_driver.mock.firmware.motion import Limits, MotionEvent, MotionPlanner

OK = b"ok\r\n"


def trapezoid_s(distance: float, speed: float, acceleration: float) -> float:
    """Time for a move from rest to rest."""
    if speed * speed / acceleration >= distance:
        return 2.0 * math.sqrt(distance / acceleration)
    return distance / speed + speed / acceleration


def timed(rig: Rig, moves: bytes, within_s: float = 60.0) -> float:
    """Send moves and a dwell of zero; the dwell is acknowledged when the planner is empty."""
    rig.board.receive(moves + b"G4P0\n", rig.now)
    return rig.until(OK * (moves.count(b"\n") + 1), within_s)


@pytest.mark.parametrize(
    ("command", "distance", "speed", "acceleration"),
    [
        ("G1X-100F6000", 100.0, 100.0, 1500.0),
        ("G1X-100F600", 100.0, 10.0, 1500.0),
        ("G1X-2F12000", 2.0, 200.0, 1500.0),
        ("G0X-100", 100.0, 200.0, 1500.0),
        ("G1X-100F99999", 100.0, 200.0, 1500.0),
        ("G1Z-40F6000", 40.0, 50.0, 400.0),
        ("G1X-60Y-80F6000", 100.0, 100.0, 1500.0 / 0.8),
        ("G0X-60Y-80", 100.0, 200.0 / 0.8, 1500.0 / 0.8),
        ("G0X-30Y-40Z-40", math.sqrt(4100.0), 50.0 * math.sqrt(4100.0) / 40.0, 400.0 * math.sqrt(4100.0) / 40.0),
        ("G93G1X-100F6", 100.0, 10.0, 1500.0),
        ("G20G1X-3F60", 76.2, 25.4, 1500.0),
    ],
)
def test_a_move_takes_the_closed_form_time(command: str, distance: float, speed: float, acceleration: float) -> None:
    taken = timed(Rig.free(), command.encode() + b"\n")
    assert taken == pytest.approx(trapezoid_s(distance, speed, acceleration), rel=0.005)


@pytest.mark.parametrize("days", [3.5, 12.0, 120.0, 1e6])
def test_a_board_that_has_run_for_long_homes_and_moves(days: float) -> None:
    """Its clock then cannot resolve shorter times than a fast axis needs for a nanometre."""
    rig = Rig()
    rig.run(86400.0 * days)
    assert rig.send(b"$H\n", 60.0) == OK
    assert rig.send(b"G53G0X-100Y-100\nG4P0\n", 30.0) == OK * 2
    assert rig.report() == ("Idle", (-100.0, -100.0, -1.0))


def test_collinear_moves_do_not_slow_down() -> None:
    pieces = b"".join(b"X-%d\n" % (10 * i) for i in range(1, 11))
    taken = timed(Rig.free(), b"G1F6000\n" + pieces)
    assert taken == pytest.approx(trapezoid_s(100.0, 100.0, 1500.0), rel=0.005)


def test_corner_speed_is_that_of_the_junction_deviation() -> None:
    rig = Rig.free()
    rig.send(b"G1X-50F6000\nY-50\n")
    speeds = []
    while rig.board.motion.running:
        rig.run(0.001)
        speeds.append((rig.board.motion.position(rig.now), rig.board.motion.speed(rig.now)))
    at_corner = min(v for (x, y, _), v in speeds if x == -50 * 80 and -1 * 80 < y <= 0)
    half = math.sin(math.radians(45.0))
    expected = math.sqrt(1500.0 * math.sqrt(2.0) * 0.010 * half / (1.0 - half))
    assert at_corner == pytest.approx(expected, abs=1.6)  # sampled within 1 ms of the corner at 1.5 m/s^2
    reversal = Rig.free()
    assert timed(reversal, b"G1X-50F6000\nX0\n") == pytest.approx(2 * trapezoid_s(50.0, 100.0, 1500.0), rel=0.005)


@pytest.mark.parametrize("seed", range(5))
def test_random_paths_end_exactly_and_keep_to_the_limits(seed: int) -> None:
    rng = random.Random(seed)
    rig = Rig.free(line_s=0.0005)
    x = y = 0.0
    speed, gain = 0.0, 1500.0 * math.sqrt(2.0)
    for _ in range(60):
        x, y = round(rng.uniform(-20, 0), 2), round(rng.uniform(-20, 0), 2)
        rig.board.receive(f"G1X{x}Y{y}F{rng.choice([300, 3000, 12000])}\n".encode(), rig.now)
        while rig.board.motion.room < 3 or rig.board._ring:
            rig.run(0.0005)
            now = rig.board.motion.speed(rig.now)
            assert abs(now - speed) <= gain * 0.0005 + 1e-6, f"seed {seed}"
            assert now <= 200.0 * math.sqrt(2.0) + 1e-6
            speed = now
        speed = rig.board.motion.speed(rig.now)
    rig.run(60.0)
    state, position = rig.report()
    assert state == "Idle"
    assert position == pytest.approx((x, y, 0.0), abs=0.5 / 80 + 0.0005)


def test_the_report_follows_the_move() -> None:
    rig = Rig.free()
    rig.send(b"G1X-100F6000\n")
    rig.run(0.5)
    state, (x, _, _) = rig.report()
    ramp = 100.0**2 / (2 * 1500.0)
    assert state == "Run"
    assert x == pytest.approx(-(ramp + 100.0 * (0.5 - 100.0 / 1500.0)), abs=0.02)
    assert b"|FS:6000,0" in rig.send(b"?")
    true = rig.machine.truth()["mpos"][0] + 180.0
    assert true == pytest.approx(x, abs=0.001)


def test_feed_hold_decelerates_and_resume_finishes_the_path() -> None:
    rig = Rig.free()
    rig.send(b"G1X-100F6000\n")
    rig.run(0.5)
    _, (before, _, _) = rig.report()
    rig.send(b"!")
    assert rig.report()[0] == "Hold:1"
    rig.run(100.0 / 1500.0 - 0.001)
    assert rig.report()[0] == "Hold:1"
    rig.run(0.002)
    state, (after, _, _) = rig.report()
    assert state == "Hold:0"
    assert before - after == pytest.approx(100.0**2 / (2 * 1500.0), abs=0.02)
    assert rig.send(b"G4P0\n$G\n", 30.0) == b""  # nothing is acknowledged
    rig.board.receive(b"~", rig.now)
    rest = rig.until(OK, 5.0)
    assert rest == pytest.approx(trapezoid_s(100.0 + after, 100.0, 1500.0), rel=0.01)
    assert rig.report() == ("Idle", (-100.0, 0.0, 0.0))


def test_hold_runs_on_over_a_block_border() -> None:
    rig = Rig.free()
    rig.send(b"G1F6000\n" + b"".join(b"X-%d\n" % i for i in range(1, 12)))
    rig.run(0.08)
    assert rig.board.motion.speed(rig.now) > 50.0
    rig.send(b"!", 0.2)
    state, (x, y, z) = rig.report()
    assert state == "Hold:0" and -11.0 < x < -3.0 and (y, z) == (0.0, 0.0)
    rig.send(b"~", 2.0)
    assert rig.report() == ("Idle", (-11.0, 0.0, 0.0))


def test_overrides_change_the_move_under_way() -> None:
    rig = Rig.free()
    rig.send(b"G1X-100F3000\n")
    rig.run(0.5)
    rig.send(b"\x92" * 5)  # 50 %
    rig.run(0.1)
    assert b"|FS:1500,0" in rig.send(b"?")
    rig.send(b"\x90")
    rig.run(0.1)
    assert b"|FS:3000,0" in rig.send(b"?")
    rig.send(b"\x97")  # rapids at 25 % leave a feed move alone
    rig.run(0.1)
    assert b"|FS:3000,0" in rig.send(b"?")
    rig.run(10.0)
    assert timed(rig, b"G0X0\n") == pytest.approx(trapezoid_s(100.0, 50.0, 1500.0), rel=0.005)
    assert rig.report() == ("Idle", (0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("command", "length"),
    [("G2X-20Y0I-10", math.pi * 10), ("G3X-20Y0I-10", math.pi * 10), ("G2X0Y0I-10", 2 * math.pi * 10),
     ("G2X-10Y-10R10", math.pi * 5), ("G3X-10Y-10R-10", math.pi * 15)],
)  # fmt: skip
def test_arcs_keep_their_radius_and_length(command: str, length: float) -> None:
    rig = Rig.free()
    rig.board.receive(f"{command}F1200\nG4P0\n".encode(), rig.now)
    start, points = rig.now, []
    while True:
        answer = rig.run(0.01)
        points.append(rig.report()[1])
        if answer.count(OK) and not rig.board.motion.blocks:
            break
        assert rig.now - start < 30.0
    if "R" not in command:
        radii = [math.hypot(x + 10.0, y) for x, y, _ in points]
        assert max(abs(r - 10.0) for r in radii) < 0.002 + 1.0 / 80
    walked = sum(math.dist(a, b) for a, b in itertools.pairwise(points))
    assert walked == pytest.approx(length, rel=0.02)
    assert rig.now - start == pytest.approx(length / 20.0, rel=0.05)


def test_homing_takes_its_time_and_leaves_the_machine_where_the_brief_says() -> None:
    rig = Rig()
    pause = 4 * 0.05
    z = trapezoid_s(5.0, 50.0, 400.0) / 2 + 5.0 / 100.0  # stops abruptly at the switch
    x = (180.0 - 100.0**2 / 3000.0) / 100.0 + 100.0 / 1500.0
    rig.board.receive(b"$H\n", rig.now)
    taken = rig.until(OK, 30.0)
    locate = 2 * (1.0 / 5.0 + 3 * math.sqrt(1.0 / 400.0) + 0.2)
    assert z + x + 2 * pause < taken < z + x + 2 * pause + locate
    assert rig.report() == ("Idle", (-359.0, -219.0, -1.0))
    assert rig.machine.truth()["mpos"] == pytest.approx([-359.0, -219.0, -1.0], abs=1e-9)


def test_homing_time_grows_with_the_distance() -> None:
    from gantry_driver.mock.mechanics import MechanicsOptions

    times = []
    for start in (-350.0, -150.0, -10.0):
        rig = Rig(mechanics=MechanicsOptions(start_mm=(start, -200.0, -5.0)))
        rig.board.receive(b"$H\n", rig.now)
        times.append(rig.until(OK, 60.0))
    assert times[1] - times[0] == pytest.approx(2.0, rel=0.1)
    assert times[2] - times[1] == pytest.approx(1.4, rel=0.1)


def test_nothing_moves_when_a_line_is_wrong() -> None:
    rig = Rig.homed()
    for line in (b"G1X-300\n", b"G0X-300I1\n", b"$J=X-400F100\n", b"G2X-300F100\n"):
        assert rig.send(line, 1.0).startswith(b"error:")
        assert rig.report() == ("Idle", (-359.0, -219.0, -1.0))


def test_a_hold_in_the_last_deceleration_comes_to_rest_when_more_is_planned_behind() -> None:
    """The hold then ends where one block meets the next, at a speed that is zero but for rounding."""
    limits = Limits(
        steps_per_mm=(80.0, 80.0, 400.0),
        max_rate=(150.0, 150.0, 30.0),
        acceleration=(1500.0, 1500.0, 500.0),
        junction_deviation=0.01,
    )
    rng = random.Random(1928)
    held = 0
    for _ in range(2000):
        motion, now = MotionPlanner(limits), rng.uniform(0.0, 50.0)
        blocks = rng.randint(2, 12)
        for index in range(blocks):
            motion.add((94 * (index + 1), 0, 0), now, rate=150.0)
        motion.start(now)
        hold = now + rng.uniform(0.0, 0.2)
        while (due := motion.due()) is not None and due < hold:
            motion.step(due)
        if not motion.running:
            continue
        motion.hold(hold)
        motion.add((94 * (blocks + 1), 0, 0), hold, rate=150.0)
        events = [motion.step(due) for due in itertools.takewhile(bool, (motion.due() for _ in range(50)))]
        assert events[-1] is MotionEvent.HELD and motion.due() is None
        held += 1
    assert held > 500
