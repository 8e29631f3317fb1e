"""The command that solves AX = XB from a file: its figures, its file, and what it says about bad input."""

from __future__ import annotations

import os
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from harris_perception.cli.hand_eye import main
from icu_common.core.geometry.geometry import Transform

X = Transform(np.asarray(cv2.Rodrigues(np.array([0.1, -0.2, 1.5]))[0], dtype=float), np.array([0.03, -0.05, 0.11]))
Z = Transform(np.asarray(cv2.Rodrigues(np.array([0.5, 0.3, -0.4]))[0], dtype=float), np.array([0.6, 0.1, 0.02]))


def rows(fixed: bool = False, turn: float = 0.8) -> list[str]:
    rng = np.random.default_rng(1)
    lines = []
    for _ in range(10):
        rotation = np.asarray(cv2.Rodrigues(rng.uniform(-turn, turn, 3))[0], dtype=float)
        a = Transform(rotation, rng.uniform(-0.3, 0.3, 3))
        b = X.inverse() @ a @ Z if fixed else (a @ X).inverse() @ Z
        lines.append(",".join(f"{v:.9f}" for t in (a, b) for v in (*t.translation, *t.quaternion())))
    return lines


@pytest.mark.parametrize("fixed", [False, True])
def test_poses_become_both_transforms(fixed: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    poses, out = tmp_path / "poses.csv", tmp_path / "out.yaml"
    poses.write_text("\n".join(["px,py,pz," + "q," * 10 + "qw", "", *rows(fixed)]))
    assert main([str(poses), "-o", str(out), *(["--fixed-camera"] if fixed else [])]) == 0
    said = capsys.readouterr().out
    assert "10 poses used" in said and "predicted sigma of" in said
    document = yaml.safe_load(out.read_text())
    names = ("base_from_camera", "gripper_from_target") if fixed else ("gripper_from_camera", "base_from_target")
    for name, truth in zip(names, (X, Z)):
        np.testing.assert_allclose(document[name]["translation_m"], truth.translation, atol=1e-6)
        np.testing.assert_allclose(document[name]["quaternion_xyzw"], truth.quaternion(), atol=1e-6)


def test_a_file_of_a_spreadsheet_is_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    poses = tmp_path / "poses.csv"
    poses.write_bytes("\r\n".join(rows()).encode("utf-8-sig"))
    assert main([str(poses)]) == 0
    assert "10 poses used" in capsys.readouterr().out


def test_the_file_numbers_poses_as_the_terminal_does(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    poses, out = tmp_path / "poses.csv", tmp_path / "out.yaml"
    lines = rows()
    lines[3] = ",".join(lines[3].split(",")[:7] + lines[5].split(",")[7:])
    poses.write_text("\n".join(lines))
    assert main([str(poses), "-o", str(out)]) == 0
    assert "9 poses used, left out: 4\n" in capsys.readouterr().out
    assert yaml.safe_load(out.read_text())["poses_used"] == [1, 2, 3, 5, 6, 7, 8, 9, 10]


def test_the_result_is_written_though_nobody_reads_what_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "poses.csv").write_text("\n".join(rows()))
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w", buffering=1) as unread:
        monkeypatch.setattr("sys.stdout", unread)
        main([str(tmp_path / "poses.csv"), "-o", str(tmp_path / "out.yaml")])
    assert "covariance" in yaml.safe_load((tmp_path / "out.yaml").read_text())


def test_the_result_is_not_written_over_the_poses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    poses = tmp_path / "poses.csv"
    poses.write_text("\n".join(rows()))
    assert main([str(poses), "-o", str(tmp_path / "." / "poses.csv")]) == 1
    assert "the same file is read; expected another name" in capsys.readouterr().err
    assert poses.read_text() == "\n".join(rows())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("\n".join(rows()[:2]), "2 poses; expected 3"),
        ("\n".join(rows(turn=0.01)), "expected 10: without turns"),
        (rows()[0] + "\n1,2,3", "line 2: 3 values; expected 14"),
        ("\n".join(row.replace(",", ";") for row in rows()), "line 2: could not convert string to float: '.*;"),
        (rows()[0] + "\n" + rows()[1].replace("0.", "x.", 1), "line 2: could not convert"),
        (rows()[0].replace("0.", "O.", 1) + "\n" + "\n".join(rows()[1:]), "line 1: could not convert"),
        (
            rows()[0]
            + "\n"
            + ",".join(rows()[1].split(",")[3:7] + rows()[1].split(",")[:3] + rows()[1].split(",")[7:]),
            r"line 2: quaternion .* has length 1\.015; expected 1 to within 0\.01: the order is x, y, z in metres",
        ),
        ("\n".join(rows(fixed=True)), r"miss one another by .* 3\.0 degrees and 20\.0 mm are accepted"),
        (",".join(["0"] * 14), "line 1: quaternion .* has no direction"),
    ],
)
def test_bad_files_are_refused_by_line(
    text: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    poses = tmp_path / "poses.csv"
    poses.write_text(text)
    assert main([str(poses)]) == 1
    assert re.search(message, capsys.readouterr().err)


@pytest.mark.parametrize("content", [b"\x89PNG\r\n", b"x" * (1 << 18)], ids=["a picture", "one endless cell"])
def test_what_is_no_table_is_refused_by_name(
    content: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    poses = tmp_path / "poses.png"
    poses.write_bytes(content)
    assert main([str(poses)]) == 1
    assert f"error: {poses} is no table of poses: " in capsys.readouterr().err
