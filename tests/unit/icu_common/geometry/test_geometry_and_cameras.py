"""Transforms, planes and cameras against closed forms and against OpenCV."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from icu_common.core.geometry.camera_model import CameraModel, StereoModel
from icu_common.core.geometry.geometry import Plane, Transform, mean_pose, nearest_rotation

SEED = 20261121


def random_transform(rng: np.random.Generator) -> Transform:
    return Transform(nearest_rotation(rng.normal(size=(3, 3))), rng.normal(size=3))


@given(st.integers(0, 10_000))
def test_quaternion_inverse_and_chain(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a_from_b, b_from_c = random_transform(rng), random_transform(rng)
    points = rng.normal(size=(5, 3))
    np.testing.assert_allclose((a_from_b @ b_from_c).apply(points), a_from_b.apply(b_from_c.apply(points)), atol=1e-12)
    np.testing.assert_allclose(a_from_b.inverse().apply(a_from_b.apply(points)), points, atol=1e-12)
    back = Transform.from_quaternion(a_from_b.quaternion(), a_from_b.translation)
    np.testing.assert_allclose(back.rotation, a_from_b.rotation, atol=1e-12)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_quaternion_of_half_turns(axis: int) -> None:
    signs = -np.ones(3)
    signs[axis] = 1
    transform = Transform(np.diag(signs), np.zeros(3))
    expected = np.zeros(4)
    expected[axis] = 1
    np.testing.assert_allclose(np.abs(transform.quaternion()), expected, atol=1e-12)


def test_refusals() -> None:
    with pytest.raises(ValueError, match="not a rotation"):
        Transform(np.diag([1.0, 1.0, -1.0]), np.zeros(3))
    with pytest.raises(ValueError, match="finite"):
        Transform(np.eye(3), np.array([0, np.nan, 0]))
    with pytest.raises(ValueError, match="no direction"):
        Transform.from_quaternion((0, 0, 0, 0), (0, 0, 0))


def test_mean_pose_of_small_turns() -> None:
    a, b = (Transform(np.asarray(cv2.Rodrigues(np.array([0, 0, s * 0.01]))[0]), np.array([s, 0, 1.0])) for s in (-1, 1))
    middle = mean_pose([a, b])
    np.testing.assert_allclose(middle.rotation, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(middle.translation, (0, 0, 1))


def test_plane_and_ray() -> None:
    plane = Plane.through((0, 0, 2), (0, 0, -4))
    assert plane.distance(np.array([0.3, 0.1, 1.5])) == pytest.approx(0.5)
    np.testing.assert_allclose(plane.intersect_ray((0, 0, 0), (0.1, 0.2, 1)), (0.2, 0.4, 2))
    with pytest.raises(ValueError, match="parallel"):
        plane.intersect_ray((0, 0, 0), (1, 0, 0))
    with pytest.raises(ValueError, match="behind"):
        plane.intersect_ray((0, 0, 0), (0, 0, -1))


def camera(**changes: object) -> CameraModel:
    turn, _ = cv2.Rodrigues(np.array([0.01, -0.02, 0.005]))
    values: dict[str, object] = {
        "name": "test",
        "width": 1280,
        "height": 720,
        "k": [[1700, 0, 650], [0, 1690, 350], [0, 0, 1]],
        "d": [-0.08, 0.02, 0.0005, -0.0003, 0.001],
        "r": turn,
        "p": [[1680, 0, 640, 0], [0, 1680, 360, 0], [0, 0, 1, 0]],
    }
    return CameraModel(**{**values, **changes})  # type: ignore[arg-type]


def test_project_is_opencv_and_rays_undo_it() -> None:
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    model = camera()
    points = np.column_stack([rng.uniform(-0.25, 0.25, 50), rng.uniform(-0.15, 0.15, 50), rng.uniform(0.6, 0.8, 50)])
    pixels = model.project(points)
    expected, _ = cv2.projectPoints(points @ model.r, np.zeros(3), np.zeros(3), model.k, model.d)
    np.testing.assert_allclose(pixels, expected.reshape(-1, 2), atol=1e-8)
    np.testing.assert_allclose(model.rays(pixels), points / points[:, 2:], atol=1e-9)
    assert np.isnan(model.project([[0, 0, -1]])).all()


def test_pixels_that_the_distortion_does_not_reach_have_no_ray() -> None:
    """Its polynomial bends back 0.86 focal lengths from the centre, and the corners are 0.96 from it."""
    model = camera(k=[[768, 0, 639.5], [0, 768, 359.5], [0, 0, 1]], d=[-0.2, 0, 0, 0, 0])
    pixels = np.array([[639.5, 359.5], [100.0, 359.5], [0.0, 0.0], [1279.0, 719.0]])
    with np.errstate(all="raise"):
        rectified = model.rectify(pixels)
    assert np.isnan(rectified).all(axis=1).tolist() == [False, False, True, True]
    np.testing.assert_allclose(model.project(model.rays(pixels[:2])), pixels[:2], atol=1e-6)


@pytest.mark.parametrize("skew", [0.0, 3.0, -20.0])
def test_a_rectified_picture_is_where_rectified_pixels_are(skew: float) -> None:
    """OpenCV's maps leave the skew of K out: the picture was 7 px from its points."""
    model = camera(k=[[1700, skew, 650], [0, 1690, 350], [0, 0, 1]])
    at_u, at_v = model.rectification_maps()
    u, v = (axis.ravel() for axis in np.meshgrid(np.arange(0, 1280, 71), np.arange(0, 720, 53)))
    part = at_v[v, u].astype(int)
    raw = at_u[v, u] + np.column_stack([part % cv2.INTER_TAB_SIZE, part // cv2.INTER_TAB_SIZE]) / cv2.INTER_TAB_SIZE
    np.testing.assert_allclose(model.rectify(raw), np.column_stack([u, v]), atol=0.6 / cv2.INTER_TAB_SIZE)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"k": [[1700, 0, 650], [2, 1690, 350], [0, 0, 1]]}, r"camera test: k is \[\[.* \[2\.0, .*; expected "),
        ({"k": [[1700, 0, 650], [0, 1690, 350], [0, 0, 2]]}, r"\[\[fx, skew, cx\], \[0, fy, cy\], \[0, 0, 1\]\]"),
        (
            {"p": [[1680, 3, 640, 0], [0, 1680, 360, 0], [0, 0, 1, 0]]},
            r"camera test: p .*; expected \[\[fx, 0, cx, tx\], \[",
        ),
        ({"p": [[1680, 0, 640, 0], [0, 1680, 360, 5], [0, 0, 1, 0]]}, r"camera test: p .*; expected "),
        ({"p": [[1680, 0, 640, 0], [0, 1680, 360, 0], [0, 0, 2, 0]]}, r"camera test: p .*; expected "),
        ({"r": np.zeros((3, 3))}, r"camera test: r \[\[0\.0, .* is not a rotation"),
        ({"p": np.zeros((3, 4))}, r"camera test: p has focal length 0\.0, 0\.0; expected above 0"),
        ({"width": 0}, r"camera test: pictures of 0 x 720 px; expected 1 to 32767 each way"),
        ({"height": -1}, r"camera test: pictures of 1280 x -1 px"),
        ({"width": 40_000}, r"camera test: pictures of 40000 x 720 px"),
    ],
)
def test_half_filled_calibrations_are_refused(change: dict[str, object], message: str) -> None:
    """Drivers that know K only leave R or P at zero: every pixel would become NaN."""
    with pytest.raises(ValueError, match=message):
        camera(**change)


