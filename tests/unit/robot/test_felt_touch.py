"""Touches of the whole robot on keys that are not where, or not as, it believes: the answers against the truth.

The truth is the bench's.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
from support.virtual_robot import VirtualRobot

from icu_common.core.goals.results import Felt, GoalResult, Outcome
from icu_simulator.core.configuration import BenchConfig

pytestmark = pytest.mark.long

SEEDS = (1, 2, 3)
KEYS = ("RUN_STOP", "AUTO_SET", "SAVE", "CH1")
LAYOUTS = ("dso_bench_4", "ventilator_v1", "crt_classic_2")


def prepared(seed: int, layout: str = "dso_bench_4", **settings: Any) -> VirtualRobot:
    print(f"seed {seed}")
    robot = VirtualRobot(seed, layout=layout, bench={name.replace("__", "."): v for name, v in settings.items()})
    robot.prepare(calibrate=False)
    return robot


def shifted(robot: VirtualRobot, z_offset_mm: float) -> VirtualRobot:
    """Bump the stylus of a calibrated robot."""
    config: BenchConfig = robot.bench.config
    mechanics = dataclasses.replace(config.mechanics, z_offset_mm=z_offset_mm)
    robot.bench.reconfigure(dataclasses.replace(config, mechanics=mechanics))
    return robot


def press(robot: VirtualRobot, name: str) -> tuple[GoalResult, list[str]]:
    """Press a control; return the answer and the controls that truly acted."""
    robot.look_at_panel()
    robot.take_records()
    result = robot.command(f"press:{name}")
    acted = [record["control"] for record in robot.take_records() if record["event"] == "press"]
    print(
        f"{name}: {result.outcome.value} {result.touch} {result.code} {result.reason}, {dict(result.details)}, {acted}"
    )
    return result, acted


@pytest.mark.timeout(480)
@pytest.mark.parametrize("seed", SEEDS)
def test_keys_are_pressed_with_a_stylus_that_is_0_8_mm_higher(seed: int) -> None:
    robot = shifted(prepared(seed), 0.8)
    for number, name in enumerate(KEYS):
        result, acted = press(robot, name)
        assert result.outcome is Outcome.REACHED and result.touch in (Felt.PRESSED, Felt.TOUCHED), result
        assert acted == [name]
        if not number:
            details = dict(result.details)
            assert details["finding"] == "stylus_offset" and "mm higher than its readings" in result.reason
            assert abs(float(details["finding_m"]) - 0.0008) < 0.0002


@pytest.mark.timeout(480)
@pytest.mark.parametrize("seed", SEEDS)
def test_nothing_is_claimed_with_a_stylus_that_is_2_2_mm_higher(seed: int) -> None:
    robot = shifted(prepared(seed), 2.2)
    for name in KEYS:
        result, acted = press(robot, name)
        assert result.outcome is Outcome.ABORTED and result.touch is Felt.NOT_TOUCHED, result
        assert result.code == "stylus_offset" and acted == []


@pytest.mark.timeout(480)
@pytest.mark.parametrize("seed", SEEDS)
def test_keys_that_act_at_1_2_of_2_5_mm_are_pressed(seed: int) -> None:
    robot = prepared(seed, keys__plain__travel_mm=2.5, keys__plain__actuation_mm=1.2, keys__plain__release_mm=0.6)
    for name in KEYS:
        result, acted = press(robot, name)
        assert result.outcome is Outcome.REACHED and result.touch in (Felt.PRESSED, Felt.TOUCHED), result
        assert acted == [name]


@pytest.mark.timeout(480)
@pytest.mark.parametrize("kind", ["dome", "silicone", "membrane"])
def test_keys_that_push_back_are_pressed(kind: str) -> None:
    robot = prepared(4, keys__kind=kind)
    for name in KEYS:
        result, acted = press(robot, name)
        assert result.outcome is Outcome.REACHED and result.touch in (Felt.PRESSED, Felt.TOUCHED), result
        assert acted == [name]


@pytest.mark.timeout(480)
def test_a_key_that_is_too_stiff_is_touched_and_not_pressed() -> None:
    robot = prepared(5, keys__kind="rocker")
    for name in KEYS:
        result, acted = press(robot, name)
        assert acted == [] and result.touch is Felt.TOUCHED, result


@pytest.mark.timeout(480)
def test_a_panel_that_was_lowered_unseen_is_not_pressed() -> None:
    """The ball follows its drive to the end, so nothing is there."""
    robot = prepared(6)
    robot.renderer.follow_panel = lambda panel_from: None  # type: ignore[method-assign]  # pictures show it as it was
    seen = robot.bench.panel_from
    robot.bench.panel_from = dataclasses.replace(seen, translation=seen.translation - (0.0, 0.0, 0.008))
    for name in KEYS[:2]:
        result, acted = press(robot, name)
        assert result.outcome is Outcome.ABORTED and result.touch is Felt.NOT_TOUCHED, result
        assert result.code == "not_touched" and acted == []


@pytest.mark.timeout(480)
def test_the_switch_in_the_stylus_is_evidence() -> None:
    print("seed 5")
    switch = {"stylus.switch.enabled": True, "keys.kind": "dome"}
    robot = VirtualRobot(5, bench=switch, driver={"probe": "stylus_switch"})
    robot.prepare(calibrate=False)
    result, acted = press(robot, "RUN_STOP")
    assert result.touch is Felt.PRESSED and acted == ["RUN_STOP"]
    assert set(dict(result.details)["evidence"].split()) >= {"lag", "switch", "effect"}


@pytest.mark.timeout(480)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_presses_of_a_sound_machine_are_all_felt(layout: str) -> None:
    robot = prepared(7, layout)
    names = [control.name for control in robot.layout.controls if control.kind == "button"]
    times = []
    for number in range(14):
        name = names[number % len(names)]
        result, acted = press(robot, name)
        assert result.outcome is Outcome.REACHED and result.touch in (Felt.PRESSED, Felt.TOUCHED), result
        assert acted == [name] and result.error_m < 0.00025
        times.append(result.duration_s)
    print(f"seconds of a press: {sorted(times)}")
    assert sorted(times)[len(times) // 2] < 4.6, "a press took 3.2 s (median) before it was felt"
