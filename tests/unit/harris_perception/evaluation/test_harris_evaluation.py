"""Repeatability on points whose rate is known by construction, and the command line on small pictures."""

from __future__ import annotations

import csv
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from harris_perception.adapters.picture_files import read_bgr, read_deep_gray, read_gray, sequences
from harris_perception.cli import harris_evaluate
from harris_perception.cli.harris import main
from harris_perception.cli.tables import write_table
from harris_perception.core.evaluation.repeatability import (
    HomographyPair,
    best_on_average,
    mapped,
    means,
    our_detectors,
    peer_detectors,
    repeatability,
    warps,
)

pytestmark = pytest.mark.long


def pair(homography: np.ndarray, size: tuple[int, int] = (200, 300)) -> HomographyPair:
    return HomographyPair("test", 1.0, np.zeros(size, np.uint8), np.zeros(size, np.uint8), homography)


def test_rate_counts_pairs_within_epsilon_one_to_one() -> None:
    h = np.array([[1.0, 0.0, 30.0], [0.0, 1.0, 10.0], [0.0, 0.0, 1.0]])
    first = np.array([(50.0, 50.0), (120.0, 60.0), (60.0, 150.0), (200.0, 100.0)])
    second = mapped(first, h) + [(0.4, 0.0), (0.0, 1.2), (2.5, 0.0), (40.0, 40.0)]
    rate = repeatability(pair(h), first, second, (0.5, 1.5, 3.0))
    assert (rate.rates, rate.count) == ((0.25, 0.5, 0.75), 4)
    doubled = np.vstack((second, second + 0.1))  # duplicates must not repeat twice
    assert repeatability(pair(h), np.vstack((first, first[:1])), doubled, (0.3,)).rates[0] < 0.5


@pytest.mark.parametrize("scale", [1e-12, -1e-9, 1e3, -7e6])
def test_homographies_of_any_scale_say_the_same(scale: float) -> None:
    h = np.array([[0.9, 0.1, 20.0], [-0.05, 1.1, 5.0], [2e-4, -1e-4, 1.0]])
    rng = np.random.default_rng(2)
    first = rng.uniform((0, 0), (300, 200), (60, 2))
    second = mapped(first, h) + rng.normal(0.0, 1.0, first.shape)
    expected = repeatability(pair(h), first, second)
    assert expected.count > 30 and expected.rates[-1] > 0.9
    found = repeatability(pair(scale * h), first, second)
    assert (found.rates, found.chance, found.count) == (expected.rates, expected.chance, expected.count)


