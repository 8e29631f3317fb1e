"""Compares what was measured with the limits."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gantry_driver.acceptance.limits import AcceptanceLimits
from gantry_driver.acceptance.measured import Measured

AXES = ("x", "y")


@dataclass(frozen=True, slots=True, kw_only=True)
class AcceptanceCheck:
    """One row of the report; ``value`` and ``limit`` are in ``unit``, and ``note`` explains a failure."""

    group: str
    name: str
    value: float
    limit: float
    unit: str
    passed: bool
    at_least: bool = False
    note: str = ""


def _most(group: str, name: str, value: float, limit: float, unit: str, note: str = "") -> AcceptanceCheck:
    passed = bool(abs(value) <= limit)  # NaN is no pass
    return AcceptanceCheck(
        group=group, name=name, value=value, limit=limit, unit=unit, passed=passed, note="" if passed else note
    )


def _least(group: str, name: str, value: float, limit: float, unit: str, note: str = "") -> AcceptanceCheck:
    ok = bool(value >= limit)
    note = "" if ok else note
    return AcceptanceCheck(
        group=group, name=name, value=value, limit=limit, unit=unit, passed=ok, at_least=True, note=note
    )


def all_checks(measured: Measured, limits: AcceptanceLimits) -> list[AcceptanceCheck]:
    """Return the checks in the order of the report."""
    return [
        *_travel(measured, limits),
        *_axes(measured, limits),
        *_cameras(measured, limits),
        *_touches(measured, limits),
    ]


def _travel(measured: Measured, limits: AcceptanceLimits) -> Iterator[AcceptanceCheck]:
    corners = [visit for visit in measured.visits if visit.stop.corner]
    reached = [visit for visit in corners if not visit.problem]
    problems = "; ".join(visit.problem for visit in measured.visits if visit.problem)
    yield _least("limits", "corners of the travel reached", len(reached), max(len(corners), 4), "", problems)
    worst = max((visit.error_m for visit in reached), default=math.nan)
    note = "the board's reports differ from the ordered position: compare the settings, gantry_gcode settings"
    yield _most("limits", "distance from the ordered position", 1e3 * worst, 1e3 * limits.position_error_m, "mm", note)
    rejected = [goal for goal in measured.beyond if goal.rejected]
    accepted = "; ".join(
        f"{goal.reading.round(4).tolist()}: {goal.reason}" for goal in measured.beyond if not goal.rejected
    )
    yield _least(
        "limits", "goals outside the limits rejected", len(rejected), max(len(measured.beyond), 4), "", accepted
    )
    moved = max((goal.moved_m for goal in measured.beyond), default=math.nan)
    yield _most(
        "limits", "motion by rejected goals", 1e3 * moved, 0.05, "mm", "a rejected goal must not move the machine"
    )


def _axes(measured: Measured, limits: AcceptanceLimits) -> Iterator[AcceptanceCheck]:
    fit, nan = measured.fit, [math.nan, math.nan]
    why = measured.fit_problem
    turned = nan if fit is None else fit.direction_deg
    for axis, value in zip(AXES, turned):
        note = why or "reversed beyond 90 deg: change bits of $3 and $23; crossed: change the motors' plugs"
        yield _most("direction", f"{axis} axis against the panel's", float(value), limits.direction_deg, "deg", note)
    for axis, value in zip(AXES, nan if fit is None else fit.scale_error):
        note = why or "correct $100 or $101 (steps/mm), or the calibration of the cameras"
        yield _most("scale", f"{axis} axis", 100 * float(value), 100 * limits.scale_error, "%", note)
    square = math.nan if fit is None else fit.squareness_deg
    note = why or "align the rails: loosen one side of the bridge and push it against both stops"
    yield _most("squareness", "angle between the axes less 90 deg", square, limits.squareness_deg, "deg", note)
    tilt = math.nan if fit is None else fit.tilt_deg
    note = why or "align the stage with the instrument's face"
    yield _most("squareness", "tilt against the panel", tilt, limits.tilt_deg, "deg", note)
    for axis, value in zip(AXES, nan if fit is None else fit.backlash_m):
        note = why or "tighten the belt, or adjust the nut"
        yield _most("backlash", f"{axis} axis", 1e3 * float(value), 1e3 * limits.backlash_m, "mm", note)
    rms = math.nan if fit is None else fit.straightness_m
    note = why or "a slipping belt, a loose stylus, or cameras that moved"
    yield _most("backlash", "rms distance from straight axes", 1e3 * rms, 1e3 * limits.straightness_m, "mm", note)


def _cameras(measured: Measured, limits: AcceptanceLimits) -> Iterator[AcceptanceCheck]:
    for camera in measured.cameras:
        note = "focus the lens on the panel, fix it, then calibrate the cameras again"
        yield _most("camera", f"{camera.name}: blur of edges", camera.blur_px, limits.blur_px, "px", note)
        name = f"{camera.name}: share of the panel in the image"
        note = "turn the cameras, or increase their distance"
        yield _least("camera", name, 100 * camera.view.share, 100 * limits.panel_share_min, "%", note)
    share = len(measured.seen) / len(measured.visits) if measured.visits else math.nan
    note = "the tip is outside the images, or the tracker does not find its ball"
    yield _least("camera", "stops with the tip seen", 100 * share, 100 * limits.seen_share_min, "%", note)


def _touches(measured: Measured, limits: AcceptanceLimits) -> Iterator[AcceptanceCheck]:
    touched = [touch for touch in measured.touches if touch.touched]
    problems = "; ".join(dict.fromkeys(touch.reason for touch in measured.touches if not touch.touched))
    missing = measured.wanted_touches - len(measured.touches)
    note = problems or f"the panel has room for {len(measured.touches)} points, {missing} too few: lower --touches"
    yield _least("touch", "points touched", len(touched), measured.wanted_touches, "", note)
    errors = [touch.error_m for touch in touched]
    worst, mean = (float(np.max(errors)), float(np.mean(errors))) if errors else (math.nan, math.nan)
    yield _most("touch", "mean error", 1e3 * mean, 1e3 * limits.touch_error_m, "mm", problems)
    yield _most("touch", "largest error", 1e3 * worst, 1e3 * limits.touch_error_m, "mm", problems)
