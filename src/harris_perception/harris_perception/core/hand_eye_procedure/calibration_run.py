"""The calibration procedure: visit spread positions, measure the tip at rest, solve, check, add positions if needed.

This is a state machine without clock or messages: its inputs are events and the time, its outputs are actions. Every
wait has a deadline. Late steps are retried with more time; any other fault ends the run with a reason.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from harris_perception.core.hand_eye.carriage_camera import Contact
from harris_perception.core.hand_eye.degeneracy import DegenerateError, MisfitError
from harris_perception.core.hand_eye.hand_eye_config import HandEyeConfig
from harris_perception.core.hand_eye_procedure.calibration_look import CalibrationLook, Patience, Rest
from harris_perception.core.hand_eye_procedure.calibration_plan import RunConfig, is_worth_more, next_stops, plan
from harris_perception.core.hand_eye_procedure.calibration_solution import (
    CalibrationFailed,
    CalibrationFinished,
    Samples,
)
from harris_perception.core.hand_eye_procedure.calibration_tour import SAMPLED, CalibrationStop, Purpose, seconds
from harris_perception.core.hand_eye_procedure.lowering_check import LoweringCheck
from harris_perception.core.hand_eye_procedure.pair_corrections import PairCorrections
from harris_perception.core.hand_eye_procedure.panel_clearance import PanelClearance
from harris_perception.core.hand_eye_procedure.still_watch import StillConfig
from harris_perception.core.pose.planar_pose import FacePoints
from icu_common.core.geometry.camera_model import StereoModel
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.reasons.message import Message, joined, quoted
from icu_common.core.reasons.state_text import state_name

_NEVER_SEEN = Message("calibration.tip_nowhere_seen_both_cameras")
_LATE = ("stale", "late_image", "slow")
"""Codes of a goal's result that mean that something was late, and nothing is wrong."""
_PAUSE_S = 0.25
"""Seconds before a goal with such a result is sent again, doubled with each retry."""


@dataclass(frozen=True, slots=True)
class SendCalibrationGoal:
    """Go to ``xyz`` in base_link; results carry the id ``str(stamp_ns)``."""

    xyz: tuple[float, float, float]
    stamp_ns: int


@dataclass(frozen=True, slots=True)
class Progress:
    """Progress: positions finished, of the total, and approximate number of remaining seconds."""

    done: int
    total: int
    note: str = ""
    remaining_s: float = math.nan


Action = SendCalibrationGoal | Progress | CalibrationFinished | CalibrationFailed
_FINE = ("idle", "moving")


