"""The guard's plane: when it counts as known, what is reported of it, and the path that a motion becomes."""

from __future__ import annotations

import dataclasses
import re

import pytest

from gantry_driver.core.configuration.envelope_config import EnvelopeConfig
from gantry_driver.core.configuration.machine_config import DriverConfig, StylusConfig
from gantry_driver.core.envelope.keeper import JUMP_M, Envelope, path_of
from gantry_driver.core.envelope.plane import FARTHEST_M, MAX_SLOPE, PanelPlane, plane_of
from gantry_driver.core.envelope.rules import EnvelopeFault
from gantry_driver.core.grbl.trajectory_gcode import StraightMove, StylusOrder, TrajectoryMotion
from icu_common.core.goals.intent import Intent

CONFIG = DriverConfig()
SERVO = DriverConfig(stylus=StylusConfig(kind="servo_m3", stroke_m=0.018))
FACE_M = 0.035
PLANE = PanelPlane(at_m=(0.18, 0.11, FACE_M), slope=(0.0, 0.0), covariance=(1e-8, 0, 0, 0, 0, 0, 0, 0, 0))
HOME_MM = CONFIG.machine.homed_mpos_mm()


def at(extension_m: float = FACE_M, sigma_m: float = 1e-4, slope: tuple[float, float] = (0.0, 0.0)) -> PanelPlane:
    return PanelPlane(at_m=(0.0, 0.0, extension_m), slope=slope, covariance=(sigma_m**2, 0, 0, 0, 0, 0, 0, 0, 0))


def motion(*parts: StraightMove | StylusOrder) -> TrajectoryMotion:
    return TrajectoryMotion(parts=parts, start_mm=HOME_MM, end_mm=HOME_MM, end_m=(0.0, 0.0, 0.0), seconds=1.0)


def move(x_m: float, y_m: float, e_m: float, axes: int = 3) -> StraightMove:
    end_mm = (HOME_MM[0] + 1000 * x_m, HOME_MM[1] + 1000 * y_m, HOME_MM[2] - 1000 * e_m)
    values = {"axes": axes, "end_mm": end_mm}
    names = {field.name: field for field in dataclasses.fields(StraightMove)}
    rest = {n: 1000.0 for n, f in names.items() if n not in values and f.default is dataclasses.MISSING}
    return StraightMove(**values, **rest)  # type: ignore[arg-type]


def test_the_path_of_a_z_axis_has_all_three_readings() -> None:
    path = path_of(motion(move(0.1, 0.1, 0.0), move(0.1, 0.1, 0.03)), (0.0, 0.0, 0.0), CONFIG)
    assert path == [(0.0, 0.0, 0.0), pytest.approx((0.1, 0.1, 0.0)), pytest.approx((0.1, 0.1, 0.03))]


def test_a_move_without_z_keeps_the_extension() -> None:
    path = path_of(motion(move(0.1, 0.1, 0.0, axes=2)), (0.0, 0.0, 0.02), CONFIG)
    assert path[-1] == pytest.approx((0.1, 0.1, 0.02))


def test_a_servo_s_order_is_its_stroke_where_it_stands() -> None:
    parts = (move(0.1, 0.1, 0.0, axes=2), StylusOrder(down=True), move(0.12, 0.1, 0.0, axes=2), StylusOrder(down=False))
    path = path_of(motion(*parts), (0.0, 0.0, 0.0), SERVO)
    assert [round(e, 6) for _, _, e in path] == [0.0, 0.0, 0.018, 0.018, 0.0]
    assert path[2][:2] == pytest.approx((0.1, 0.1)) and path[-1][:2] == pytest.approx((0.12, 0.1))


def test_a_first_plane_that_is_uncertain_is_unknown_without_a_word() -> None:
    envelope, down = Envelope(), motion(move(0.0, 0.0, 0.03))
    assert envelope.take(at(sigma_m=0.0006), 0.0, CONFIG) == ""
    found = envelope.breach(down, (0.0, 0.0, 0.0), Intent.PRESS, CONFIG, 0.0)
    assert found is not None and found.code is EnvelopeFault.NO_PANEL


def test_a_plane_as_uncertain_as_allowed_is_known_and_a_little_more_is_not() -> None:
    limit = CONFIG.envelope.max_sigma_m
    for sigma, known in ((limit * 0.999, True), (limit * 1.001, False)):
        envelope = Envelope()
        envelope.take(at(sigma_m=sigma), 0.0, CONFIG)
        assert (envelope.breach(motion(move(0, 0, 0.03)), (0, 0, 0), Intent.PRESS, CONFIG, 0.0) is None) is known


def test_a_known_plane_that_becomes_uncertain_is_reported_with_value_and_limit() -> None:
    envelope = Envelope()
    assert envelope.take(at(), 0.0, CONFIG) == ""
    text = envelope.take(at(sigma_m=0.0007), 1.0, CONFIG)
    assert text == "the panel's plane counts as unknown: its standard deviation is 0.70 mm (limit 0.5 mm)"
    assert envelope.take(at(FACE_M + 0.01), 2.0, CONFIG) == "", "no plane is known that could have moved"


