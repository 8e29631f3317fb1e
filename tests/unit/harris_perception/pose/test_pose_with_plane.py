"""A panel's pose from one picture, improved by the stereo plane: on made numbers, and on renders with known truth."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
from unit.harris_perception import panel_scene as scene

from harris_perception.core.corners.harris import HarrisConfig, HarrisDetector
from harris_perception.core.pose.planar_pose import PoseFit, with_plane
from harris_perception.core.recognition.recognition import PanelRecogniser
from harris_perception.core.stereo.matches import triangulated
from harris_perception.core.stereo.plane_fit import PlaneConfig, PlaneFit, fit_plane
from harris_perception.core.stereo.rectifier import Rectifier
from harris_perception.core.stereo.stereo_matching import StereoMatchConfig, disparity_range, match_corners
from icu_common.core.geometry.camera_model import StereoModel
from icu_common.core.geometry.geometry import Array, Transform

pytestmark = pytest.mark.slow

LAYOUT = scene.bench_layout()
LEFT = scene.camera()
HALF = np.array([[0.5, 0.0, -0.25], [0.0, 0.5, -0.25], [0.0, 0.0, 1.0]])
# The same camera with four pixels taken as one.
BINNED = dataclasses.replace(LEFT, width=LEFT.width // 2, height=LEFT.height // 2, k=HALF @ LEFT.k, p=HALF @ LEFT.p)
BASELINE_M = 0.12
CORNERS = np.array([(x, y, 0.0) for x in (0.0, 0.32) for y in (0.0, 0.15)])


def off_the_face_mm(found: Transform, truth: Transform) -> float:
    """The greatest distance of the face's corners from the true plane: depth and tilt in one figure."""
    return float(np.abs((found.apply(CORNERS) - truth.apply(CORNERS)) @ truth.rotation[:, 2]).max() * 1e3)


def plane_points(truth: Transform, rng: np.random.Generator, noise_m: float = 3e-4) -> Array:
    points = truth.apply(np.column_stack([rng.uniform((0, 0), (0.32, 0.15), (200, 2)), np.zeros(200)]))
    return np.asarray(points * (1 + rng.normal(0, noise_m, 200) / points[:, 2])[:, None])


def plane_of(truth: Transform, rng: np.random.Generator) -> PlaneFit:
    fit = fit_plane(plane_points(truth, rng), np.full(200, 3e-4), PlaneConfig(tolerance_m=0.003), rng)
    assert fit is not None
    return fit


def test_planes_covariance_is_the_spread_of_many_fits() -> None:
    truth = scene.pose(LAYOUT)
    fits = [plane_of(truth, np.random.default_rng(seed)) for seed in range(150)]
    normal = truth.rotation[:, 2]
    # Seen at one point of the panel, away from its middle.
    place = truth.apply(np.array([(0.3, 0.02, 0.0)]))[0]
    seen = [float(fit.plane.distance(place)) for fit in fits]
    said = []
    for fit in fits:
        arm = np.concatenate([normal, np.cross(place - fit.centre, normal)])
        said.append(np.sqrt(arm @ fit.covariance @ arm))
    print(f"spread {1e6 * np.std(seen):.1f} um, said {1e6 * np.mean(said):.1f} um")
    assert 0.8 < np.mean(said) / np.std(seen) < 1.25


def coarse(truth: Transform, shift_m: float, deviation_m: float) -> PoseFit:
    moved = Transform(truth.rotation, truth.translation + np.array([0.0, 0.0, shift_m]))
    covariance = np.diag([1.6e-5, 1.6e-5, 1.6e-7, 1.6e-9, 1.6e-9, deviation_m**2])
    return PoseFit(
        camera_from_panel=moved, error_px=np.zeros(1), centre=moved.apply(CORNERS).mean(axis=0), covariance=covariance
    )


def test_plane_corrects_depth_but_not_what_it_does_not_tell() -> None:
    truth = scene.pose(LAYOUT, below_deg=0.0)
    plane = plane_of(truth, np.random.default_rng(3))
    better = with_plane(coarse(truth, 0.002, 0.002), plane.pose(), plane.covariance)
    assert better is not None
    assert off_the_face_mm(better.camera_from_panel, truth) < 0.15
    moved = better.camera_from_panel.apply(CORNERS) - truth.apply(CORNERS)
    assert np.abs(moved[:, :2]).max() < 1e-4
    assert better.covariance[5, 5] < 0.01 * 0.002**2


