"""Edges compared with boundaries that people drew: pairs, F-measures, files in the form of BSDS500, and the command."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from harris_perception.adapters.boundary_files import drawn_pictures
from harris_perception.cli import harris_evaluate
from harris_perception.cli.harris import main
from harris_perception.core.evaluation import boundary_evaluation as boundaries

pytestmark = pytest.mark.long

savemat = pytest.importorskip("scipy.io", reason="drawn boundaries are read by scipy").savemat


def mask(*places: tuple[int, int], shape: tuple[int, int] = (300, 400)) -> np.ndarray:
    result = np.zeros(shape, bool)
    for x, y in places:
        result[y, x] = True
    return result


def test_pixels_are_paired_one_to_one_within_three_quarters_of_a_percent_of_the_diagonal() -> None:
    # The diagonal is 500 px, so 3.75 px are near enough.
    found = mask((50, 50), (52, 50), (100, 100), (200, 200), (300, 250))
    one = mask((53, 50), (100, 103), (204, 200))  # the first for either of two, the last too far
    other = mask((50, 50), (301, 250))
    finder = lambda picture: iter([found, mask()])  # noqa: E731
    counts = boundaries.counts_of(finder, np.zeros((300, 400, 3), np.uint8), [one, other])
    # Of those found 52, 50 and 100, 100 lie on the first, 50, 50 and 300, 250 on the second.
    assert counts.tolist() == [[5, 4, 5, 4], [0, 0, 5, 0]]
    precision, recall, f = boundaries.precision_recall_f(counts)
    assert precision.tolist() == [0.8, 0.0] and recall.tolist() == [0.8, 0.0]
    assert f == pytest.approx([0.8, 0.0])


def test_nearest_pairs_come_first() -> None:
    found, drawn = mask((50, 50), (51, 50)), mask((52, 50))
    offsets = np.array([(0, 0), (0, 1), (0, 2)])
    assert np.argwhere(boundaries.matched(found, drawn, offsets)).tolist() == [[50, 51]]


def test_a_pair_changes_its_partner_where_that_makes_one_pair_more() -> None:
    # The right one is nearest to what alone the left one can reach, gives it up, and has the other one that was drawn.
    found, drawn = mask((50, 50), (52, 50)), mask((52, 51), (54, 50))
    offsets = np.array([(1, 0), (0, 2), (1, 2)])
    assert np.argwhere(boundaries.matched(found, drawn, offsets)).tolist() == [[50, 50], [50, 52]]


def test_as_many_pairs_are_made_as_scipy_makes() -> None:
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import maximum_bipartite_matching

    rng = np.random.default_rng(5)
    more = 0
    for reach, share in [(1, 0.1), (2, 0.1), (4, 0.05), (4, 0.2)] * 5:
        found, drawn = (rng.random((2, 30, 40)) < share) & (np.indices((30, 40)).sum(axis=0) % 5 < 3)
        span = range(-reach, reach + 1)
        offsets = np.array(sorted(((y, x) for y in span for x in span), key=lambda at: at[0] ** 2 + at[1] ** 2))
        one, other = np.argwhere(found), np.argwhere(drawn)
        near = (abs(one[:, None] - other) <= reach).all(axis=2)
        expected = (maximum_bipartite_matching(csr_array(near), perm_type="column") >= 0).sum()
        taken = boundaries.matched(found, drawn, offsets)
        assert taken.sum() == expected and not (taken & ~found).any()
        nearest, free = 0, drawn.copy()  # what is left where no pair changes its partner
        for dy, dx in offsets:
            for y, x in one:
                if 0 <= y + dy < 30 and 0 <= x + dx < 40 and found[y, x] and free[y + dy, x + dx]:
                    found[y, x] = free[y + dy, x + dx] = False
                    nearest += 1
        more += int(expected - nearest)
    assert more > 20  # else nothing was tested


def test_one_threshold_for_all_and_the_best_for_each() -> None:
    # Found, right, drawn, met: the first picture is perfect at the first threshold, the second at the second.
    counts = np.array([[(10, 10, 10, 10), (10, 0, 10, 0)], [(10, 5, 10, 5), (10, 10, 10, 10)]])
    ods, ois = boundaries.ods_ois(counts)
    assert ods == pytest.approx(0.75) and ois == pytest.approx(1.0)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with two pictures of squares in noise in the layout of BSDS500, and what two persons drew."""
    rng = np.random.default_rng(11)
    root = tmp_path / "data"
    for part in ("images/test", "groundTruth/test"):
        (root / part).mkdir(parents=True)
    for name, left in (("1", 40), ("2", 60)):
        picture = np.full((120, 160, 3), 90, np.uint8)
        picture[30:90, left : left + 60] = (150, 160, 140)
        noisy = np.clip(picture + rng.normal(0, 3, picture.shape), 0, 255).astype(np.uint8)
        cv2.imwrite(str(root / "images" / "test" / f"{name}.png"), noisy)
        drawn = np.zeros((120, 160), np.uint8)
        cv2.rectangle(drawn, (left, 30), (left + 59, 89), 1)
        persons = np.empty((1, 2), object)
        for i in range(2):
            persons[0, i] = {"Boundaries": drawn, "Segmentation": np.ones((120, 160), np.uint16)}
        savemat(root / "groundTruth" / "test" / f"{name}.mat", {"groundTruth": persons})
    return root


