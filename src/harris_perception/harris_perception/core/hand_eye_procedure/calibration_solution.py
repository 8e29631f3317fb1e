"""Samples of a calibration run: the solution, and the check at the held-out positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from harris_perception.core.hand_eye.backlash import Backlash, measure_backlash
from harris_perception.core.hand_eye.carriage_camera import (
    Contact,
    PanelSample,
    calibrate_on_carriage,
    held_out_on_carriage,
    origin_place,
)
from harris_perception.core.hand_eye.degeneracy import DegenerateError
from harris_perception.core.hand_eye.hand_eye import HandEye, calibrate, tip_place
from harris_perception.core.hand_eye.hand_eye_config import HandEyeConfig
from harris_perception.core.hand_eye.tip_samples import Place, Sample
from harris_perception.core.hand_eye_procedure.calibration_look import Seen
from harris_perception.core.hand_eye_procedure.calibration_plan import RunConfig, corners
from harris_perception.core.hand_eye_procedure.calibration_tour import BACKLASH, FITTED, SAMPLED, Purpose
from harris_perception.core.hand_eye_procedure.pair_corrections import PairCorrections
from icu_common.core.geometry.camera_model import StereoModel
from icu_common.core.geometry.geometry import Array
from icu_common.core.reasons.message import Message

_EDGE = 1.4
"""Ratio of a tip's variance at the ends of the travel, where the backlash is measured, to that from the misfit at all
positions. It is the most likely value for seeds 100 to 149 of the benchmark with fixed cameras."""
_SCATTER = 3.0
"""Maximum error at a held-out position, relative to the rms misfit of all samples, if that is above the limit."""


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationFinished:
    """The calibration, the errors (N,) m at the held-out positions, and the backlash of x and y if it was measured."""

    calibration: HandEye
    held_out_m: Array
    backlash: tuple[Backlash | None, Backlash | None] = (None, None)


@dataclass(frozen=True, slots=True)
class CalibrationFailed:
    """The run has ended without a calibration."""

    reason: str


class Samples:
    """All samples, by purpose.

    Parameters
    ----------
    config, solver
        See the classes.
    cameras
        The pair that measures.
    contacts
        Contacts with known points, for cameras on the carriage that do not see the tip.
    pair
        Corrections of the right camera; all tips are used with the newest one.
    """

    def __init__(
        self,
        config: RunConfig,
        solver: HandEyeConfig,
        cameras: StereoModel,
        contacts: Sequence[Contact],
        pair: PairCorrections,
    ) -> None:
        self._config, self._solver, self._cameras, self._contacts = config, solver, cameras, tuple(contacts)
        self._pair = pair
        self._see_panel = config.mounting == "carriage"
        self._tips: dict[Purpose, list[Sample]] = {purpose: [] for purpose in SAMPLED}
        self._panels: dict[Purpose, list[PanelSample]] = {purpose: [] for purpose in SAMPLED}

    def keep(self, purpose: Purpose, seen: Seen) -> None:
        """Store the result of a stop."""
        if seen.tip is not None:
            self._tips[purpose].append(seen.tip)
        if seen.panel is not None:
            self._panels[purpose].append(seen.panel)

    def fitted(self, *others: Purpose) -> Sequence[Sample | PanelSample]:
        """Return the samples from which the calibration is solved, and those of ``others``."""
        purposes = (*FITTED, *others)
        return self._panels_of(*purposes) if self._see_panel else self._tips_of(*purposes)

    def _panels_of(self, *purposes: Purpose) -> list[PanelSample]:
        return [sample for purpose in purposes for sample in self._panels[purpose]]

    def _tips_of(self, *purposes: Purpose) -> list[Sample]:
        return [self._pair.corrected(sample) for purpose in purposes for sample in self._tips[purpose]]

    def error_m(self, calibration: HandEye) -> float:
        """Return the predicted error at the corners, m, without the error that all samples share."""
        return calibration.own_sigma_m(corners(self._config))

    def solve(self, *others: Purpose) -> HandEye | DegenerateError:
        """Solve from all samples except those of the held-out positions, or including ``others``."""
        purposes = (*FITTED, *others)
        try:
            if not self._see_panel:
                return calibrate(self._tips_of(*purposes), self._cameras, self._solver)
            panels, tips = self._panels_of(*purposes), self._tips_of(*SAMPLED)
            return calibrate_on_carriage(panels, tips, self._cameras, self._contacts, self._solver)
        except DegenerateError as error:
            return error

    def check(self, calibration: HandEye) -> CalibrationFinished | CalibrationFailed:
        """Check at the held-out positions; a calibration that passes is solved again including them."""
        panels, tips = self._panels_of(Purpose.CHECK), self._tips_of(Purpose.CHECK)
        checks = max(len(panels), len(tips))
        if checks < 2:
            return CalibrationFailed(Message("calibration.only_held_out_places_gave", checks=checks))
        if self._see_panel:
            errors = held_out_on_carriage(calibration, panels, self._cameras.left)
        else:
            errors = held_out_errors(calibration, tips)
        # A single position of an ordinary webcam is as uncertain as the scatter of all of them.
        limit_m = max(self._config.max_held_out_m, _SCATTER * calibration.fit.rms_m)
        if errors.max() > limit_m:
            what = "panel" if self._see_panel else "tip"
            return CalibrationFailed(
                Message(
                    "calibration.held_out_place_off_accepted",
                    what=what,
                    max_mm=errors.max() * 1000.0,
                    max_held_out_mm=limit_m * 1000.0,
                )
            )
        whole = self.solve(Purpose.CHECK)
        if isinstance(whole, HandEye):
            calibration = whole
        return CalibrationFinished(
            calibration, errors, (self._backlash(calibration, 0), self._backlash(calibration, 1))
        )

    def _backlash(self, calibration: HandEye, axis: int) -> Backlash | None:
        """Compare the carriage's positions after an approach from above and, close by, after one from below."""
        below, above = (self._seen(calibration, purpose) for purpose in BACKLASH[axis])
        # A position without sighting has no partner for its neighbour.
        near = 3 * self._config.approach_m
        pairs = [(a, b) for a in below for b in above if np.abs(a.reading - b.reading).max() < near]
        return measure_backlash(calibration, axis, pairs) if pairs else None

    def _seen(self, calibration: HandEye, purpose: Purpose) -> list[Place]:
        if not self._see_panel:
            return [tip_place(calibration, sample, self._cameras, _EDGE) for sample in self._tips_of(purpose)]
        return [origin_place(calibration, panel, self._cameras.left) for panel in self._panels_of(purpose)]


def held_out_errors(calibration: HandEye, samples: list[Sample]) -> Array:
    """Return (N,) m: distances between measured and expected tip."""
    expected = calibration.tip_in_camera(np.array([s.reading for s in samples]))
    return np.asarray(np.linalg.norm(expected - np.array([s.tip for s in samples]), axis=1))