def test_another_plane_is_refused() -> None:
    """The table behind, a hand before: not within three standard deviations."""
    truth = scene.pose(LAYOUT)
    plane = plane_of(truth, np.random.default_rng(4))
    assert with_plane(coarse(truth, 0.012, 0.002), plane.pose(), plane.covariance) is None


def test_renders_are_measured_nearer_to_the_true_plane() -> None:
    right = dataclasses.replace(LEFT, name="right", p=LEFT.p - BASELINE_M * LEFT.p[0, 0] * np.eye(3, 4, 3))
    stereo = StereoModel(left=LEFT, right=right)
    detector, config = HarrisDetector(HarrisConfig(max_corners=2000)), StereoMatchConfig()
    recogniser = PanelRecogniser(LAYOUT)
    errors = []
    for seed in (101, 103, 105):
        rng = np.random.default_rng(seed)
        tilt = {"below_deg": rng.uniform(5, 35), "side_deg": rng.uniform(-15, 15)}
        truth = scene.pose(LAYOUT, distance_m=rng.uniform(0.7, 1.0), shift_m=(0.05, 0.0), **tilt)
        look = scene.Look(hidden=0.4, noise=3.0)
        shifted = Transform(truth.rotation, truth.translation - (BASELINE_M, 0.0, 0.0))
        pictures = [scene.picture(LAYOUT, LEFT, pose, look, seed) for pose in (truth, shifted)]
        corners = [detector.detect(picture).xy for picture in pictures]
        recogniser.forget()
        sighting = recogniser.locate(pictures[0], corners[0], LEFT)
        assert sighting is not None
        rectify = Rectifier(LEFT)
        rectified = [rectify(picture) for picture in pictures]
        at = [LEFT.rectify(xy) for xy in corners]
        points = triangulated(stereo, match_corners(*rectified, *at, disparity_range(stereo, config), config))
        plane = fit_plane(points[:, :3], points[:, 3], PlaneConfig(), np.random.default_rng(0))
        assert plane is not None
        better = with_plane(sighting.fit, plane.pose(), plane.covariance)
        assert better is not None
        errors.append([off_the_face_mm(p, truth) for p in (sighting.camera_from_panel, better.camera_from_panel)])
    alone, improved = np.mean(errors, axis=0)
    print(f"seeds 101, 103, 105: {alone:.3f} mm by one picture, {improved:.3f} mm with the plane")
    assert improved < 0.8 * alone


def test_a_pose_is_as_sure_as_it_says_with_fine_and_with_coarse_pixels() -> None:
    """The shared error of one line's edges is no noise of each edge: a pose once had three times its reported error."""
    seed, found = 7, {"fine": [], "binned": []}
    rng, detector = np.random.default_rng(seed), HarrisDetector()
    recognisers = {name: PanelRecogniser(LAYOUT) for name in found}
    for number in range(8):
        below, side, roll = rng.uniform((-30, -20, -8), (30, 20, 8))
        truth = scene.pose(LAYOUT, rng.uniform(0.55, 0.75), below, side, roll)
        picture = scene.picture(LAYOUT, LEFT, truth, scene.Look(arm_x_mm=None), seed=number)
        small = np.rint(picture.reshape(360, 2, 640, 2).mean(axis=(1, 3))).astype(np.uint8)
        for name, gray, camera in (("fine", picture, LEFT), ("binned", small, BINNED)):
            recognisers[name].forget()
            sighting = recognisers[name].locate(gray, detector.detect(gray).xy, camera)
            assert sighting is not None
            pose, centre = sighting.camera_from_panel, sighting.fit.centre
            turn = cv2.Rodrigues(truth.rotation @ pose.rotation.T)[0][:, 0]
            off = np.concatenate([turn, truth.apply(pose.inverse().apply(centre[None]))[0] - centre])
            found[name].append(float(off @ np.linalg.solve(sighting.fit.covariance, off)) / 6)
    for name, squares in found.items():
        print(f"seed {seed}, {name}: squared errors over the told, per number, mean {np.mean(squares):.2f}")
        assert 0.2 < np.mean(squares) < 2.0
