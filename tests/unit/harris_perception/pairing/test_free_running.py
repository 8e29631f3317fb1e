"""Two free-running cameras: every left image gets a tip at its own instant, and the diagnostics say why none does."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from unit.harris_perception.rendered_stylus import stereo_model

from harris_perception.pairing.free_pairs import FreePairs, ImagePair
from harris_perception.pairing.free_tips import FreeTips
from harris_perception.pairing.offset import OffsetEstimator
from harris_perception.pairing.report import INTERPOLATED, NO_PAIR, TOGETHER, pairing_report, pairing_values
from harris_perception.pairing.search import Outline, Search

STEREO = stereo_model()
MS = 1_000_000
PERIOD = 33 * MS + 333_333
TOLERANCE = 4 * MS
REST = np.array([0.03, -0.02, 0.66])
Path = Callable[[float], Any]


def arrivals(phase_ms: float, count: int, right_period: int = PERIOD) -> Iterator[tuple[int, int]]:
    """Stamps of both cameras in the order of their arrival: 0 left, 1 right."""
    lefts = [(1_000_000_000 + k * PERIOD, 0) for k in range(count)]
    rights = [(1_000_000_000 + k * right_period + round(phase_ms * MS), 1) for k in range(count)]
    return iter(sorted((stamp, side) for stamp, side in lefts + rights))


class SeenExactly:
    """Sees the ball in each image where it was when the image was taken, to ``noise_px``; ``late_ns``: right stamps."""

    def __init__(self, path: Path, late_ns: int = 0, noise_px: float = 0.0) -> None:
        self.stereo, self._path, self._late_ns, self._noise_px = STEREO, path, late_ns, noise_px
        self._rng = np.random.default_rng(5)

    def find(self, left: int, right: int, apart_s: float = 0.0) -> Search:
        focal, p = STEREO.focal_px, STEREO.left.p
        centres = []
        for stamp, eye in ((left, 0.0), (right - self._late_ns, STEREO.baseline)):
            x, y, z = self._path(stamp * 1e-9) - np.array([eye, 0.0, 0.0])
            centre = np.array([focal * x / z + p[0, 2], focal * y / z + p[1, 2]])
            centres.append(centre + self._rng.normal(0.0, 1.0, 2) * self._noise_px)
        tip = STEREO.triangulate(*centres)[0]
        outlines = [Outline(centre_px=centre, error=0.03, arc_deg=300.0) for centre in centres]
        rows = abs(float(centres[0][1] - centres[1][1]))
        return Search(tip=tip, left=outlines[0], right=outlines[1], row_error_px=rows, row_limit_px=0.7)


def moving(t: float) -> Any:
    return REST + np.array([0.08, 0.05, 0.0]) * (t - 1.0)


def tracked(
    phase_ms: float, path: Path, count: int = 90, **seen: Any
) -> tuple[list[tuple[int, Search]], FreePairs, Any]:
    pairs = FreePairs(tolerance_ns=TOLERANCE)
    tips = FreeTips(SeenExactly(path, **seen))
    found = []
    for stamp, side in arrivals(phase_ms, count):
        pair = pairs.add(side, stamp, stamp)
        if pair is not None:
            found.append((pair.left_ns, tips.find(pair, pair.left, pair.right, pairs.right_late_ns)))
    return found, pairs, tips


@pytest.mark.parametrize("phase_ms", np.arange(0.0, 33.0, 3.0))
def test_each_start_of_two_free_cameras_gives_a_tip_for_nearly_every_left_image(phase_ms: float) -> None:
    """60 % of all phases of two cameras at 30 Hz are farther than 4 ms from either neighbour: they gave no pair."""
    found, _, _ = tracked(phase_ms, lambda t: REST)
    tips = [(stamp, search.tip) for stamp, search in found if search.tip is not None]
    assert len(tips) >= 80
    assert len({stamp for stamp, _ in tips}) == len(tips)
    assert max(float(np.abs(tip - REST).max()) for _, tip in tips) < 1e-9


@pytest.mark.parametrize("phase_ms", [5.0, 12.0, 17.0, 24.0, 28.0])
def test_a_moving_tip_is_where_it_was_at_the_left_images_instant(phase_ms: float) -> None:
    found, _, _ = tracked(phase_ms, moving)
    errors = [np.abs(search.tip - moving(stamp * 1e-9)).max() for stamp, search in found if search.tip is not None]
    assert len(errors) >= 80
    assert max(errors) < 1e-6  # a straight line is interpolated exactly; without interpolation 1 to 2 mm


def test_without_interpolation_the_same_tip_is_wrong() -> None:
    """Purpose of the interpolation: by the nearest right image the tip is off by its motion, in depth above all."""
    tracker = SeenExactly(moving)
    stamp = 1_500_000_000
    off = tracker.find(stamp, stamp + 12 * MS).tip - moving(1.5)
    assert abs(off[2]) > 0.003


def test_the_phase_may_drift_through_all_of_the_period() -> None:
    pairs, tips = FreePairs(tolerance_ns=TOLERANCE), FreeTips(SeenExactly(lambda t: REST))
    seen: list[int] = []
    for stamp, side in arrivals(0.0, 900, right_period=PERIOD + 60_000):  # 60 us per image, once around in 18 s
        pair = pairs.add(side, stamp, stamp)
        if pair is not None and tips.find(pair, pair.left, pair.right).tip is not None:
            seen.append(pair.left_ns)
    print(len(seen), "of 900")
    assert len(seen) >= 870 and seen == sorted(set(seen))


def test_synchronous_cameras_are_paired_at_once_also_where_images_are_lost() -> None:
    pairs = FreePairs(tolerance_ns=TOLERANCE)
    rng = np.random.default_rng(3)
    made: list[ImagePair] = []
    both = 0
    for k in range(300):
        stamp = 1_000_000_000 + k * PERIOD
        sides = [side for side in (0, 1) if rng.random() > 0.1]
        both += len(sides) == 2
        for side in sides:
            pair = pairs.add(side, stamp + side * MS, k)
            made += [pair] if pair is not None else []
    assert len(made) == both and not any(pair.apart for pair in made)
    assert all(pair.left == pair.right for pair in made)


@pytest.mark.parametrize("phase_ms", [4.0, -4.0 + 33.333])
def test_stamps_that_jitter_about_the_tolerance_lose_few_images(phase_ms: float) -> None:
    pairs, tips = FreePairs(tolerance_ns=TOLERANCE), FreeTips(SeenExactly(lambda t: REST))
    rng = np.random.default_rng(8)
    jittered = sorted((stamp + round(rng.normal(0.0, 0.5) * MS), side) for stamp, side in arrivals(phase_ms, 200))
    found = 0
    for stamp, side in jittered:
        pair = pairs.add(side, stamp, stamp)
        found += pair is not None and tips.find(pair, pair.left, pair.right).tip is not None
    print(found, "of 200")
    assert found >= 170


def test_a_recording_that_starts_again_is_paired_again() -> None:
    pairs = FreePairs(tolerance_ns=TOLERANCE)
    for start in (5_000_000_000, 1_000_000_000):
        made = [pairs.add(side, start + k * PERIOD, k) for k in range(5) for side in (0, 1)]
        assert sum(pair is not None for pair in made) == 5


@pytest.mark.parametrize("late_ms", [-14.0, 0.0, 9.0])
def test_a_constant_offset_of_the_stamps_is_measured_from_the_motion_and_taken_out(late_ms: float) -> None:
    """A camera whose driver stamps the end of the transfer is late by a constant that no stamp shows."""

    def swinging(t: float) -> Any:
        return REST + np.array([0.02 * np.cos(3 * t), 0.03 * np.sin(2.0 * t), 0.0])

    late_ns = round(late_ms * MS)
    _, pairs, tips = tracked(12.0, swinging, count=240, late_ns=late_ns, noise_px=0.1)
    offset = tips.offset
    print(offset)
    assert offset.sigma_s < 0.0005
    assert offset.late_s * 1e3 == pytest.approx(late_ms, abs=max(4 * offset.sigma_s * 1e3, 0.3))
    assert tips.right_late_ns() == (0 if late_ms == 0 else pytest.approx(late_ns, abs=500_000))
    # With the correction the moving tip is right again.
    pairs.right_late_ns = tips.right_late_ns()
    errors = []
    for stamp, side in ((s + 9_000_000_000, side) for s, side in arrivals(12.0, 60)):
        pair = pairs.add(side, stamp, stamp)
        if pair is None:
            continue
        search = tips.find(pair, pair.left, pair.right, pairs.right_late_ns)
        if search.tip is not None:
            errors.append(np.abs(search.tip - swinging(pair.left_ns * 1e-9))[:2].max())
    assert len(errors) > 40 and np.median(errors) < 0.0002
    assert tips.offset.late_s * 1e3 == pytest.approx(late_ms, abs=0.4), "still that of the camera's own stamps"


def test_no_offset_is_told_without_motion() -> None:
    estimator = OffsetEstimator()
    for _ in range(200):
        estimator.add(0.05, 0.4)
    assert not np.isfinite(estimator.estimate().sigma_s)


def test_the_report_has_code_values_and_what_to_set() -> None:
    pairs = FreePairs(tolerance_ns=5 * MS, free_running=False)
    for stamp, side in arrivals(8.0, 40):
        assert pairs.add(side, stamp, stamp) is None
    phase = pairs.phase()
    assert phase.difference_s * 1e3 == pytest.approx(8.0, abs=0.01)
    assert phase.left_period_s == pytest.approx(1 / 30, rel=1e-3)
    report = pairing_report(phase, 0.005, paired=False, interpolated=False, free_running=False)
    assert report is not None and report.code == NO_PAIR and report.parameter == "free_running"
    assert report.text == "left and right images differ by 8.0 ms, tolerance 5 ms: set free_running"
    values = dict(pairing_values(report, phase, OffsetEstimator().estimate()))
    assert values["pairing"] == "no_pair" and float(values["difference_ms"]) == pytest.approx(8.0, abs=0.01)
    assert values["tolerance_ms"] == "5" and values["parameter"] == "free_running"
    for interpolated, code in ((True, INTERPOLATED), (False, TOGETHER)):
        good = pairing_report(phase, 0.005, paired=True, interpolated=interpolated, free_running=True)
        assert good is not None and good.code == code and good.text == ""


def test_nothing_is_reported_before_both_cameras_have_sent_images() -> None:
    pairs = FreePairs(tolerance_ns=TOLERANCE)
    for k in range(10):
        pairs.add(0, k * PERIOD, k)
    assert not pairs.phase().known
    assert pairing_report(pairs.phase(), 0.004, paired=False, interpolated=False, free_running=True) is None
