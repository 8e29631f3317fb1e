"""Verdicts on damaged bytes: the judge compares the board's own record of the stylus with plans and answers."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from itertools import pairwise

from campaign.damage_rig import DamageRig, Goal, Plan, Point, Story
from campaign.truth import Vertex

HARMLESS, REPORTED, STOPPED, WRONG = "harmless", "reported", "stopped in time", "wrong"
VERDICTS = (HARMLESS, REPORTED, STOPPED, WRONG)

TUBE_MM = 0.5
"""Distance from the plan above which the stylus has deviated, and distance to a waypoint that counts as visited."""
END_MM = 0.15
"""Distance from the end of a reached goal: the arrival tolerance of 0.1 mm, and rounding."""
DEEPER_MM = 0.5
CONTROL_MM = 3.0
"""Radius around the planned contact within which the stylus is on its control."""
GRAZE_MM = 0.02
"""Extension beyond the panel from which a contact counts: more than a motor step."""
IN_CONTACT_MM, IN_THE_AIR_MM = 1.0, 10.0
"""Distance from the path above which a reached goal is a false one; in the air the stylus travels 7 mm in 40 ms."""
FEED_FACTOR, FEED_EXTRA_MM_S = 1.02, 0.5
NEAR_MM = 1.0
"""Distance from a segment within which its feed is allowed."""
TOO_FAST_S = 0.1
RETREAT_MM_S = 30.0
"""Speed of the retreat after a stop (stylus_feed_m_s)."""
SEEN_WITHIN_S = 0.3
"""Maximum age of a published position: a report interval, the wire, and a second report that confirms the first."""

BRAKING_S = 1.0
"""After the answer of a stop; what moves later, other than the stylus upwards, is wrong."""
STILL_MM, MOVING_MM, STRAYED_MM = 0.1, 0.5, 0.05
KIND_CHARACTERS = 10
"""Characters that findings of one kind have in common; each kind is noted once."""


class Judge:
    """The findings on one run: what is wrong, and where the stylus has deviated."""

    def __init__(self, story: Story, track: Sequence[Vertex]) -> None:
        self.story, self.track = story, track
        self._times = [vertex.t for vertex in self.track]
        self.wrong: list[str] = []
        self.deviated: list[str] = []
        self._check_goals()
        self._check_moves()
        self._check_positions()

    def verdict(self) -> str:
        if self.wrong:
            return WRONG
        if self.deviated and self.story.told:
            return STOPPED
        return REPORTED if self.story.told else HARMLESS

    # --- answers -----------------------------------------------------------------------------------------------------

    def _between(self, begin: float, end: float) -> list[Vertex]:
        """Return the vertices from the last one before ``begin`` to ``end``, and where the stylus was then."""
        first, after = max(bisect_left(self._times, begin) - 1, 0), bisect_left(self._times, end + 1e-9)
        vertices = list(self.track[first:after])
        if vertices and after < len(self.track) and (last := vertices[-1]).t < end:
            share = (end - last.t) / (self.track[after].t - last.t)
            vertices.append(Vertex(*(a + share * (b - a) for a, b in zip(last, self.track[after]))))
        return vertices

    def _check_goals(self) -> None:
        for number, goal in enumerate(self.story.goals, 1):
            vertices = self._between(goal.sent, goal.answered)
            off = _off_plan(vertices[1:], goal.plan)
            if off:
                far, where = max(off)
                self.deviated.append(f"goal {number}: {far:.2f} mm off its path at {_text(where)}")
            if goal.reached:
                self._check_reached(number, goal, vertices, off)

    def _check_reached(
        self, number: int, goal: Goal, vertices: Sequence[Vertex], off_plan: Sequence[tuple[float, Vertex]]
    ) -> None:
        end, last = goal.plan.points[-1], vertices[-1]
        if (off := math.dist(end, last[1:4])) > END_MM:
            self.wrong.append(f"goal {number} reached, but {off:.2f} mm from its end, at {_text(last)}")
        if missed := _missed(goal.plan, vertices, self.story.panel_mm):
            self.wrong.append(f"goal {number} reached, but never at {missed}")
        for off, vertex in off_plan:
            pressing = vertex.e > self.story.panel_mm + GRAZE_MM
            if off > (IN_CONTACT_MM if pressing else IN_THE_AIR_MM):
                self.wrong.append(f"goal {number} reached, but {off:.2f} mm off its path at {_text(vertex)}")
                break

    # --- motion ------------------------------------------------------------------------------------------------------

    def _check_moves(self) -> None:
        goals = self.story.goals
        number, over_s = -1, 0.0
        windows = [(window.begin, window.end + 0.1) for window in self.story.homings]
        touch = self.story.panel_mm + GRAZE_MM
        for before, after in pairwise(self.track):
            while number + 1 < len(goals) and goals[number + 1].sent < after.t - 1e-9:
                number += 1
            goal = goals[number] if number >= 0 else None
            homing = any(begin <= after.t and before.t <= end for begin, end in windows)
            for vertex in (before, after):
                if vertex.e > touch:
                    self._check_contact(vertex, goal, number + 1)
            if homing:
                over_s = 0.0
                continue
            if goal is None or before.t > goal.answered:
                self._check_unasked(before, after, goal)
            over_s = self._check_feed(before, after, goal, over_s)

    def _check_contact(self, at: Vertex, goal: Goal | None, number: int) -> None:
        """Compare a vertex at or below the panel with the contact that the goal plans."""
        panel = self.story.panel_mm
        aside = _from_contact(at, goal.plan, panel) if goal is not None else math.inf
        deepest = max(p[2] for p in goal.plan.points) if goal is not None else 0.0
        if aside > CONTROL_MM:
            self._once(f"contact off the control (goal {number}): {aside:.1f} mm from it, at {_text(at)}")
        elif at.e > deepest + DEEPER_MM:
            self._once(f"deeper than planned (goal {number}) by {at.e - deepest:.2f} mm, at {_text(at)}")

    def _check_unasked(self, before: Vertex, after: Vertex, goal: Goal | None) -> None:
        """Between goals nothing moves but what a stop does: braking, and the stylus upwards."""
        if goal is not None and not goal.reached and before.t < goal.answered + BRAKING_S:
            return
        moved = math.dist(before[1:4], after[1:4])
        lifted = math.dist(before[1:3], after[1:3]) < 0.01 and after.e < before.e
        if moved > STRAYED_MM and not (lifted and self.story.told):
            self.deviated.append(f"{moved:.2f} mm unasked, to {_text(after)}")
            if goal is not None and not goal.reached:
                self._once(f"moved after the answer: {_text(before)} to {_text(after)}")
            elif not self.story.told:
                self._once(f"moved without a goal, and nothing was said: {_text(before)} to {_text(after)}")

    def _check_feed(self, before: Vertex, after: Vertex, goal: Goal | None, over_s: float) -> float:
        """Add up the time above the plan's feed without a break; return it."""
        if goal is None or before[1:4] == after[1:4]:
            return 0.0
        low, high = sorted((before.speed, after.speed))
        if high <= min(goal.plan.feeds[1:], default=0.0):
            return 0.0
        if _allows(before, goal.plan, high) or _allows(after, goal.plan, high):
            return 0.0
        limit = max(_feed_at(before, goal.plan), _feed_at(after, goal.plan))
        if after.e < before.e and math.dist(before[1:3], after[1:3]) < 0.01:
            limit = max(limit, RETREAT_MM_S)
        limit = limit * FEED_FACTOR + FEED_EXTRA_MM_S
        if high <= limit:
            return 0.0
        share = 1.0 if low >= limit else (high - limit) / (high - low)
        over_s += share * (after.t - before.t)
        text = f"{high:.0f} mm/s where {limit:.0f} are planned, at {_text(after)}"
        self.deviated.append(text)
        if over_s > TOO_FAST_S:
            self._once(f"too fast for {over_s:.2f} s: {text}")
        return over_s

    # --- what was published ------------------------------------------------------------------------------------------

    def _check_positions(self) -> None:
        for t, place in self.story.positions:
            seen = self._between(t - SEEN_WITHIN_S, t)
            for axis, value in enumerate(place, 1):
                values = [vertex[axis] for vertex in seen]
                off = max(min(values) - value, value - max(values))
                if off <= STILL_MM:
                    continue
                if off > MOVING_MM or len({vertex[1:4] for vertex in seen}) == 1:
                    text = f"({', '.join(f'{v:.3f}' for v in place)})"
                    self._once(f"published {text}, {off:.2f} mm from where it was: {_text(seen[-1])}")

    def check_end(self, rig: DamageRig) -> None:
        """Compare what the driver believes, at rest, with the truth."""
        machine, truth = rig.machine, rig.here
        if machine.homed and machine.reading_m is not None:
            believed = tuple(1000.0 * value for value in machine.reading_m)
            if max(abs(a - b) for a, b in zip(believed, truth)) > STILL_MM:
                self.wrong.append(f"false belief: {_place(believed)} instead of {_place(truth)}")
        down = truth[2] > self.story.panel_mm + GRAZE_MM
        if down and not (machine.homed and machine.reading_m) and "press" not in machine.state_text:
            self.wrong.append(f"false belief: {machine.state_text!r} with the stylus {truth[2]:.1f} mm down")
        state = machine.phase.state
        if down and machine.homed and state == "stopped" and "lifted" not in machine.state_text:
            self.wrong.append(f"a stop that presses: {machine.state_text!r} at {_place(truth)}")
        board = rig.board.eeprom.values
        for number, wanted in machine.expected_settings().items():
            # The driver's values of the others move nothing.
            if state in ("idle", "unhomed", "disabled") and abs(wanted - board[number]) > 1e-3:
                self.wrong.append(f"false belief: the board has ${number} = {board[number]:g} instead of {wanted:g}")

    def _once(self, text: str) -> None:
        """Note the first finding of each kind."""
        if not any(found[:KIND_CHARACTERS] == text[:KIND_CHARACTERS] for found in self.wrong):
            self.wrong.append(text)