def test_only_the_common_part_counts() -> None:
    h = np.array([[1.0, 0.0, 150.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    first = np.array([(50.0, 50.0), (100.0, 90.0), (200.0, 100.0), (280.0, 20.0)])  # the last two leave the picture
    second = np.vstack((mapped(first[:2], h), [(20.0, 20.0)]))  # the last one is not in the first picture
    rate = repeatability(pair(h), first, second, (1.0,))
    assert rate.rates == (1.0,) and rate.count == 2
    assert repeatability(pair(h), first[2:], second, (1.0,)).count == 0


def test_chance_is_that_of_points_which_have_nothing_to_do_with_each_other() -> None:
    rng = np.random.default_rng(3)
    a, b = (rng.uniform((0, 0), (300, 200), (800, 2)) for _ in range(2))
    rate = repeatability(pair(np.eye(3)), a, b, (1.5, 5.0))
    assert abs(rate.chance[0] - rate.rates[0]) < 0.06 and rate.rates[0] > 0.03
    assert repeatability(pair(np.eye(3)), a, a, (0.5,)).rates == (1.0,)


def photograph() -> np.ndarray:
    rng = np.random.default_rng(7)
    blocks = np.kron(rng.integers(0, 256, (16, 20)), np.ones((10, 10))).astype(np.uint8)
    return cv2.GaussianBlur(blocks, (0, 0), 0.8)


def test_warps_show_what_their_homography_says() -> None:
    picture = photograph()
    seen: dict[str, int] = {}
    for made in warps(picture, np.random.default_rng(0), noise=0.0):
        seen[made.change] = seen.get(made.change, 0) + 1
        if made.change in ("light", "noise"):
            np.testing.assert_array_equal(made.homography, np.eye(3))
            continue
        expected = cv2.warpPerspective(picture, made.homography, picture.shape[::-1], flags=cv2.INTER_LINEAR)
        visible = cv2.warpPerspective(np.full_like(picture, 255), made.homography, picture.shape[::-1]) == 255
        visible = cv2.erode(visible.astype(np.uint8), np.ones((5, 5))) > 0
        assert visible.mean() > 0.05
        difference = np.abs(made.second.astype(float) - expected)[visible]
        assert difference.mean() < 14.0, (made.change, made.amount)
    assert seen == {"rotation": 7, "scale": 5, "light": 5, "viewpoint": 4, "noise": 4}


@pytest.mark.parametrize("scale", [1.0, 2.0, 3.0])
def test_chance_is_that_of_the_common_part_alone(scale: float) -> None:
    rng = np.random.default_rng(5)
    size = np.array([480.0, 320.0])
    h = np.array([[1 / scale, 0, 240 * (1 - 1 / scale)], [0, 1 / scale, 160 * (1 - 1 / scale)], [0, 0, 1.0]])
    one, other = rng.uniform((6, 6), size - 7, (800, 2)), rng.uniform((6, 6), size - 7, (800, 2))
    other = mapped(other, h)  # as many again, anywhere in what both show
    rate = repeatability(pair(h, (320, 480)), one, other, (1.5,))
    assert rate.count > 700 and rate.rates[0] > 0.03 * scale
    assert rate.chance[0] == pytest.approx(rate.rates[0], abs=0.03)


@pytest.mark.parametrize("name", [*our_detectors(), *peer_detectors()])
def test_each_detector_repeats_far_above_chance_under_rotation(name: str) -> None:
    find = (our_detectors() | peer_detectors())[name]
    turned = next(iter(warps(photograph(), np.random.default_rng(1))))
    a, b = find(turned.first, 100), find(turned.second, 100)
    assert 20 < len(a) <= 100 and a.shape[1] == 2
    rate = repeatability(turned, a, b, (3.0,))
    assert rate.rates[0] > 0.3 > rate.chance[0]


def test_peers_are_found_where_opencv_moved_them(monkeypatch: pytest.MonkeyPatch) -> None:
    def moved(threshold: float) -> Any:
        assert threshold > 0.0
        return cv2.SIFT_create(100)  # type: ignore[attr-defined]

    monkeypatch.delattr(cv2, "AKAZE_create", raising=False)
    monkeypatch.setattr(cv2, "xfeatures2d", SimpleNamespace(AKAZE_create=moved), raising=False)
    found = peer_detectors()["cv2 AKAZE"](photograph(), 100)
    assert len(found) > 20
    assert np.array_equal(found, peer_detectors()["cv2 SIFT"](photograph(), 100))


def places(table: Path) -> set[tuple[int, int]]:
    """Return the corners of a table, to the pixel."""
    with table.open() as stream:
        return {(round(float(row["x_px"])), round(float(row["y_px"]))) for row in csv.DictReader(stream)}


def test_detect_writes_picture_and_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = np.full((80, 90), 50, np.uint8)
    picture[20:60, 20:70] = 220
    square = {(20, 20), (69, 20), (20, 59), (69, 59)}
    source, drawn, table = tmp_path / "in.png", tmp_path / "out.png", tmp_path / "corners.csv"
    cv2.imwrite(str(source), picture)
    assert main(["detect", str(source), "-o", str(drawn), "--table", str(table), "--edges"]) == 0
    assert capsys.readouterr().out.startswith("4 corners, ")
    assert places(table) == square
    colored = cv2.imread(str(drawn))
    assert colored.shape == (80, 90, 3) and colored[20, 20, 1] > colored[20, 20, 0] + 50
    assert (colored[17:23, 45] == (255, 160, 0)).all(axis=1).any()  # the upper side
    labels, chains = tmp_path / "labels.png", tmp_path / "chains.json"
    assert main(["detect", str(source), "--edges", "combined", "--labels", str(labels), "--chains", str(chains)]) == 0
    seen = cv2.imread(str(labels), cv2.IMREAD_UNCHANGED)
    assert seen.shape == (80, 90) and (seen == 255).sum() == 4
    linked = {(row["x_px"], row["y_px"]) for row in json.loads(chains.read_text())}
    assert linked - square == {(int(x), int(y)) for y, x in np.argwhere(seen == 128)}
    assert main(["detect", str(source), "--labels", str(labels)]) == 2
    assert "--edges" in capsys.readouterr().err
    unlit = picture.astype(np.uint16)  # of 65535
    for deep, count in ((unlit, 4), (np.full((80, 90), 500, np.uint16), 0), (np.float32(unlit / 1e4), 4)):
        file = tmp_path / ("deep.tiff" if deep.dtype == np.float32 else "deep.png")
        cv2.imwrite(str(file), deep)
        assert main(["detect", str(file), "--edges", "--table", str(table)]) == 0
        assert table.read_text().startswith("x_px,y_px,response") and len(table.read_text().splitlines()) == 1 + count
    assert main(["detect", str(source), "--scales", "2", "--table", str(table), "--edges"]) == 0
    assert {round(float(row["scale"]), 2) for row in csv.DictReader(table.open())} == {1.0, 1.26}
    assert main(["detect", str(source), "--scales", "-1"]) == 2
    capsys.readouterr()
    assert main(["detect", str(source), "--repeatable", "--table", str(table), "--set", "least=0.002"]) == 0
    assert capsys.readouterr().out == "4 corners\n"
    assert places(table) == square
    for wrong, told in (
        (["--scales", "2", "--edges", "combined"], "--edges"),
        (["--repeatable", "--edges", "combined"], "--edges"),
        (["--repeatable", "--scales", "2"], "--scales"),
        (["--repeatable", "--set", "window_px=5"], "window_px"),
        (["--repeatable", "--set", "least=2"], "least"),
    ):
        assert main(["detect", str(source), *wrong]) == 2
        assert told in capsys.readouterr().err, wrong


def test_match_finds_a_shifted_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = photograph()
    first, second, table = tmp_path / "a.png", tmp_path / "b.png", tmp_path / "m.json"
    cv2.imwrite(str(first), picture)
    cv2.imwrite(str(second), np.roll(picture, (6, 9), axis=(0, 1)))
    drawn = tmp_path / "m.png"
    settings = ["--set", "gradient=gaussian", "--set", "window=gaussian", "--set-match", "oriented=false"]
    assert main(["match", str(first), str(second), "--table", str(table), "-o", str(drawn), *settings]) == 0
    rows = json.loads(table.read_text())
    assert len(rows) > 40 and f"{len(rows)} agree (homography)" in capsys.readouterr().out
    shift = np.array([(r["x2_px"] - r["x1_px"], r["y2_px"] - r["y1_px"]) for r in rows])
    np.testing.assert_allclose(np.median(shift, axis=0), (9.0, 6.0), atol=0.05)
    assert cv2.imread(str(drawn)).shape == (160, 400, 3)


def test_match_finds_the_box_in_the_scene(capsys: pytest.CaptureFixture[str]) -> None:
    folder = Path(os.environ.get("ICU_TEST_DATA", "")) / "object"
    if not (folder / "box.png").is_file():
        pytest.skip("needs object/box.png and box_in_scene.png below ICU_TEST_DATA")
    assert main(["match", str(folder / "box.png"), str(folder / "box_in_scene.png")]) == 0
    printed = capsys.readouterr().out
    assert int(re.search(r"(\d+) agree", printed)[1]) > 40
    outline = np.array(re.findall(r"\((\d+), (\d+)\)", printed), float)
    # Read off the picture by eye.
    np.testing.assert_allclose(outline, [(118, 161), (285, 175), (267, 297), (90, 272)], atol=5.0)


def test_pictures_of_floats_are_read_as_they_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dark = np.full((120, 160), -200, np.float32)
    dark[40:80, 50:110] = -40
    hidden = dark.copy()
    hidden[90:100, 20:30] = np.nan
    for name, picture in (("dark", dark), ("hidden", hidden)):
        cv2.imwrite(str(tmp_path / f"{name}.tif"), picture)
        chains = tmp_path / "chains.json"
        assert main(["detect", str(tmp_path / f"{name}.tif"), "--edges", "--chains", str(chains)]) == 0
        assert capsys.readouterr().out.startswith("4 corners"), name
        places = np.array([(r["x_px"], r["y_px"]) for r in json.loads(chains.read_text())])
        assert len(places) > 150 and ((places >= (48, 38)) & (places <= (111, 81))).all(), name
    assert main(["match", str(tmp_path / "dark.tif"), str(tmp_path / "hidden.tif"), "--scales", "1"]) == 0
    assert capsys.readouterr().out.startswith("4 and 4 corners")


def test_a_picture_in_colored_light_is_as_bright_in_16_bits_as_in_8(tmp_path: Path) -> None:
    blue = np.zeros((60, 80, 3), np.uint8)
    blue[20:40, 30:60] = (255, 40, 40)
    for name, picture in (("8.png", blue), ("16.png", blue.astype(np.uint16) * 257)):
        assert cv2.imwrite(str(tmp_path / name), picture)
    eight, deep = read_gray(tmp_path / "8.png"), read_deep_gray(tmp_path / "16.png")
    assert eight.max() < 70 and deep.dtype == np.float32
    np.testing.assert_allclose(deep, eight, atol=1.0)
    np.testing.assert_array_equal(read_bgr(tmp_path / "16.png"), blue)


def test_numbers_may_have_an_exponent_and_scales_be_selected(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(tmp_path / "p.png")
    cv2.imwrite(path, photograph())

    def count(*arguments: str) -> int:
        assert main(["detect", path, *arguments]) == 0
        return int(capsys.readouterr().out.split()[0])

    plain = ("--set", "relative_threshold=0.0", "--set")
    assert 0 < count(*plain, "absolute_threshold=1e9") == count(*plain, "absolute_threshold=1000000000.0")
    assert count(*plain, "absolute_threshold=1e9") < count(*plain, "absolute_threshold=0.0")
    assert 0 < count("--scales", "8", "--select") < count("--scales", "8")


def test_evaluate_reads_sequences_and_writes_tables_and_curves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "seq" / "turned"
    folder.mkdir(parents=True)
    for number, made in enumerate(warps(photograph(), np.random.default_rng(0)), start=2):
        cv2.imwrite(str(folder / "img1.png"), made.first)
        cv2.imwrite(str(folder / f"img{number}.png"), made.second)
        np.savetxt(folder / f"H1to{number}p", made.homography)
        if number == 3:
            break
    out = tmp_path / "out"
    assert main(["evaluate", str(tmp_path / "seq"), "-o", str(out), "--count", "80"]) == 0
    printed = capsys.readouterr().out
    rows = json.loads((out / "repeatability.json").read_text())
    names = {r["detector"] for r in rows}
    assert {"harris 1988 (default)", "impharris 1 / 2", "cv2 Harris", "cv2 SIFT"} <= names
    assert all(name in printed for name in names)
    assert {r["change"] for r in rows} == {"turned"} and {r["amount"] for r in rows} == {2.0, 3.0}
    assert len(rows) == len(names) * 2 * 6 == len(list(csv.DictReader((out / "repeatability.csv").open())))
    assert cv2.imread(str(out / "turned.png")) is not None
    fewest = min(len(find(made.first, 80)) for find in (our_detectors() | peer_detectors()).values())
    assert fewest < max(r["points"] for r in rows)
    assert main(["evaluate", str(tmp_path / "seq"), "-o", str(out), "--count", "80", "--equal-counts"]) == 0
    rows = json.loads((out / "repeatability.json").read_text())
    assert 0 < max(r["points"] for r in rows) <= fewest
    assert "as many of each as the fewest" in capsys.readouterr().out


def test_names_that_are_not_utf8_are_escaped_in_tables_and_curves(tmp_path: Path) -> None:
    """No curve can be drawn under such a name, nor a table be written, after all work is done."""
    place = Path(os.fsdecode(os.fsencode(tmp_path) + b"/caf\xe9"))
    place.mkdir()
    for number in (1, 2):
        (place / f"img{number}.png").touch()
    np.savetxt(place / "H1to2p", np.eye(3))
    (found,) = sequences(tmp_path)
    assert found.change == r"caf\udce9"
    write_table(tmp_path / "names.csv", ("picture",), [(place.name,)])
    assert (tmp_path / "names.csv").read_text().split() == ["picture", r"caf\udce9"]


@pytest.mark.parametrize(
    ("picture", "homography", "text"),
    [
        ("img{}.PPM", "H1to{}p.txt", "{}"),
        ("{}.ppm", "H_1_{}.txt", "{}"),
        ("img{}.png", "H1to{}p.xml", '<?xml version="1.0"?><H13 type_id="opencv-matrix">\n<data>\n{}</data></H13>'),
    ],
)
def test_files_of_homographies_may_have_an_ending(picture: str, homography: str, text: str, tmp_path: Path) -> None:
    for number in (1, 2):
        cv2.imwrite(str(tmp_path / picture.format(number)), np.zeros((20, 20, 3), np.uint8))
    (tmp_path / homography.format(2)).write_text(text.format("1 0 7.5\n0 1 -2\n0 0 1\n"))
    (found,) = sequences(tmp_path)
    assert found.homographies[2].tolist() == [[1.0, 0.0, 7.5], [0.0, 1.0, -2.0], [0.0, 0.0, 1.0]]


def test_a_sequence_whose_pictures_are_there_in_two_formats_counts_once(tmp_path: Path) -> None:
    for name in ("img1.png", "img1.ppm", "img2.png", "img2.ppm"):
        cv2.imwrite(str(tmp_path / name), np.zeros((20, 20, 3), np.uint8))
    np.savetxt(tmp_path / "H1to2p", np.eye(3))
    (found,) = sequences(tmp_path)
    assert list(found.others) == [2] and found.first.suffix == found.others[2].suffix


def test_evaluate_keeps_no_more_than_one_pair_of_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("a.png", "b.png"):
        cv2.imwrite(str(tmp_path / name), photograph())
    made, most = 0, 0

    def counted(*arguments: Any) -> Iterator[HomographyPair]:
        nonlocal made
        for each in islice(warps(*arguments), 2):
            made += 1
            yield each

    def measured(*arguments: Any) -> Any:
        nonlocal most, made
        most, made = max(most, made), 0
        return repeatability(*arguments)

    monkeypatch.setattr(harris_evaluate, "warps", counted)
    monkeypatch.setattr(harris_evaluate, "repeatability", measured)
    for find in ("our_detectors", "peer_detectors"):
        monkeypatch.setattr(harris_evaluate, find, lambda find=find: {find: lambda picture, count: np.zeros((0, 2))})
    assert main(["evaluate", str(tmp_path), "-o", str(tmp_path / "out")]) == 0
    assert most == 1


def test_setting_is_chosen_on_one_half_and_reported_on_the_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = list(warps(photograph(), np.random.default_rng(0)))
    for name, kept, names in (("b", made[20], "img{}.png H1to2p"), ("i_a", made[0], "{}.ppm H_1_2")):
        folder = tmp_path / "seq" / name
        folder.mkdir(parents=True)
        picture, homography = names.split()
        cv2.imwrite(str(folder / picture.format(1)), cv2.merge([kept.first] * 3))
        cv2.imwrite(str(folder / picture.format(2)), cv2.merge([kept.second] * 3))
        np.savetxt(folder / homography, kept.homography)
    out = tmp_path / "out"
    assert main(["evaluate", str(tmp_path / "seq"), "-o", str(out), "--count", "80"]) == 0
    rows = json.loads((out / "repeatability.json").read_text())
    assert {(r["change"], r["half"]) for r in rows} == {("b", "chosen on"), ("HPatches light", "reported")}
    at = [r for r in rows if r["epsilon_px"] == 1.5]
    best = max(
        (r for r in at if r["change"] == "b" and r["detector"] in our_detectors()), key=lambda r: r["repeatability"]
    )
    printed = capsys.readouterr().out.splitlines()
    chosen = [line for line in printed if line.startswith("* ")]
    assert len(chosen) == 1 and chosen[0][2:].startswith(best["detector"])
    mine, peer = (
        max(r["repeatability"] for r in at if r["change"] == "HPatches light" and test(r["detector"]))
        for test in (lambda n: n == best["detector"], lambda n: n in peer_detectors())
    )
    assert any(line.startswith("not first on HPatches light: ") for line in printed) == (peer > mine)


def test_best_on_average_weighs_every_change_alike() -> None:
    rows = [
        {"change": change, "detector": name, "repeatability": rate}
        for change, name, rates in (
            ("x", "p", (0.9, 0.9, 0.9)),
            ("x", "q", (0.8,) * 3),
            ("y", "p", (0.1,)),
            ("y", "q", (0.3,)),
        )
        for rate in rates
    ]
    assert means(rows, "repeatability")["x", "p"] == pytest.approx(0.9)
    assert best_on_average(rows, ["p", "q"]) == "q"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["detect", "missing.png"], "missing.png does not exist"),
        (["detect", "EMPTY"], "is no picture"),
        (["detect", "PICTURE", "--set", "k=[1"], "'k=[1'"),
        (["detect", "PICTURE", "--set", "k=2026-13-45"], "'k=2026-13-45'"),
        (["detect", "PICTURE", "--set-edges", "high=3"], "--set-edges need --edges"),
        (["detect", "PICTURE", "--set", "k=7"], "k = 7"),
        (["detect", "PICTURE", "--set", "kk=0.04"], "kk"),
        (["detect", "PICTURE", "--set", "k"], "KEY=VALUE"),
        (["detect", "PICTURE", "--table", "corners.txt"], ".csv or .json"),
        (["detect", "PICTURE", "-o", "corners.nothing"], "cannot be written"),
        (["detect", "PICTURE", "-o", "corners.pgm"], "cannot write corners.pgm"),
        (["evaluate", "EMPTY", "-o", "OUT"], "neither sequences"),
        (["evaluate", "PICTURE", "-o", "OUT", "--count", "0"], "--count 0: 1 to 5000"),
        (["evaluate", "PICTURE", "-o", "OUT", "--count", "20000"], "--count 20000: 1 to 5000"),
        (["evaluate", "PICTURE", "-o", "OUT", "--seed", "-1"], "--seed -1: 0 to"),
        (["evaluate", "NARROW", "-o", "OUT"], "300 x 1 px, at least 64"),
        (["evaluate", "PICTURE", "EMPTY/light.png", "-o", "EMPTY"], "light.png: curves would be written over it"),
        (["detect", "PICTURE", "--scales", "31"], "--scales 31: 1 to 30"),
        (["detect", "PICTURE", "--scales", "0"], "--scales 0: 1 to 30"),
        (["match", "PICTURE", "PICTURE", "--scales", "0"], "--scales 0: 1 to 30"),
        (["detect", "PICTURE", "--select"], "--select needs --scales"),
        (["detect", "PICTURE", "--edges", "--labels", "l.jpg"], "l.jpg: the name must end in one of .png"),
        (["match", "PICTURE", "PICTURE", "-o", "/nowhere/m.png", "--table", "x.txt"], "x.txt: the name must end in"),
        (["detect", "HUGE"], "CV_IO_MAX_IMAGE_PIXELS"),
        (["detect", "PICTURE", "-o", "PICTURE"], "p.png: the same file is read"),
        (["match", "NARROW", "PICTURE", "-o", "PICTURE"], "p.png: the same file is read"),
        (["detect", "PICTURE", "--edges", "-o", "x.png", "--labels", "./x.png"], "is written by --output"),
        (["detect", "PICTURE", "--edges", "--table", "x.csv", "--chains", "x.csv"], "is written by --table"),
        (["evaluate", "CUT", "-o", "OUT"], "H1to3p is missing"),
        (["evaluate", "FLAT", "-o", "OUT"], "H1to2p is no homography"),
        (["evaluate", "TORN", "-o", "OUT"], "img2.png is no picture"),
    ],
)
def test_mistakes_end_with_one_line(
    arguments: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cv2.imwrite(str(tmp_path / "p.png"), photograph())
    whole = (tmp_path / "p.png").read_bytes()
    # Its header says 65535 x 65535; OpenCV looks at that before the rest.
    (tmp_path / "h.pgm").write_bytes(b"P5 65535 65535 255 ")
    cv2.imwrite(str(tmp_path / "n.png"), np.full((1, 300), 90, np.uint8))
    same = "1 0 0 0 1 0 0 0 1"
    for folder, pictures, homography in (("EMPTY", 0, ""), ("CUT", 3, same), ("FLAT", 2, same[:-6]), ("TORN", 2, same)):
        (tmp_path / folder).mkdir()
        for number in range(1, pictures + 1):
            (tmp_path / folder / f"img{number}.png").write_bytes((tmp_path / "p.png").read_bytes())
        if pictures:
            (tmp_path / folder / "H1to2p").write_text(homography)
    (tmp_path / "TORN" / "img2.png").write_bytes(whole[: len(whole) // 2])
    if "EMPTY/light.png" in arguments:
        (tmp_path / "EMPTY" / "light.png").write_bytes(whole)
    names = {"PICTURE": "p.png", "NARROW": "n.png", "OUT": "out", "EMPTY": "EMPTY", "CUT": "CUT", "FLAT": "FLAT"}
    names |= {"HUGE": "h.pgm", "TORN": "TORN", "EMPTY/light.png": "EMPTY/light.png"}
    assert main([str(tmp_path / names[a]) if a in names else a for a in arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and words in error and error.count("\n") == 1
    assert (tmp_path / "p.png").read_bytes() == whole and not (tmp_path / "out").exists()


def test_a_picture_whose_name_is_not_utf8_is_read(tmp_path: Path) -> None:
    """OpenCV ends the process by such a name (of an old disk, or of another system)."""
    written = tmp_path / "whole.png"
    cv2.imwrite(str(written), np.kron(np.eye(4, dtype=np.uint8) * 255, np.ones((16, 16), np.uint8)))
    named = written.rename(Path(os.fsdecode(os.fsencode(tmp_path) + b"/caf\xe9.png")))
    command = [sys.executable, "-m", "harris_perception.cli.harris", "detect", named]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert (ended.returncode, ended.stderr) == (0, "") and re.fullmatch(r"[1-9]\d* corners\n", ended.stdout)


@pytest.mark.parametrize(("option", "name"), [("--output", "o.png"), ("--table", "t.csv"), ("--table", "t.json")])
def test_what_does_not_fit_on_the_disk_is_named(
    option: str, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """There may be three files to write, and they may be on different disks."""
    cv2.imwrite(str(tmp_path / "p.png"), np.kron(np.eye(4, dtype=np.uint8) * 255, np.ones((16, 16), np.uint8)))
    (tmp_path / name).symlink_to("/dev/full")
    assert main(["detect", str(tmp_path / "p.png"), option, str(tmp_path / name)]) == 2
    error = capsys.readouterr().err
    assert error == f"error: [Errno 28] No space left on device: '{tmp_path / name}'\n"