class CalibrationRun:
    """One run from start to end; ``over`` is true after CalibrationFinished or CalibrationFailed.

    Parameters
    ----------
    config, still, solver
        See the classes.
    cameras
        The pair that measures.
    now_ns
        ROS time.
    base_from_reading
        (2, 2) with which the controller converts goals into readings; None: one to one.
    contacts
        Contacts with known points, for cameras on the carriage that do not see the tip.
    """

    def __init__(
        self,
        config: RunConfig,
        still: StillConfig,
        solver: HandEyeConfig,
        cameras: StereoModel,
        now_ns: int,
        base_from_reading: Array | None = None,
        contacts: Sequence[Contact] = (),
    ) -> None:
        self._config, self._solver = config, solver
        self._axes = np.eye(2) if base_from_reading is None else base_from_reading
        self._see_panel = config.mounting == "carriage"
        self._see_tip = not (self._see_panel and contacts)
        self._still, self._rest, self._patience = still, Rest(still), Patience(config)
        self._stops = plan(config, see_tip=self._see_tip)
        self._places = sum(s.purpose in SAMPLED for s in self._stops)
        self._index = -1
        # The goals sent for this stop: a late result of an earlier one also counts.
        self._goal_ids: set[str] = set()
        self._accepted = ""
        self._arrived = self._pausing = False
        self._start_ns = self._deadline_ns = now_ns
        self._look: CalibrationLook | None = None
        self._left: CalibrationLook | None = None
        self._pair = PairCorrections(cameras)
        self._samples = Samples(config, solver, cameras, contacts, self._pair)
        self._done = 0
        self._missed: list[str] = []
        self._clearance = PanelClearance(see_panel=self._see_panel)
        self._lowering = LoweringCheck(solver.max_scale_error, config.max_held_out_m)
        self.over = False

    def start(self, now_ns: int) -> list[Action]:
        """Return the first actions."""
        return list(self._next(now_ns))

    def keep_clear_of(self, camera_from_panel: Transform | None, proud_m: float) -> None:
        """Set the panel's pose, None while it is unseen, and the room that its tallest control and the ball take."""
        self._clearance.set_face(camera_from_panel, proud_m)

    def driver_state(self, text: str) -> list[Action]:
        """Set the driver's state; any state other than idle and moving ends the run."""
        return (
            []
            if self.over or state_name(text) in _FINE
            else self._fail(Message("calibration.driver_says", text=quoted(text)))
        )

    def pair(self, stamp_ns: int, rotation_rad: Array) -> None:
        """Set the rotation (3,) rad of the right camera with which tips after ``stamp_ns`` are measured."""
        self._pair.take(stamp_ns, rotation_rad)

    def reading(self, stamp_ns: int, reading: Array) -> None:
        """Add readings (3,) m."""
        self._rest.take(stamp_ns, reading)

    def result(self, result: GoalResult, now_ns: int) -> list[Action]:
        """Process a result from the controller; results of other clients' goals are ignored."""
        if self.over or self._arrived or result.goal_id not in self._goal_ids:
            return []
        if result.outcome is Outcome.ACCEPTED:
            self._accepted, self._pausing = result.goal_id, False
            self._deadline_ns = now_ns + self._patience.limit_ns(self._config.move_timeout_s)
            return []
        stop = self._stops[self._index]
        if result.outcome is Outcome.REACHED:
            return self._arrive(stop, now_ns)
        if result.outcome is Outcome.REJECTED and self._accepted not in ("", result.goal_id):
            return []  # another goal for this stop is running, so the controller is busy
        reason = result.reason or Message("controller.no_reason_given")
        if result.code in _LATE and self._patience.again():
            self._accepted, self._pausing = "", True
            self._deadline_ns = now_ns + self._patience.limit_ns(_PAUSE_S)
            return [self._progress(now_ns, self._patience.note(reason))]
        where = Message("calibration.z", x=stop.x * 1000.0, y=stop.y * 1000.0, z_mm=stop.z * 1000.0)
        return self._fail(Message("calibration.goal", where=where, outcome=result.outcome.value, reason=reason))

    def _arrive(self, stop: CalibrationStop, now_ns: int) -> list[Action]:
        self._arrived, self._pausing = True, False
        self._patience.begin()
        if stop.purpose is Purpose.PARK:
            return list(self._next(now_ns))
        self._deadline_ns = now_ns + self._patience.limit_ns(self._config.look_timeout_s)
        return self._advance(now_ns)

    # Sightings; the stamps decide to which look they belong.

    def image(self, stamp_ns: int, now_ns: int) -> list[Action]:
        """Record that the cameras have taken an image."""
        for look in self._open():
            look.image(stamp_ns)
        return self._advance(now_ns)

    def tip(self, stamp_ns: int, tip: Array | None, now_ns: int) -> list[Action]:
        """Add a sighting (3,) m in the camera's frame; None: the tip is not seen in that image."""
        for look in self._open():
            look.tip(stamp_ns, None if tip is None else self._pair.neutral(stamp_ns, tip))
        return self._advance(now_ns)

    def panel(self, stamp_ns: int, camera_from_panel: Transform, points: FacePoints, now_ns: int) -> list[Action]:
        """Add a pose of the panel and the points measured for it; fixed cameras do not need it."""
        for look in self._open():
            look.panel(stamp_ns, camera_from_panel, points)
        return self._advance(now_ns)

    def _open(self) -> list[CalibrationLook]:
        return [look for look in (self._left, self._look) if look is not None]

    def _advance(self, now_ns: int) -> list[Action]:
        """Finish the previous look, and leave the present one, as soon as they are complete."""
        if self.over:
            return []
        if self._left is not None:
            if not self._left.evaluated():
                return []
            left, self._left = self._left, None
            if actions := self._take(left):
                return actions
        if not self._arrived or self._look is None:
            return self._conclude(now_ns) if self._index == len(self._stops) else []
        self._look.rest(self._rest.since_ns, self._rest.known(now_ns))
        if self._look.lacks() or (self._lowers_next() and not self._look.evaluated()):
            return []
        return self._leave(now_ns)

    def _lowers_next(self) -> bool:
        """Return whether the next stop is lower: then all sightings must be checked first."""
        return self._index + 1 < len(self._stops) and self._stops[self._index + 1].z < 0.0

    def _leave(self, now_ns: int) -> list[Action]:
        """Move on while the newest images are still being evaluated."""
        assert self._look is not None
        look, self._look = self._look, None
        look.leave(now_ns)
        if look.evaluated():
            if actions := self._take(look):
                return actions
        else:
            self._left = look
        return list(self._next(now_ns))

    def _take(self, look: CalibrationLook) -> list[Action]:
        """Store the result of a look, or count it as missed; return the actions that end the run in that case."""
        seen = look.result()
        if isinstance(seen, str):
            return self._miss(seen)
        stop = look.stop
        if seen.tip is not None:
            tip = self._pair.newest(seen.tip.tip)
            if wrong := self._lowering.fault(stop, tip):
                return self._fail(wrong)
            self._clearance.measured(stop, look.camera_from_panel, tip)
        if stop.purpose is not Purpose.ABOVE:
            self._samples.keep(stop.purpose, seen)
            self._done += 1
        return []

    def _miss(self, why: str) -> list[Action]:
        self._missed.append(why)
        if len(self._missed) <= self._config.max_missed * self._places:
            return []
        missed = Message(
            "calibration.places_gave_no_sample_last", missed=len(self._missed), places=self._places, why=why
        )
        return self._fail(
            missed
            if self._clearance.known or not self._see_tip
            else Message("text.and_also", first=missed, second=_NEVER_SEEN)
        )

    def tick(self, now_ns: int) -> list[Action]:
        """Check the deadline."""
        if self.over:
            return []
        if actions := self._advance(now_ns):
            return actions
        if now_ns < self._deadline_ns:
            return []
        if self._pausing:
            return [self._send(now_ns)]
        if self._arrived:
            return self._look_late(now_ns)
        if self._index == len(self._stops):
            self._give_up_left()
            return self._conclude(now_ns)
        return self._goal_late(now_ns)

    def _goal_late(self, now_ns: int) -> list[Action]:
        """Wait longer for a result; a goal without any answer is also sent again, because it may have been lost."""
        config = self._config
        limit_s = config.move_timeout_s if self._accepted else config.accept_timeout_s
        waited_s = self._patience.limit_ns(limit_s) * 1e-9
        late = Message(
            "calibration.goal_not_within", value="reached" if self._accepted else "answered", waited_s=waited_s
        )
        if not self._patience.again():
            return self._fail(late)
        actions: list[Action] = [self._progress(now_ns, self._patience.note(late))]
        if not self._accepted:
            return [*actions, self._send(now_ns)]
        self._deadline_ns = now_ns + self._patience.limit_ns(limit_s)
        return actions

    def _look_late(self, now_ns: int) -> list[Action]:
        """Wait longer for images and their evaluation; move on if they arrived and do not show the tip."""
        look = self._look if self._left is None else self._left
        assert look is not None
        late = look.late(now_ns)
        if late and self._patience.again():
            self._deadline_ns = now_ns + self._patience.limit_ns(self._config.look_timeout_s)
            return [self._progress(now_ns, self._patience.note(late))]
        if self._left is not None:
            failed = self._give_up_left()
            self._deadline_ns = now_ns + self._patience.limit_ns(self._config.look_timeout_s)
            return failed
        self._look = None
        missed = look.result()
        failed = self._miss(
            late or (missed if isinstance(missed, str) else look.lacks() or Message("calibration.seen_too_late"))
        )
        if failed:
            return failed
        if look.stop.purpose is Purpose.ABOVE:
            self._index += 1  # the missed step is the lowering after it
        return list(self._next(now_ns))

    def _give_up_left(self) -> list[Action]:
        left, self._left = self._left, None
        return [] if left is None else self._take(left)

    def _next(self, now_ns: int) -> Iterator[Action]:
        self._index += 1
        self._patience.begin()
        if self._index == len(self._stops):
            self._arrived, self._look = False, None
            self._deadline_ns = now_ns + self._patience.limit_ns(self._config.look_timeout_s)
            yield from self._conclude(now_ns)
            return
        yield self._progress(now_ns)
        stop = self._stops[self._index]
        room = self._clearance.room(stop)
        if isinstance(room, str):
            yield from self._fail(room)
            return
        if room is None:
            stop = stop._replace(z=0.0, purpose=Purpose.ABOVE)
            self._stops.insert(self._index, stop)
        else:
            stop = self._stops[self._index] = room
        self._goal_ids, self._look = set(), None
        if stop.purpose is not Purpose.PARK:
            self._look = CalibrationLook(stop, now_ns, self._still, see_tip=self._see_tip, see_panel=self._see_panel)
        yield self._send(now_ns)

    def _send(self, now_ns: int) -> SendCalibrationGoal:
        """Return the goal of this stop, with the present time as stamp."""
        stop = self._stops[self._index]
        self._accepted, self._arrived, self._pausing = "", False, False
        self._goal_ids.add(str(now_ns))
        self._deadline_ns = now_ns + self._patience.limit_ns(self._config.accept_timeout_s)
        x, y = (float(v) for v in self._axes @ np.array([stop.x, stop.y]))
        return SendCalibrationGoal((x, y, stop.z), now_ns)

    def _progress(self, now_ns: int, late: str = "") -> Progress:
        done = self._done + len(self._missed)
        notes = [Message("calibration.missed", missed=len(self._missed))] if self._missed else []
        # The forecast is for an undisturbed machine; the finished part shows how much slower this one is.
        index = max(self._index, 0)
        spent_s, whole_s = seconds(None, self._stops[:index]), seconds(None, self._stops)
        pace = 1.0 if index < 3 else (now_ns - self._start_ns) * 1e-9 / spent_s
        return Progress(done, self._places, joined([*notes, *([late] if late else [])]), pace * (whole_s - spent_s))

    # End: solve and check, or add positions where the calibration is inaccurate.

    def _conclude(self, now_ns: int) -> list[Action]:
        """Solve, unless images of the last stop are still being evaluated."""
        if self._left is not None:
            return []
        solved = self._samples.solve()
        if isinstance(solved, DegenerateError):
            more = isinstance(solved, MisfitError) or len(self._samples.fitted()) < self._solver.min_samples
            if not (more and self._go_on(())):
                return self._fail(str(solved))
            return list(self._again(now_ns))
        used = solved.fit.used.tolist()
        known, fitted, error_m = self._known(used), self._fitted_places(), self._samples.error_m(solved)
        if is_worth_more(self._config, error_m, known, fitted, see_tip=self._see_tip) and self._go_on(used):
            return list(self._again(now_ns))
        self.over = True
        return [self._progress(now_ns), self._samples.check(solved)]

    def _again(self, now_ns: int) -> Iterator[Action]:
        self._index -= 1
        yield from self._next(now_ns)

    def _known(self, used: Sequence[bool]) -> Array:
        """Return the readings (N, 3) m of the samples that count; all of them if ``used`` is empty."""
        readings = [sample.reading for sample in self._samples.fitted()]
        known = [reading for reading, counts in zip(readings, used) if counts] if len(used) else readings
        return np.reshape(known, (-1, 3))

    def _fitted_places(self) -> set[tuple[float, float]]:
        return {(stop.x, stop.y) for stop in self._stops if stop.purpose is Purpose.FIT}

    def _go_on(self, used: Sequence[bool]) -> bool:
        """Append the position that improves the calibration most; false if there is none."""
        known, fitted = self._known(used), self._fitted_places()
        more = next_stops(self._config, known, fitted, self._stops[-1], see_tip=self._see_tip)
        last = [s for s in more[-1:] if s.z]
        self._stops += [*more, *(s._replace(z=0.0, purpose=Purpose.PARK) for s in last)]
        self._places += len(more)
        return bool(more)

    def _fail(self, reason: str) -> list[Action]:
        self.over = True
        return [CalibrationFailed(reason)]