def _text(vertex: Vertex) -> str:
    return f"{_place(vertex[1:4])} mm, {vertex.t:.3f} s"


def _place(place: Sequence[float]) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in place) + ")"


def _to_segment(place: Sequence[float], a: Point, b: Point) -> float:
    """Return the distance of a point to a segment."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    px, py, pz = place[0] - a[0], place[1] - a[1], place[2] - a[2]
    length = ux * ux + uy * uy + uz * uz
    share = min(max((px * ux + py * uy + pz * uz) / length, 0.0), 1.0) if length else 0.0
    return math.sqrt((px - share * ux) ** 2 + (py - share * uy) ** 2 + (pz - share * uz) ** 2)


def _off_plan(vertices: Sequence[Vertex], plan: Plan) -> list[tuple[float, Vertex]]:
    """Return the vertices outside the tube around the plan, with their distances to it."""
    legs = list(pairwise(plan.points)) or [(plan.points[0], plan.points[0])]
    found, at = [], 0
    for vertex in vertices:
        place, nearest = vertex[1:4], math.inf
        for number in range(len(legs)):  # beginning with the leg of the vertex before
            index = (at + number) % len(legs)
            nearest = min(nearest, _to_segment(place, *legs[index]))
            if nearest <= TUBE_MM:
                at = index
                break
        else:
            found.append((nearest, vertex))
    return found


def _from_contact(vertex: Vertex, plan: Plan, panel_mm: float) -> float:
    """Return the distance across the panel to the planned contact, infinity where none is planned."""
    place = vertex.x, vertex.y, 0.0
    legs = [(a, b) for a, b in pairwise(plan.points) if max(a[2], b[2]) > panel_mm]
    return min((_to_segment(place, (*a[:2], 0.0), (*b[:2], 0.0)) for a, b in legs), default=math.inf)


def _allows(vertex: Vertex, plan: Plan, speed: float) -> bool:
    """Whether a planned segment near a vertex is at least as fast."""
    place, points = vertex[1:4], plan.points
    return any(
        feed * FEED_FACTOR + FEED_EXTRA_MM_S >= speed and _to_segment(place, a, b) <= NEAR_MM
        for a, b, feed in zip(points, points[1:], plan.feeds[1:])
    )


def _feed_at(vertex: Vertex, plan: Plan) -> float:
    """Return the highest planned feed near a vertex; off the plan that of the whole goal."""
    place, points = vertex[1:4], plan.points
    near = [feed for a, b, feed in zip(points, points[1:], plan.feeds[1:]) if _to_segment(place, a, b) <= NEAR_MM]
    return max(near or plan.feeds)


def _missed(plan: Plan, vertices: Sequence[Vertex], panel_mm: float) -> str:
    """Return the first waypoint in contact that the stylus has not visited in its turn, empty for none."""
    at = 1
    for point in plan.points[1:]:
        if point[2] <= panel_mm:
            continue
        while at < len(vertices):
            before, after = vertices[at - 1], vertices[at]
            deep = before.e >= point[2] - TUBE_MM or after.e >= point[2] - TUBE_MM  # most of the way is in the air
            if deep and _to_segment(point, before[1:4], after[1:4]) <= TUBE_MM:
                break
            at += 1
        if at == len(vertices):
            return f"{_place(point)} mm"
    return ""
