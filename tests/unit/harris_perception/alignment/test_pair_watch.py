"""A settled pair of images that shows what the last measured one showed is not measured again; a turned camera is."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
from unit.harris_perception import panel_scene as scene

from harris_perception.core.alignment.pair_config import PairConfig
from harris_perception.core.alignment.pair_rotation import turned_right
from harris_perception.core.alignment.pair_watch import Gray, PairWatch
from harris_perception.core.recognition.recognition import RecognitionConfig, face_meter
from icu_common.core.alignment.pair import PairCode
from icu_common.core.geometry.camera_model import StereoModel
from icu_common.core.geometry.geometry import Transform

LAYOUT = scene.bench_layout()
BASELINE_M = 0.06
CONFIG = PairConfig(window=3, frames=2)
POSE = scene.pose(LAYOUT)
SECOND = 1_000_000_000


def cameras() -> StereoModel:
    left = scene.camera()
    p = left.p.copy()
    p[0, 3] = -p[0, 0] * BASELINE_M
    return StereoModel(left=left, right=dataclasses.replace(left, name="right", p=p))


@cache
def images(turn_deg: float, seed: int) -> tuple[Gray, Gray]:
    """Return a pair whose right camera has turned about its vertical axis since the calibration."""
    pair = turned_right(cameras(), np.radians([0.0, turn_deg, 0.0]))
    beside = Transform(POSE.rotation, POSE.translation - np.array([BASELINE_M, 0.0, 0.0]))
    look = scene.Look(screen_seed=seed)
    left = scene.picture(LAYOUT, pair.left, POSE, look, seed)
    return np.asarray(left), np.asarray(scene.picture(LAYOUT, pair.right, beside, look, seed + 100))


def watch() -> PairWatch:
    return PairWatch(CONFIG, face_meter(LAYOUT, RecognitionConfig(), None, None, 4.0), cameras())


def settled() -> PairWatch:
    found = watch()
    for second in range(CONFIG.window):
        assert not found.unchanged(*images(0.0, second), second * SECOND), "too few measurements agree"
        assert found.look(*images(0.0, second), POSE, second * SECOND)
    return found


def test_an_unchanged_pair_has_the_known_state_at_its_own_stamp_but_only_so_many_times() -> None:
    pair = settled()
    before = pair.state
    for second in range(3, 6):
        assert pair.unchanged(*images(0.0, second % 3), second * SECOND)
        assert pair.state.stamp_ns == second * SECOND
        assert pair.state.code is before.code is PairCode.ALIGNED
        assert np.array_equal(pair.state.rotation_rad, before.rotation_rad)
    assert not pair.unchanged(*images(0.0, 0), 6 * SECOND)
    assert pair.state.stamp_ns == 5 * SECOND


def test_a_camera_turned_by_a_fiftieth_of_a_degree_is_measured_at_once_and_until_it_agrees() -> None:
    pair = settled()
    assert not pair.unchanged(*images(0.02, 4), 4 * SECOND)
    assert pair.look(*images(0.02, 4), POSE, 4 * SECOND)
    assert pair.state.code.value == PairCode.CHANGING.value
    for second in (5, 6):
        assert not pair.unchanged(*images(0.02, second), second * SECOND), "the new rotation must agree first"
        assert pair.look(*images(0.02, second), POSE, second * SECOND)
    assert pair.state.code is PairCode.CORRECTED
    assert 0.018 < pair.state.turn_deg < 0.022
