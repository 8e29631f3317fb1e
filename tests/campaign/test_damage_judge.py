"""The judge of the damage campaign finds each kind of wrong; the record that it reads is the board's own motion."""

from __future__ import annotations

import math
import random
from itertools import pairwise

import pytest
from campaign.damage import CONFIG
from campaign.damage_judge import HARMLESS, REPORTED, STOPPED, WRONG, Judge
from campaign.damage_phases import scene_of, touch
from campaign.damage_rig import TO_BOARD, DamageRig, Goal, Plan, Point, Story
from campaign.truth import Vertex

PANEL = 20.0
HOVER, PRESSED = (100.0, 50.0, 12.0), (100.0, 50.0, 21.0)


def story(*, reached: bool = True, way: tuple[Point, ...] = (HOVER, PRESSED), feed: float = 10.0) -> Story:
    """Return one goal, sent at 1 s and answered at 9 s."""
    goal = Goal(Plan(list(way), [0.0] + [feed] * (len(way) - 1)), 1.0, 9.0, reached)
    return Story(goals=[goal], panel_mm=PANEL, told=[] if reached else ["aborted: the board left the path"])


def track(*places: Point, feed: float = 10.0) -> list[Vertex]:
    """Return the record of a stylus that rests at the first place until 2 s and then goes along at one speed."""
    first, t = places[0], 2.0
    vertices = [Vertex(0.0, *first, 0.0), Vertex(t, *first, 0.0)]
    for before, place in pairwise(places):
        t += math.dist(before, place) / feed
        vertices += [vertices[-1]._replace(speed=feed), Vertex(t, *place, feed)]
    return [*vertices, vertices[-1]._replace(t=20.0, speed=0.0)]


def test_a_touch_as_planned_is_harmless() -> None:
    judge = Judge(story(), track(HOVER, PRESSED))
    assert (judge.verdict(), judge.wrong, judge.deviated) == (HARMLESS, [], [])


def test_a_stop_on_the_path_is_reported_and_one_beside_it_stopped_in_time() -> None:
    told = story(reached=False)
    told.goals[0].answered = 2.5
    assert Judge(told, track(HOVER, (100.0, 50.0, 15.0), (100.0, 50.0, 0.0))).verdict() == REPORTED
    beside = HOVER, (101.0, 50.0, 12.0), (101.0, 50.0, 0.0)
    assert Judge(story(reached=False), track(*beside)).verdict() == STOPPED


@pytest.mark.parametrize(
    ("places", "feed", "found"),
    [
        ([HOVER], 10.0, "goal 1 reached, but 9.00 mm from its end"),
        ([HOVER, (103.5, 50.0, 12.0), (103.5, 50.0, 21.0)], 10.0, "contact off the control (goal 1): 3.5 mm from it"),
        ([HOVER, (100.0, 50.0, 21.6)], 10.0, "deeper than planned (goal 1) by 0.60 mm"),
        ([HOVER, PRESSED], 40.0, "too fast for 0.23 s: 40 mm/s where 11 are planned"),
    ],
)
def test_each_kind_of_wrong_is_found(places: list[Point], feed: float, found: str) -> None:
    judge = Judge(story(), track(*places, feed=feed))
    assert judge.verdict() == WRONG
    assert any(text.startswith(found) for text in judge.wrong), judge.wrong


def test_a_short_excess_of_speed_is_a_deviation_and_not_wrong() -> None:
    judge = Judge(story(reached=False), track(HOVER, (100.0, 50.0, 15.0), feed=40.0))
    assert judge.wrong == [] and judge.deviated[0].startswith("40 mm/s where 11 are planned")
    assert judge.verdict() == STOPPED


def test_a_touch_that_was_left_out_is_a_false_reached_though_the_end_is_right() -> None:
    up = (100.0, 50.0, 0.0)
    way = (up, PRESSED, up, (140.0, 50.0, 0.0), (140.0, 50.0, 21.0), (140.0, 50.0, 0.0))
    judge = Judge(story(way=way, feed=30.0), track(up, PRESSED, up, (140.0, 50.0, 0.0), feed=30.0))
    assert judge.wrong == ["goal 1 reached, but never at (140.00, 50.00, 21.00) mm"]
    assert Judge(story(way=way, feed=30.0), track(*way, feed=30.0)).wrong == []


def test_a_position_where_the_stylus_has_not_been_is_impossible() -> None:
    for off, wrong in ((0.05, 0), (0.2, 1)):
        told = story()
        told.positions = [(1.5, (100.0 + off, 50.0, 12.0))]
        assert len(Judge(told, track(HOVER, PRESSED)).wrong) == wrong
    told = story()
    told.positions = [(2.3, (100.0, 50.0, 13.0)), (2.45, (100.0, 50.0, 20.0))]
    assert [text[:40] for text in Judge(told, track(HOVER, PRESSED)).wrong] == [
        "published (100.000, 50.000, 20.000), 3.5"
    ]


def test_motion_without_a_goal_is_wrong_when_nothing_is_said() -> None:
    idle = Story(panel_mm=PANEL)
    assert Judge(idle, track(HOVER, (110.0, 50.0, 12.0))).wrong[0].startswith("moved without a goal")
    assert Judge(idle, track((100.0, 50.0, 19.0), PRESSED)).wrong[0].startswith("contact off the control")


def test_the_record_has_each_leg_and_its_speed_also_between_the_reports() -> None:
    """The truth of a press: its deepest point, its speeds, and no gap longer than a leg."""
    rig = DamageRig(CONFIG, 0, None, TO_BOARD)
    assert rig.connected() and rig.homing()
    scene = scene_of(random.Random(1))
    rig.story.panel_mm = scene.panel
    begin = len(rig.track)
    assert touch(rig, scene)
    legs = rig.track[begin:]
    assert max(vertex.e for vertex in legs) == pytest.approx(scene.pressed, abs=0.01)
    assert max(vertex.speed for vertex in legs) == pytest.approx(180.0, abs=0.5)
    for before, after in pairwise(legs):
        if not (length := math.dist(before[1:4], after[1:4])):
            continue  # a rest, and the time until the first motor step after it
        time_s = after.t - before.t
        assert length == pytest.approx(time_s * (before.speed + after.speed) / 2, abs=0.05), (before, after)
    judge = Judge(rig.story, rig.track)
    judge.check_end(rig)
    assert (judge.verdict(), judge.wrong, judge.deviated) == (HARMLESS, [], [])


def test_a_false_belief_at_the_end_is_wrong() -> None:
    rig = DamageRig(CONFIG, 0, None, TO_BOARD)
    assert rig.connected() and rig.homing()
    rig.mock.mechanics.motor[0] += 80
    rig.run_for(1.0)
    judge = Judge(rig.story, rig.track)
    judge.check_end(rig)
    assert any(text.startswith("false belief: (0.00, 0.00") for text in judge.wrong), judge.wrong
