"""Looks at the tip, and what is made of them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gantry_driver.core.goals.servo import Look, contact_fault, judge
from gantry_driver.core.job.controller_config import ControllerConfig
from gantry_driver.core.job.goal_job import Aim, Fault
from icu_common.core.geometry.geometry import Array, Transform

CONFIG = ControllerConfig()
BASE_FROM_CAMERA = Transform(np.diag([1.0, -1.0, -1.0]), np.array([0.1, 0.2, 0.4]))
SPREAD_M = 0.0006


def looked(look: Look, *sightings: tuple[int, tuple[float, float, float]]) -> Look:
    """Return the look after sightings: the stamp of each, and the tip in base_link."""
    for stamp_ns, tip in sightings:
        look = look.with_tip(BASE_FROM_CAMERA.inverse().apply(np.array(tip)), stamp_ns)
    return look


def test_a_look_averages_the_last_pictures_of_its_time() -> None:
    look = looked(
        Look(after_ns=10, until_ns=20, needed=2, kept=2),
        (10, (9.0, 0.0, 0.0)),
        (11, (9.0, 0.0, 0.0)),
        (12, (0.0001, 0.0, 0.01)),
        (20, (0.0003, 0.0, 0.02)),
        (21, (9.0, 0.0, 0.0)),
    )
    seen = look.seen(BASE_FROM_CAMERA, SPREAD_M)
    assert seen is not None
    np.testing.assert_allclose(seen, [0.0002, 0.0, 0.015], atol=1e-12)


def test_a_look_is_not_done_while_too_few_agree_sideways() -> None:
    few = looked(Look(after_ns=0, needed=2, kept=4), (1, (0.0, 0.0, 0.0)))
    assert few.seen(BASE_FROM_CAMERA, SPREAD_M) is None
    assert few.unseen_text(SPREAD_M) == "the tip was seen 1 times, 2 times within 0.6 mm are needed"
    apart = looked(few, (2, (0.0, 0.0013, 0.0)))
    assert apart.seen(BASE_FROM_CAMERA, SPREAD_M) is None
    assert looked(few, (2, (0.0, 0.0011, 0.0))).seen(BASE_FROM_CAMERA, SPREAD_M) is not None
    assert few.seen(BASE_FROM_CAMERA, SPREAD_M) is None, "a look that goes on is another one"


@pytest.mark.parametrize(
    ("error_mm", "corrections", "verdict"),
    [
        ((0.04, 0.0, 0.0), 0, "touch"),
        ((0.06, 0.0, 0.0), 0, "correct"),
        ((0.49, 0.0, 0.0), 3, "touch"),
        ((0.0, 0.51, 0.0), 3, "the seen error is 0.51 mm after 3 corrections, 0.5 mm are allowed"),
        ((3.0, 4.1, -1.0), 0, "the tip is seen 5.08 mm beside and -1.00 mm above its place, 5 and 3 mm are allowed"),
        ((0.0, 0.0, 3.1), 0, "the tip is seen 0.00 mm beside and +3.10 mm above its place, 5 and 3 mm are allowed"),
    ],
)
def test_verdicts_at_their_bounds(error_mm: tuple[float, float, float], corrections: int, verdict: str) -> None:
    judged = judge(np.array(error_mm) / 1000, Aim(base_from_reading=np.eye(2), corrections=corrections), CONFIG)
    if isinstance(judged, Fault):
        assert judged.cause.startswith(verdict)
    else:
        assert ("touch" if judged is None else "correct") == verdict


def test_corrections_lead_a_machine_with_other_axes_to_the_target() -> None:
    target, true_axes = np.array([[0.2, 0.1, -0.03]]), np.array([[1.006, -0.004], [0.003, 0.995]])

    def error_of(aim: Aim) -> Array:
        x, y, extension = aim.readings_at(target)[0]
        return np.array([*(true_axes @ (x, y)), -extension]) - target[0]

    aim: Aim | Fault | None = Aim(base_from_reading=np.array([[0.998, 0.0], [0.001, 1.002]]))
    errors = []
    while isinstance(aim, Aim):
        last = aim
        errors.append(float(np.linalg.norm(error_of(aim))))
        aim = judge(error_of(aim), aim, CONFIG)
    assert aim is None
    assert last.corrections == 1
    assert errors[0] > 0.001
    assert errors[-1] < CONFIG.tolerance_m


def test_the_mean_of_all_looks_decides_and_not_the_last_one() -> None:
    """Looks scatter by more than the error that is left, so each of them alone corrects to another position."""
    aim = Aim(base_from_reading=np.eye(2)).looked(np.array([0.0003, 0.0]), 0.0003)
    assert judge(np.array([0.0003, 0.0, 0.0]), aim, CONFIG) is not None
    aim = aim.corrected(aim.rest()).looked(np.array([0.00008, 0.0]), 0.0003)
    np.testing.assert_allclose(aim.rest(), [0.00004, 0.0], atol=1e-12)
    assert judge(np.array([0.00008, 0.0, 0.0]), aim, CONFIG) is None
    moved = aim.looked(np.array([0.0, 0.0004]), 0.0003)
    np.testing.assert_allclose(moved.rest(), [0.0, 0.0004], atol=1e-12)
    assert moved.looks == 1, "looks before the tip has moved do not count"


def test_a_look_whose_distances_scatter_takes_more_images() -> None:
    look = Look(after_ns=0, needed=2, kept=4)
    for number, z in enumerate((0.4, 0.4002, 0.4001, 0.4003), start=1):
        look = look.with_tip(np.array([0.0, 0.0, z]), number)
        assert look.precise(0.00004) == (number == 4)
    even = Look(after_ns=0, needed=2, kept=4).with_tip(np.zeros(3), 1).with_tip(np.zeros(3), 2)
    assert even.precise(0.00004)


def test_errors_that_do_not_follow_the_corrections_end_it() -> None:
    error = np.array([0.003, 0.0, 0.0])
    first = judge(error, Aim(base_from_reading=np.diag([2.0, 1.0])), CONFIG)
    assert isinstance(first, Aim)
    np.testing.assert_allclose(first.correction, [-0.0015, 0.0])
    second = judge(error, first, CONFIG)
    assert isinstance(second, Fault)
    assert "add up to a correction by 6.00 mm, 5 mm are allowed" in second.cause


def test_a_touch_must_have_been_seen_in_its_place() -> None:
    look = Look(after_ns=0, needed=2, kept=4)
    unseen = math.nan
    assert contact_fault(0.0005, 0.003, look, CONFIG) is None
    above = contact_fault(0.0005, 0.0031, look, CONFIG)
    assert above is not None and above.cause.startswith("the tip was seen 3.1 mm above the surface")
    assert not above.tells_touch
    beside = contact_fault(0.0006, 0.0, look, CONFIG)
    assert beside == Fault(cause="touched 0.60 mm beside the target, 0.5 mm are allowed", tells_touch=True)
    blind = contact_fault(unseen, unseen, look, CONFIG)
    assert blind is not None and blind.tells_touch
    assert blind.cause.startswith("touched, but not measured: the tip was seen 0 times")
    assert contact_fault(unseen, unseen, look, ControllerConfig(require_servo=False)) is None
