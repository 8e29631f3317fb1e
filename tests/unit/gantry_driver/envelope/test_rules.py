"""The space that paths may use: examples, and seeded paths against an oracle that looks at each tenth of a mm."""

from __future__ import annotations

import dataclasses
import itertools
import math
import random

import pytest

from gantry_driver.core.configuration.envelope_config import EnvelopeConfig
from gantry_driver.core.configuration.machine_config import DriverConfig, StylusConfig
from gantry_driver.core.envelope.plane import PanelPlane, plane_of
from gantry_driver.core.envelope.rules import STRAIGHT_M, Breach, EnvelopeFault, Reading, breach_of, depth_limit_m
from icu_common.core.goals.intent import Intent

CONFIG = DriverConfig()
FREE_M, CROSS_M, SIDE_M = (
    CONFIG.envelope.free_space_m,
    CONFIG.envelope.crossing_m,
    CONFIG.envelope.side_height_m,
)
SURE = (1e-10, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
FLAT = PanelPlane(at_m=(0.18, 0.11, 0.035), slope=(0.0, 0.0), covariance=SURE)
UP, DOWN, HOVER = (0.1, 0.1, 0.0), (0.1, 0.1, 0.036), (0.1, 0.1, 0.027)


def breach(*path: Reading, intent: Intent = Intent.PRESS, plane: PanelPlane | None = FLAT) -> Breach | None:
    return breach_of(path, plane, intent, CONFIG)


def code(*path: Reading, intent: Intent = Intent.PRESS, plane: PanelPlane | None = FLAT) -> str:
    found = breach(*path, intent=intent, plane=plane)
    return "" if found is None else found.code.value


def test_without_a_plane_only_the_free_space_and_the_way_up_are_allowed() -> None:
    assert code(UP, (0.3, 0.2, CROSS_M), (0.0, 0.0, CROSS_M), plane=None) == ""
    assert code(UP, (0.1, 0.1, FREE_M), (0.104, 0.1, FREE_M), plane=None) == ""
    assert code(UP, (0.1, 0.1, CROSS_M + 0.001), (0.11, 0.1, CROSS_M + 0.001), plane=None) == "sideways"
    assert code(UP, (0.1, 0.1, FREE_M), (0.2, 0.1, FREE_M), plane=None, intent=Intent.DRAG) == "sideways"
    assert code(UP, (0.1, 0.1, FREE_M + 0.001), plane=None) == "no_panel"
    assert code(DOWN, (0.1, 0.1, 0.02), UP, (0.3, 0.1, 0.0), plane=None) == "", "a stylus left down may rise"
    assert code(DOWN, (0.3, 0.1, 0.036), plane=None) == "no_panel"
    assert code(DOWN, (0.3, 0.1, 0.0), plane=None) == "no_panel", "it rises, but not straight"
    assert code((0.1, 0.1, FREE_M), (0.3, 0.1, 0.0), plane=None) == "sideways"
    drift = [(0.1 + 0.0001 * step, 0.1, 0.036) for step in range(10)]
    assert code(*drift, plane=None) == "no_panel", "steps that are too small to count add up"


@pytest.mark.parametrize("intent", Intent)
def test_a_straight_press_is_allowed_as_deep_as_the_travel_of_its_intent(intent: Intent) -> None:
    limit_m = depth_limit_m(FLAT, 0.1, 0.1, intent, CONFIG)
    travel_m = 0.0 if intent is Intent.MOVE else CONFIG.overtravel_m
    assert limit_m == pytest.approx(travel_m, abs=1e-4)
    assert code(UP, (0.1, 0.1, 0.035 + limit_m - 1e-6), UP, intent=intent) == ""
    found = breach(UP, (0.1, 0.1, 0.035 + limit_m + 1e-5), intent=intent)
    assert found is not None and found.code is EnvelopeFault.TOO_DEEP
    assert found.measured == pytest.approx(limit_m + 1e-5) and found.limit == pytest.approx(limit_m)


def test_full_extension_and_then_sideways_is_refused_at_its_first_point_and_said_with_values() -> None:
    found = breach(UP, (0.1, 0.1, 0.059), (0.258, 0.1, 0.059))
    assert found is not None and found.text() == "the path goes 24.0 mm beyond the panel (limit 1.1 mm)"
    assert found.details() == (
        ("measured_m", "0.02400"),
        ("limit_m", "0.00108"),
        ("reading_m", "0.10000 0.10000 0.05900"),
    )


@pytest.mark.parametrize(
    ("intent", "expected"), [("move", "sideways"), ("press", "sideways"), ("turn", ""), ("drag", "")]
)
def test_sideways_in_contact_is_for_turns_and_drags(intent: str, expected: str) -> None:
    start = (0.1, 0.1, 0.035)
    assert code(start, (0.15, 0.1, 0.035), (0.15, 0.1, 0.0), intent=Intent(intent)) == expected
    assert code(start, (0.105, 0.1, 0.035), intent=Intent(intent)) == ("too_low" if expected else "")


def test_a_correction_is_allowed_above_the_panel_and_no_farther() -> None:
    assert code(HOVER, (0.1045, 0.1045, 0.027), (0.1035, 0.1035, 0.027), intent=Intent.MOVE) == ""
    assert code(HOVER, (0.11, 0.1, 0.027), intent=Intent.MOVE) == "sideways"
    there_and_on = [(0.1 + 0.002 * step, 0.1, 0.027) for step in range(10)]
    assert code(*there_and_on, intent=Intent.MOVE) == "sideways", "steps add up"
    low = 0.035 - SIDE_M + 1e-4
    assert code((0.1, 0.1, low), (0.102, 0.1, low), intent=Intent.MOVE) == "too_low"
    assert code(UP, (0.102, 0.1, low)) == "too_low", "aslant"


def test_a_leaning_panel_is_followed_where_it_is() -> None:
    leaning = dataclasses.replace(FLAT, slope=(0.05, 0.0))
    near, far = leaning.contact_m(0.05, 0.1), leaning.contact_m(0.3, 0.1)
    assert far - near == pytest.approx(0.0125)
    assert code((0.3, 0.1, 0.0), (0.3, 0.1, far), intent=Intent.MOVE, plane=leaning) == ""
    assert code((0.05, 0.1, 0.0), (0.05, 0.1, far), intent=Intent.MOVE, plane=leaning) == "too_deep"


def test_three_deviations_of_the_plane_are_allowed_and_no_more_than_of_one_that_counts_as_known() -> None:
    def limit(sigma: float, x: float = 0.18, slope_sigma: float = 0.0) -> float:
        covariance = (sigma**2, 0.0, 0.0, 0.0, slope_sigma**2, 0.0, 0.0, 0.0, 0.0)
        return depth_limit_m(dataclasses.replace(FLAT, covariance=covariance), x, 0.11, Intent.MOVE, CONFIG)

    assert limit(0.0002) - limit(0.0) == pytest.approx(0.0006)
    assert limit(0.0, 0.28, 0.003) - limit(0.0) == pytest.approx(0.0009), "a slope counts with the distance"
    assert limit(0.1) - limit(0.0) == pytest.approx(0.0015)


def test_a_stylus_with_two_positions_goes_down_at_a_known_panel_and_moves_sideways_only_to_turn_or_drag() -> None:
    config = DriverConfig(stylus=StylusConfig(kind="solenoid_m8", stroke_m=0.04))
    down = (0.1, 0.1, 0.04)
    assert breach_of([UP, down, UP], FLAT, Intent.PRESS, config) is None
    aside = breach_of([UP, down, (0.2, 0.1, 0.04)], FLAT, Intent.PRESS, config)
    assert aside is not None and aside.code is EnvelopeFault.SIDEWAYS
    assert breach_of([UP, down, (0.2, 0.1, 0.04)], FLAT, Intent.DRAG, config) is None
    unknown = breach_of([UP, down], None, Intent.PRESS, config)
    assert unknown is not None and unknown.code is EnvelopeFault.NO_PANEL


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("at_m", (0.1, math.nan, 0.03)),
        ("at_m", (0.1, 0.1, 1.5)),
        ("slope", (0.4, 0.0)),
        ("slope", (math.inf, 0.0)),
        ("covariance", (-1e-9, *SURE[1:])),
        ("covariance", SURE[:8]),
    ],
)
def test_what_is_no_panel_is_no_plane(field: str, value: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match=r"plane|variance"):
        plane_of({**FLAT.values(), field: value})
    assert plane_of(FLAT.values()) == FLAT


