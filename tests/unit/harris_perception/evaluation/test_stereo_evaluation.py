"""Evaluation of stereo: scores of known errors, folder forms, the command, goals on photographs with truth."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from harris_perception.adapters.stereo_folders import scenes
from harris_perception.cli.stereo import main, stereo
from harris_perception.core.evaluation.stereo_evaluation import (
    ALL_CORNERS,
    SparseResult,
    StereoScene,
    score_dense,
    score_sparse,
)

pytestmark = pytest.mark.long

NAN = np.float32(np.nan)


def scene(seed: int = 11, shape: tuple[int, int] = (120, 240)) -> StereoScene:
    """Return a wall at 12 px with a square at 30 px in front of it."""
    rng = np.random.default_rng(seed)
    wall, square = (cv2.GaussianBlur(rng.normal(0, 1, s), (0, 0), 1.5) * 150 + 128 for s in ((120, 300), (50, 60)))
    left, right = wall[:, :240].copy(), wall[:, 12:252].copy()
    left[30:80, 120:180] = right[30:80, 90:150] = square
    truth = np.full(shape, 12, np.float32)
    truth[30:80, 120:180] = 30
    left, right = (np.clip(p, 0, 255).astype(np.uint8) for p in (left, right))
    return StereoScene(name="made", left=left, right=right, truth=truth)


def test_what_the_right_picture_does_not_show_is_not_visible() -> None:
    seen = scene().visible()
    assert not seen[:, :12].any() and seen[:30, 12:].all()
    assert seen[30:80, 120:180].all()
    # The square moves 18 px farther than the wall and hides as many of the wall's columns left of itself.
    assert not seen[32:78, 103:119].any() and seen[32:78, 12:100].all()


def test_what_lies_right_of_the_right_picture_is_not_visible_either() -> None:
    """Of a pair that was shifted before it was handed out, disparities may be below 0."""
    seen = replace(scene(), truth=np.full((120, 240), -7, np.float32)).visible()
    assert seen[:, :233].all() and not seen[:, 233:].any()


def test_dense_scores_of_known_errors() -> None:
    known = scene()
    seen = known.visible()
    assert score_dense(known, known.truth, 7.0).took_ms == 7.0
    perfect = score_dense(known, known.truth, 0.0)
    assert (perfect.bad_half, perfect.bad_2, perfect.invalid, perfect.rms_px) == (0.0, 0.0, 0.0, 0.0)
    off = known.truth + 1.5
    off[:30] += 1.0
    score = score_dense(known, off, 0.0)
    upper = 100 * seen[:30].sum() / seen.sum()
    assert score.bad_1 == 100.0 and score.bad_2 == pytest.approx(upper) == score.bad_2_of_known
    assert score.rms_px == pytest.approx(1.5)
    holes = known.truth.copy()
    holes[:, 200:] = np.nan
    holes[100:] = np.nan
    score = score_dense(known, holes, 0.0)
    assert score.invalid == pytest.approx(100 * (seen[:, 200:].sum() + seen[100:, :200].sum()) / seen.sum())
    # Filled: the columns get their row's last disparity, which is right; empty rows stay empty and count as bad.
    assert score.bad_2 == pytest.approx(100 * seen[100:].sum() / seen.sum()) and score.bad_2_of_known == 0.0


def test_sparse_scores_of_known_errors() -> None:
    known = scene()
    points = np.array([[20.0, 10.0], [60, 10], [100, 10], [140, 50], [5, 10], [110, 50]])  # the last two are hidden
    matched, disparity = points[:4], np.array([12.3, 12.4, 20.0, 30.0])
    score = score_sparse(known, SparseResult(points, matched, disparity), 1.0)
    assert (score.points, score.matches, score.precision, score.recall) == (6, 4, 75.0, 75.0)
    assert score.rms_px == pytest.approx(np.sqrt((0.3**2 + 0.4**2) / 3))
    nothing = score_sparse(known, SparseResult(points, points[:0], disparity[:0]), 1.0)
    assert np.isnan(nothing.precision) and nothing.recall == 0.0


def write_scene(folder: Path, form: str, known: StereoScene) -> None:
    folder.mkdir()
    names = {"grey": ("aL.png", "aR.png", "aGT.png"), "npz": ("m_left.png", "m_right.png", "m_disp.npz")}
    left, right, truth = (folder / name for name in names[form])
    cv2.imwrite(str(left), known.left)
    cv2.imwrite(str(right), known.right)
    if form == "grey":
        cv2.imwrite(str(truth), np.nan_to_num(known.truth).astype(np.uint8))
    else:
        np.savez(truth, np.where(np.isfinite(known.truth), known.truth, np.inf))


@pytest.mark.parametrize("form", ["grey", "npz"])
def test_folders_give_the_pair_with_its_truth(tmp_path: Path, form: str) -> None:
    known = scene()
    known.truth[5, 7] = NAN
    write_scene(tmp_path / "one", form, known)
    (found,) = scenes(tmp_path)
    assert found.name == "one" and np.array_equal(found.left, known.left) and np.array_equal(found.right, known.right)
    assert np.array_equal(found.truth, known.truth, equal_nan=True) and found.disparities() == 32
    (half,) = scenes(tmp_path, truth_scale=0.5, scale=0.5)
    assert half.left.shape == (60, 120) and np.nanmax(half.truth) == 7.5


@pytest.mark.parametrize("which", ["m_right.png", "m_disp.npz"])
@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_a_file_of_another_size_is_refused_also_where_all_are_made_smaller(
    tmp_path: Path, which: str, scale: float
) -> None:
    write_scene(tmp_path / "one", "npz", scene())
    if which == "m_disp.npz":  # of half the size, its unit is a pixel of its own
        np.savez(tmp_path / "one" / which, scene().truth[::2, ::2] / 2)
    else:
        cv2.imwrite(str(tmp_path / "one" / which), scene().right[::2, ::2])
    with pytest.raises(ValueError, match=r"one: .*\(60, 120\).*; they must be equal"):
        list(scenes(tmp_path, scale=scale))


@pytest.mark.parametrize(("scale", "order"), [("-1", "<"), ("-0.003922", "<"), ("1.0", ">")])
def test_the_size_of_a_float_map_s_scale_means_nothing(tmp_path: Path, scale: str, order: str) -> None:
    """Middlebury's files of 2014 have -0.003922, and their values are pixels."""
    known = scene()
    known.truth[5, 7] = NAN
    cv2.imwrite(str(tmp_path / "im0.png"), known.left)
    cv2.imwrite(str(tmp_path / "im1.png"), known.right)
    rows = np.where(np.isfinite(known.truth), known.truth, np.inf)[::-1]
    (tmp_path / "disp0.pfm").write_bytes(f"Pf\n240 120\n{scale}\n".encode() + rows.astype(f"{order}f4").tobytes())
    (found,) = scenes(tmp_path)
    np.testing.assert_array_equal(found.truth, known.truth)
    (tmp_path / "disp0.pfm").write_bytes(b"Pf\n240 120\n-1\n" + bytes(100))
    with pytest.raises(ValueError, match=r"disp0\.pfm is no disparity that can be read"):
        list(scenes(tmp_path))