def test_triangulation_undoes_projection() -> None:
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    right_p = [[1680, 0, 640, -1680 * 0.12], [0, 1680, 360, 0], [0, 0, 1, 0]]
    stereo = StereoModel(left=camera(), right=camera(p=right_p, r=np.eye(3), d=[-0.06, 0, 0, 0, 0]))
    assert stereo.baseline == pytest.approx(0.12)
    points = np.column_stack([rng.uniform(-0.2, 0.2, 30), rng.uniform(-0.1, 0.1, 30), rng.uniform(0.6, 0.8, 30)])
    left, right = stereo.left.project(points), stereo.project_right(points)
    rebuilt = stereo.triangulate(stereo.left.rectify(left), stereo.right.rectify(right))
    np.testing.assert_allclose(rebuilt, points, atol=1e-8)
    with pytest.raises(ValueError, match="baseline"):
        StereoModel(left=camera(), right=camera())
    with pytest.raises(ValueError, match=r"rows differ: .*360\.0\] left and .*358\.0\] px right"):
        StereoModel(left=camera(), right=camera(p=[right_p[0], [0, 1680, 358, 0], right_p[2]]))
    with pytest.raises(ValueError, match=r"left camera's P\[0, 3\] is -200\.0; expected 0: points are in its frame"):
        StereoModel(left=camera(p=[[1680, 0, 640, -200], *right_p[1:]]), right=stereo.right)


def test_calibration_file_round_trip(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(yaml.safe_dump(camera().to_mapping()))
    loaded = CameraModel.load(path)
    for name in ("k", "d", "r", "p"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(camera(), name))
    document = camera().to_mapping()
    document["distortion_model"] = "equidistant"
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(ValueError, match="only plumb_bob"):
        CameraModel.load(path)
    path.write_text("image_width: 3\n")
    with pytest.raises(ValueError, match=r"camera\.yaml: not a camera calibration"):
        CameraModel.load(path)
    for content in (b"%YAML:1.0\n---\nimage_width: 640\n", b"camera_matrix: [1, 2\n", b"\xff\xfe"):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"camera\.yaml: not a camera calibration"):
            CameraModel.load(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("camera_matrix: " + 5000 * "[", "more than 24 open brackets"),
        ("#" + 1_000_001 * " ", "1000002 bytes"),
        ("image_width: 1\nimage_width: 2\n", "image_width"),
    ],
    ids=["deep", "long", "a key twice"],
)
def test_a_calibration_file_is_limited_before_it_is_parsed(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "camera.yaml").write_text(text)
    with pytest.raises(ValueError, match=rf"camera\.yaml: not a camera calibration: .*{message}"):
        CameraModel.load(tmp_path / "camera.yaml")