def test_the_sigma_is_that_at_the_plane_s_own_place() -> None:
    sure_there = dataclasses.replace(PLANE, covariance=(1e-8, 0, 0, 0, 1e-3, 0, 0, 0, 1e-3))
    envelope = Envelope()
    envelope.take(sure_there, 0.0, CONFIG)
    straight = motion(move(0.18, 0.11, 0.03))
    assert envelope.breach(straight, (0.18, 0.11, 0.0), Intent.PRESS, CONFIG, 0.0) is None


@pytest.mark.parametrize(
    ("after", "said"),
    [
        (at(FACE_M + JUMP_M - 1e-5), ""),
        (at(FACE_M + JUMP_M + 1e-4), "by up to 2.1 mm"),
        (at(FACE_M - JUMP_M - 1e-4), "by up to 2.1 mm"),
        (at(slope=(0.01, 0.0)), "by up to 3.6 mm"),
        (at(slope=(0.0, 0.01)), "by up to 2.2 mm"),
        (at(slope=(-0.01, -0.01)), "by up to 5.8 mm"),
    ],
)
def test_a_plane_that_moves_within_the_travel_is_reported(after: PanelPlane, said: str) -> None:
    envelope = Envelope()
    envelope.take(at(), 0.0, CONFIG)
    text = envelope.take(after, 1.0, CONFIG)
    assert text == (f"the panel's plane has moved {said} within the travel" if said else "")


def test_a_motion_within_three_sigmas_of_both_planes_is_scatter() -> None:
    for sigma, text in ((0.00042, ""), (0.0003, "the panel's plane has moved by up to 2.5 mm within the travel")):
        envelope = Envelope()
        envelope.take(at(sigma_m=sigma), 0.0, CONFIG)
        assert envelope.take(at(FACE_M + 0.0025, sigma_m=sigma), 1.0, CONFIG) == text


def test_the_plane_is_old_after_its_limit_and_says_so_only_where_it_is_needed() -> None:
    envelope, limit = Envelope(), CONFIG.envelope.max_age_s
    envelope.take(at(), 10.0, CONFIG)
    deep, shallow, across = motion(move(0, 0, 0.03)), motion(move(0, 0, 0.01)), motion(move(0.1, 0, 0.01))
    assert envelope.breach(deep, (0, 0, 0), Intent.PRESS, CONFIG, 10.0 + limit) is None
    late = 10.5 + limit
    found = envelope.breach(deep, (0, 0, 0), Intent.PRESS, CONFIG, late)
    assert found is not None and found.code is EnvelopeFault.OLD_PANEL
    assert (found.measured, found.limit) == (pytest.approx(limit + 0.5), limit)
    assert found.place == pytest.approx((0.0, 0.0, 0.03)) and str(found.code) == "old_panel"
    assert envelope.breach(shallow, (0, 0, 0), Intent.PRESS, CONFIG, late) is None
    aside = envelope.breach(across, (0, 0, 0.01), Intent.PRESS, CONFIG, late)
    assert aside is not None and aside.code is EnvelopeFault.SIDEWAYS


def exact(limit_s: float = 60.0) -> DriverConfig:
    """Return a configuration whose limits are sums of powers of two, so that no rounding hides a boundary."""
    return DriverConfig(envelope=EnvelopeConfig(max_sigma_m=2.0**-10, max_age_s=limit_s))


def test_a_plane_exactly_as_uncertain_as_allowed_is_known() -> None:
    envelope, config = Envelope(), exact()
    envelope.take(at(sigma_m=2.0**-10), 0.0, config)
    assert envelope.breach(motion(move(0, 0, 0.03)), (0, 0, 0), Intent.PRESS, config, 0.0) is None


def test_a_motion_of_exactly_three_sigmas_of_both_planes_is_scatter() -> None:
    envelope, config, sigma = Envelope(), exact(), 2.0**-11
    envelope.take(at(2.0**-5, sigma_m=sigma), 0.0, config)
    assert envelope.take(at(2.0**-5 + 6.0 * sigma, sigma_m=sigma), 1.0, config) == ""


def test_a_first_plane_has_moved_from_nowhere_and_one_of_a_jump_s_size_is_reported() -> None:
    assert JUMP_M == 0.002
    envelope = Envelope()
    assert envelope.take(at(0.05), 0.0, CONFIG) == ""


def test_large_values_are_told_in_millimetres_as_well() -> None:
    envelope = Envelope()
    envelope.take(at(0.9), 0.0, CONFIG)
    assert envelope.take(at(0.1), 1.0, CONFIG) == "the panel's plane has moved by up to 800.0 mm within the travel"
    text = envelope.take(at(sigma_m=0.8), 2.0, CONFIG)
    assert text == "the panel's plane counts as unknown: its standard deviation is 800.00 mm (limit 0.5 mm)"