def random_plane(rng: random.Random) -> PanelPlane:
    spread = [rng.uniform(0.0, 0.0003), rng.uniform(0.0, 0.001), rng.uniform(0.0, 0.001)]
    covariance = [0.0] * 9
    covariance[::4] = [sigma**2 for sigma in spread]
    slope = (rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1))
    return PanelPlane(at_m=(0.18, 0.11, rng.uniform(0.03, 0.05)), slope=slope, covariance=tuple(covariance))


def random_path(rng: random.Random, plane: PanelPlane) -> list[Reading]:
    """Return a path that is often near a limit: at free space, at hover, in contact, and deeper."""
    x, y = rng.uniform(0.05, 0.3), rng.uniform(0.05, 0.17)
    path = [(x, y, rng.choice([0.0, CROSS_M, FREE_M, plane.contact_m(x, y)]))]
    for _ in range(rng.randint(1, 5)):
        step = rng.choice([0.0, 0.0, 1e-4, 0.003, 0.05])
        angle = rng.uniform(0.0, 2.0 * math.pi)
        x = min(max(x + step * math.cos(angle), 0.0), 0.359)
        y = min(max(y + step * math.sin(angle), 0.0), 0.219)
        near = plane.contact_m(x, y) + rng.choice([-0.02, -0.008, -SIDE_M, 0.0, 0.001, 0.003])
        path.append(
            (x, y, max(0.0, rng.choice([0.0, CROSS_M, FREE_M, near, near + rng.gauss(0.0, 5e-4), path[-1][2]])))
        )
    return path