@pytest.mark.parametrize(("suffix", "content"), [("npy", b""), ("npz", b"PK\x03\x04 cut off"), ("npz", b"")])
def test_a_disparity_that_was_cut_off_is_named(tmp_path: Path, suffix: str, content: bytes, capsys: Any) -> None:
    write_scene(tmp_path / "one", "npz", scene())
    (tmp_path / "one" / "m_disp.npz").unlink()
    (tmp_path / "one" / f"m_disp.{suffix}").write_bytes(content)
    assert main([str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    assert f"m_disp.{suffix} is no disparity that can be read" in capsys.readouterr().err


def test_each_pair_has_a_name_of_its_own(tmp_path: Path, monkeypatch: Any) -> None:
    """Tables and pictures are filed by it: two pairs in one folder came out as one."""
    for folder, prefix in (("both", "first"), ("both", "second"), ("more/both", ""), ("alone", "x")):
        (tmp_path / folder).mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(tmp_path / folder / f"{prefix}_left.png"), scene().left)
        cv2.imwrite(str(tmp_path / folder / f"{prefix}_right.png"), scene().right)
        np.save(tmp_path / folder / f"{prefix}_disp.npy", scene().truth)
    assert [s.name for s in scenes(tmp_path)] == ["alone", "both_first", "both_second", "more_both"]
    monkeypatch.chdir(tmp_path / "alone")
    assert [s.name for s in scenes(Path())] == ["alone"]


def test_the_command_prints_and_writes_what_it_found(tmp_path: Path, capsys: Any, monkeypatch: Any) -> None:
    write_scene(tmp_path / "one", "npz", scene())
    monkeypatch.setattr("sys.argv", ["stereo", "evaluate", str(tmp_path / "one"), "-o", str(tmp_path / "out")])
    assert stereo() == 0
    text = capsys.readouterr().out
    rows = json.loads((tmp_path / "out" / "stereo.json").read_text())
    assert [(r["kind"], r["method"].split(",")[0]) for r in rows] == [
        ("dense", "ours"),
        ("dense", "SGBM as image_pipeline"),
        ("dense", "BM as image_pipeline"),
        ("sparse", "ours"),
        ("sparse", "ours"),
        ("sparse", "ORB"),
        ("sparse", "SIFT"),
        ("sparse", "Harris"),
        ("sparse", "Harris"),
    ]
    assert rows[0]["bad_2"] < 4.0 and rows[0]["bad_2"] < min(rows[1]["bad_2"], rows[2]["bad_2"])
    assert rows[3]["precision"] > 95.0 and f"{rows[3]['precision']:.4g}" in text
    picture = cv2.imread(str(tmp_path / "out" / "one.png"))
    assert picture.shape == (2 * (120 + 28), 5 * 240, 3)
    # Where ours is right the error is the colour scale's dark end.
    assert picture[2 * 28 + 120 + 50, 240 + 200].max() < 100


def test_a_pair_without_any_corner_is_evaluated_and_its_table_is_json(tmp_path: Path) -> None:
    dark = np.zeros_like(scene().left)
    write_scene(tmp_path / "one", "npz", replace(scene(), left=dark, right=dark))
    assert main([str(tmp_path / "one"), "-o", str(tmp_path / "out")]) == 0
    text = (tmp_path / "out" / "stereo.json").read_text()
    rows = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert {(row["points"], row["precision"]) for row in rows if row["kind"] == "sparse"} == {(0, None)}


def test_what_cannot_be_evaluated_is_said(tmp_path: Path, capsys: Any) -> None:
    assert main([str(tmp_path)]) == 2
    assert "no pair with known disparity" in capsys.readouterr().err
    assert main([str(tmp_path), "--scale", "2"]) == 2
    assert "scale 2: from 0.05 to 1" in capsys.readouterr().err
    known = scene()
    with pytest.raises(ValueError, match=r"made: .*\(120, 239\)"):
        StereoScene(name="made", left=known.left[:, :239], right=known.right, truth=known.truth)
    with pytest.raises(ValueError, match="no disparity at all"):
        StereoScene(name="made", left=known.left, right=known.right, truth=known.truth * NAN)
    write_scene(tmp_path / "one", "npz", known)
    given = [str(tmp_path), "-o", str(tmp_path / "out"), "--truth-scale"]
    for scale in ("0", "-1", "nan", "inf"):
        assert main([*given, scale]) == 2
        assert f"truth scale {scale}; expected more than 0" in capsys.readouterr().err
    for scale, reached in (("7.5", "225"), ("256", "7680")):
        assert main([*given, scale]) == 2
        assert f"reaches {reached} px, with pictures 240 px wide below 224 px are possible" in capsys.readouterr().err
    StereoScene(name="made", left=known.left, right=known.right, truth=known.truth / 30 * np.float32(223.9))


def test_goals_on_photographs_with_known_disparity(tmp_path: Path, capsys: Any) -> None:
    place = os.environ.get("ICU_TEST_DATA")
    if not place or not (Path(place) / "stereo").is_dir():
        pytest.skip("ICU_TEST_DATA names no folder with stereo/: photographs with known disparity")
    assert main([str(Path(place) / "stereo"), "-o", str(tmp_path)]) == 0
    rows = json.loads((tmp_path / "stereo.json").read_text())
    dense: dict[str, dict[str, float]] = {}
    for row in rows:
        if row["kind"] == "dense":
            dense.setdefault(row["scene"], {})[row["method"]] = row["bad_2"]
    assert len(dense) >= 2
    for bad in dense.values():
        assert bad["ours"] < min(value for name, value in bad.items() if name != "ours")
    assert np.mean([bad["ours"] for bad in dense.values()]) <= 3.6
    sparse = {scene: {r["method"]: r for r in rows if r["scene"] == scene and r["kind"] == "sparse"} for scene in dense}
    means = {
        method: [np.mean([r[key] for r in rows if r["method"] == method and r["kind"] == "sparse"]) for key in keys]
        for keys in [("precision", "recall")]
        for method in next(iter(sparse.values()))
    }
    for method in set(means) - {"ours", ALL_CORNERS}:
        assert means["ours"][0] > means[method][0] and means["ours"][1] > means[method][1], method
    assert min(scores["ours"]["precision"] for scores in sparse.values()) >= 93.0
    # When a few more wrong matches are accepted, each peer is beaten in both at once on each pair.
    for name, scores in sparse.items():
        mine = scores.pop(ALL_CORNERS)
        del scores["ours"]
        for method, peer in scores.items():
            assert mine["precision"] > peer["precision"] and mine["recall"] > peer["recall"], (name, method)