# --- the plane itself -------------------------------------------------------------------------------------------------


def values(**changes: object) -> dict[str, object]:
    return {"at_m": (0.1, 0.1, 0.03), "slope": (0.1, 0.0), "covariance": (1e-8,) * 9, **changes}


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"at_m": (0.1, 0.1)}, "a plane has 3 readings"),
        ({"at_m": (0.1, 0.1, 0.03, 0.0)}, "a plane has 3 readings"),
        ({"slope": (0.1, 0.0, 0.0)}, "2 slopes"),
        ({"covariance": (1e-8,) * 10}, "9 covariances"),
        ({"slope": (0.1,)}, "2 slopes"),
        ({"covariance": (1e-8,) * 8}, "9 covariances"),
        ({"at_m": (0.1, 0.1, float("nan"))}, "not finite"),
        ({"slope": (float("inf"), 0.0)}, "not finite"),
        ({"covariance": (float("nan"), *(1e-8,) * 8)}, "not finite"),
        ({"at_m": (0.1, 0.1, -1.001)}, "no panel's"),
        ({"at_m": (1.001, 0.1, 0.1)}, "no panel's"),
        ({"slope": (0.22, 0.22)}, "no panel's"),
        ({"covariance": (-1e-12, *(1e-8,) * 8)}, "below zero"),
        ({"covariance": (*(1e-8,) * 4, -1e-12, *(1e-8,) * 4)}, "below zero"),
        ({"covariance": (*(1e-8,) * 8, -1e-12)}, "below zero"),
    ],
)
def test_what_no_panel_has_is_no_plane(changes: dict[str, object], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        plane_of(values(**changes))


@pytest.mark.parametrize(
    "changes",
    [
        {"at_m": (FARTHEST_M, -FARTHEST_M, FARTHEST_M)},
        {"slope": (MAX_SLOPE, 0.0)},
        {"slope": (0.2, 0.2)},
        {"covariance": (0.0,) * 9},
        {"covariance": (1e-8, -1e-9, *(1e-8,) * 7)},
    ],
)
def test_the_edge_of_what_a_panel_has_is_a_plane(changes: dict[str, object]) -> None:
    assert plane_of(plane_of(values(**changes)).values()) == plane_of(values(**changes))


def test_contact_and_sigma_follow_from_place_and_slope() -> None:
    plane = plane_of(values(slope=(0.1, -0.2), covariance=(4e-8, 1e-8, 2e-8, 1e-8, 9e-8, 3e-8, 2e-8, 3e-8, 16e-8)))
    assert plane.contact_m(0.2, 0.3) == pytest.approx(0.03 + 0.1 * 0.1 - 0.2 * 0.2)
    dx, dy = 0.1, 0.2
    variance = 4e-8 + dx * dx * 9e-8 + dy * dy * 16e-8 + 2 * (dx * 1e-8 + dy * 2e-8 + dx * dy * 3e-8)
    assert plane.sigma_m(0.2, 0.3) == pytest.approx(variance**0.5)


def test_a_covariance_that_gives_less_than_none_is_none() -> None:
    plane = plane_of(values(covariance=(1e-8, -1e-6, 0.0, -1e-6, 1e-8, 0.0, 0.0, 0.0, 1e-8)))
    assert plane.sigma_m(0.3, 0.1) == 0.0


def test_the_limits_of_a_believed_plane_are_these() -> None:
    assert (FARTHEST_M, MAX_SLOPE) == (1.0, 0.3)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"slope": (0.1,)}, "a plane has 3 readings, 2 slopes and 9 covariances"),
        ({"at_m": (0.1, 0.1, float("inf"))}, "the plane at (0.1, 0.1, inf) m is not finite"),
        (
            {"slope": (0.25, 0.25)},
            "the plane at (0.1, 0.1, 0.03) m with slopes (0.25, 0.25) is no panel's (limits 1 m and 0.3)",
        ),
        (
            {"covariance": (-1.0, *(0.0,) * 8)},
            "a variance is below zero: (-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)",
        ),
    ],
)
def test_what_is_no_plane_is_refused_with_its_values(changes: dict[str, object], text: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        plane_of(values(**changes))


def test_a_plane_cannot_change_in_place() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        PLANE.slope = (0.1, 0.1)  # type: ignore[misc]


@pytest.mark.parametrize(("x", "y", "contact_m"), [(0.2, 0.3, 0.03), (0.3, 0.3, 0.04), (0.2, 0.4, 0.01)])
def test_a_plane_rises_from_its_own_position_along_each_axis(x: float, y: float, contact_m: float) -> None:
    plane = PanelPlane(at_m=(0.2, 0.3, 0.03), slope=(0.1, -0.2), covariance=9 * (0.0,))
    assert plane.contact_m(x, y) == pytest.approx(contact_m)