def dense(path: list[Reading]) -> list[Reading]:
    points = [path[0]]
    for begin, end in itertools.pairwise(path):
        count = max(1, math.ceil(math.dist(begin, end) / 1e-4))
        points += [tuple(a + (b - a) * n / count for a, b in zip(begin, end)) for n in range(1, count + 1)]  # type: ignore[misc]
    return points


def test_no_point_of_an_allowed_path_is_where_it_must_not_be() -> None:
    rng, allowed, refused = random.Random(44), 0, 0
    for _ in range(3000):
        plane, intent = random_plane(rng), rng.choice(list(Intent))
        known = plane if rng.random() < 0.8 else None
        path = random_path(rng, plane)
        if breach_of(path, known, intent, CONFIG) is not None:
            refused += 1
            continue
        allowed += 1
        deepest_m, run = 0.0, []
        for begin, end in itertools.pairwise(dense(path)):
            extended = max(begin[2], end[2]) > CROSS_M + 6e-5
            run = (run or [begin]) if extended else []
            aside = math.dist((run or [begin])[0][:2], end[:2])
            if aside <= STRAIGHT_M and end[2] <= begin[2] + 1e-12:
                continue  # up from where it was
            draws = known is not None and intent in (Intent.TURN, Intent.DRAG)
            assert not extended or draws or aside <= CONFIG.envelope.correction_m + 1e-9
            if known is None:
                assert end[2] <= FREE_M + 6e-5
                continue
            beyond = end[2] - plane.contact_m(*end[:2])
            deepest_m = max(deepest_m, beyond - (0.0 if intent is Intent.MOVE else CONFIG.overtravel_m))
            assert draws or aside <= STRAIGHT_M or -beyond >= SIDE_M - 1e-9
        # Three deviations of a plane that counts as known, its rise over a correction, and rounding.
        assert deepest_m <= 3.0 * CONFIG.envelope.max_sigma_m + 0.15 * CONFIG.envelope.correction_m + 6e-5
    assert allowed > 300 and refused > 300, (allowed, refused)


def test_every_limit_has_a_bound_that_keeps_it_near_its_purpose() -> None:
    for name, most in (("free_space_m", 0.2), ("correction_m", 0.05), ("max_sigma_m", 0.001), ("max_age_s", 600.0)):
        with pytest.raises(ValueError, match=f"{name} = .* is above its maximum"):
            EnvelopeConfig(**{name: 1.01 * most})