def test_evaluate_compares_edges_with_what_people_drew(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["evaluate", str(folder), "-o", str(out)]) == 0
    rows = json.loads((out / "boundaries.json").read_text())
    names = {r["detector"] for r in rows}
    assert {"outlines, color", "outlines, grey", "cv2.Canny", "cv2.Canny on color"} <= names
    assert len(rows) == len(list(csv.DictReader((out / "boundaries.csv").open())))
    assert {r["picture"] for r in rows} == {"1.png", "2.png"}
    assert {r["drawn"] for r in rows} == {2 * 236}
    at = {r["threshold"]: r for r in rows if r["detector"] == "outlines, color" and r["picture"] == "1.png"}
    assert len(at) == len(boundaries.THRESHOLDS)
    good = at[min(at, key=lambda t: abs(t - 8.0))]
    assert good["met"] > 0.95 * good["drawn"] and good["right"] > 0.95 * good["found"]
    printed = capsys.readouterr().out
    ours = next(line.split() for line in printed.splitlines() if line.startswith("outlines, color  "))
    assert float(ours[2]) > 0.97 and float(ours[3]) >= float(ours[2])
    assert "outlines, grey: " in printed and "points OIS to cv2.Canny on color" in printed
    picture = cv2.imread(str(out / "boundaries.png"))
    assert picture.shape == (700, 800, 3)
    assert not list(out.glob("repeatability*"))


@pytest.mark.parametrize(("module", "package"), [("scipy.io", "scipy"), ("matplotlib", "matplotlib")])
def test_a_missing_library_is_named_with_the_python_that_lacks_it(
    module: str,
    package: str,
    folder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    assert main(["evaluate", str(folder), "-o", str(tmp_path / "out")]) == 2
    assert f"{sys.executable} -m pip install {package}" in capsys.readouterr().err


def test_a_folder_with_drawings_and_sequences_is_evaluated_for_both(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "seq").mkdir()
    for number in (1, 2):
        cv2.imwrite(str(folder / "seq" / f"img{number}.png"), np.zeros((20, 20), np.uint8))
    np.savetxt(folder / "seq" / "H1to2p", np.eye(3))
    done = {}
    monkeypatch.setattr(harris_evaluate, "_points", lambda groups, _: done.update(pairs=[g.count for g in groups]))
    monkeypatch.setattr(harris_evaluate, "_boundaries", lambda pictures, _: done.update(drawn=len(pictures)))
    assert main(["evaluate", str(folder), "-o", str(tmp_path / "out")]) == 0
    assert done == {"pairs": [1], "drawn": 2}


def broken(folder: Path) -> Iterator[tuple[str, str]]:
    truth = folder / "groundTruth" / "test" / "1.mat"
    truth.write_bytes(b"no such file")
    yield "cut", "1.mat cannot be read as groundTruth"
    savemat(truth, {"other": np.ones(3)})
    yield "of another kind", "1.mat cannot be read as groundTruth"
    savemat(truth, {"groundTruth": np.empty((1, 0), object)})
    yield "of nobody", "0 persons, at least 1"
    persons = np.empty((1, 1), object)
    persons[0, 0] = {"Boundaries": np.zeros((50, 60), np.uint8)}
    savemat(truth, {"groundTruth": persons})
    yield "of another size", "(50, 60) px, 1.png has (120, 160)"
    (folder / "images" / "test" / "1.png").unlink()
    yield "without picture", "1.mat has no picture 1.*"


def test_files_in_another_form_end_with_one_line(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for what, words in broken(folder):
        assert main(["evaluate", str(folder), "-o", str(tmp_path / "out")]) == 2, what
        error = capsys.readouterr().err
        assert error.startswith("error: ") and words in error and error.count("\n") == 1, (what, error)
        assert not (tmp_path / "out").exists(), f"{what}: told after work had begun"


@pytest.mark.parametrize(("inside", "source"), [(".", "."), ("groundTruth", "test"), ("groundTruth/test", ".")])
def test_pictures_are_found_from_any_working_folder(
    inside: str, source: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder / inside)
    found = drawn_pictures(Path(source))
    assert [picture.resolve() for picture, _ in found] == [folder / f"images/test/{name}.png" for name in "12"]


def test_a_drawing_gets_the_picture_of_its_whole_name(tmp_path: Path) -> None:
    for name in ("a.mat", "a.1.jpg", "a.jpg", "b[1].mat", "b[1].png", "b1.png"):
        (tmp_path / name).touch()
    found = [(picture.name, truth.name) for picture, truth in drawn_pictures(tmp_path)]
    assert found == [("a.jpg", "a.mat"), ("b[1].png", "b[1].mat")]
