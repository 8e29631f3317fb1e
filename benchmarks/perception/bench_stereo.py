"""Measure sparse and dense stereo against OpenCV's matchers: errors on pairs with known disparity, and time.

Dense peers are BM and SGBM with the defaults of image_pipeline's disparity node and the same range of disparities. All
holes are filled in the same way, and only pixels visible in both images count. Sparse peers are ORB and SIFT. The pairs
come from the data folder (stereo/), at their own size, and three more are drawn from its photographs; without the
folder only the time is measured. Time is from rectified grey images to disparity, at 640x480 with 64 and 128
disparities, on two threads. The node's time also includes rectification, colour and both messages.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import cv2
import numpy as np

from harris_perception.adapters.stereo_folders import scenes
from harris_perception.core.corners.harris import HarrisConfig, HarrisDetector
from harris_perception.core.evaluation.stereo_evaluation import ALL_CORNERS, dense_methods, evaluate
from harris_perception.core.stereo.dense_stereo import DELTA_PX, DenseConfig, DenseStereo, SemiGlobalConfig
from harris_perception.core.stereo.rectifier import Rectifier
from harris_perception.core.stereo.stereo_matching import StereoMatchConfig, disparity_range, match_corners
from icu_common.adapters.memory import keep_large_blocks
from icu_common.core.geometry.camera_model import CameraModel, StereoModel
from icu_common.nodes.messages.cameras import disparity_message
from icu_common.nodes.messages.clouds import organised_cloud_message
from icu_common.nodes.messages.heads import header
from icu_simulator.core.configuration import BenchConfig
from icu_simulator.core.instrument import InstrumentState
from icu_simulator.core.renderer import Moment

sys.path.append(str(Path(__file__).resolve().parents[1]))
from perception.simulated_robot import LAYOUT, OUT_OF_SIGHT, Studio
from perception.stereo_scenes import drawn_scene
from rows import Row, bound, data_folder, interleaved_ms, row, write

MEAN_BAD_2 = 3.6
_DRAWN = (1, 2, 3)
"""Seeds of the drawn pairs; for dense disparity only."""
FRAME_MS = 100.0


def errors() -> list[Row]:
    folder = data_folder()
    if folder is None:
        print("ICU_TEST_DATA names no folder with stereo/: only the time is measured")
        return []
    rows: list[Row] = []
    taken = list(scenes(folder / "stereo"))
    drawn = [drawn_scene(folder, seed) for seed in _DRAWN]
    results = [evaluate(scene, time.perf_counter) for scene in (*taken, *drawn)]
    for result in results:
        ours = result.dense["ours"]
        for name, score in list(result.dense.items())[1:]:
            rows.append(row(f"{result.scene.name}: bad-2 [%]", ours.bad_2, score.bad_2, name, 1.0))
            what = f"{result.scene.name}: bad-2 without the strip that peers leave empty [%]"
            rows.append(row(what, ours.bad_2_strip_apart, score.bad_2_strip_apart, name))
        for name, peer in result.sparse.items() if result.scene in taken else ():
            for mine in ("ours", ALL_CORNERS) if name not in ("ours", ALL_CORNERS) else ():
                for figure in ("precision", "recall"):
                    values = getattr(result.sparse[mine], figure), getattr(peer, figure)
                    what = f"{result.scene.name}: {mine.replace('ours', 'sparse', 1)}: {figure} at 1 px [%]"
                    rows.append(row(what, *values, name, 1.0, higher_is_better=True))
    for name in results[0].sparse:
        for figure in ("precision", "recall") if name not in ("ours", ALL_CORNERS) else ():
            mine, theirs = (float(np.mean([getattr(r.sparse[n], figure) for r in results])) for n in ("ours", name))
            what = f"mean of {len(results)} pairs: sparse: {figure} at 1 px [%]"
            rows.append(row(what, mine, theirs, name, 1.0, higher_is_better=True))
    for count in (len(taken), len(results)):
        mean = float(np.mean([result.dense["ours"].bad_2 for result in results[:count]]))
        rows.append(bound(f"mean bad-2 of {count} pairs [%]", mean, MEAN_BAD_2))
    return rows


def on_the_panel() -> list[Row]:
    """Match the bench's images as the node does; the true surface of the face's print is a plane."""
    studio = Studio(BenchConfig())
    stereo, config = studio.stereo, StereoMatchConfig()
    rng, detector = np.random.default_rng(1), HarrisDetector(HarrisConfig(max_corners=2000))
    rectified, corners = [], []
    moment = Moment(tip=OUT_OF_SIGHT, state=InstrumentState(), now_s=1.0)
    for picture, model in zip(studio.renderer.render(moment), (stereo.left, stereo.right)):
        noisy = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) + rng.normal(0, studio.config.light.noise, picture.shape[:2])
        gray = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        rectified.append(Rectifier(model)(gray))
        corners.append(model.rectify(detector.detect(gray).xy))
    limits = disparity_range(stereo, config)
    matches = match_corners(rectified[0], rectified[1], corners[0], corners[1], limits, config)
    truth, counts = _face_disparity(studio, matches.left_px), _face_disparity(studio, corners[0])
    flat = np.isfinite(truth)
    error = np.abs(matches.disparity_px[flat] - truth[flat])
    good = error <= 1.0
    found = int(good.sum())
    rms = float(np.sqrt(np.mean(error[good] ** 2)))
    print(f"rendered panel: {found} of {int(np.isfinite(counts).sum())} corners of the face matched well")
    return [
        bound("rendered panel: sparse precision at 1 px [%]", 100.0 * found / int(flat.sum()), 99.5, at_least=True),
        bound("rendered panel: sparse rms [px]", rms, 0.1),
    ]


def _face_disparity(studio: Studio, left_px: np.ndarray) -> np.ndarray:
    """Return the true disparity (N,) of rectified pixels (N, 2) on the flat face, NaN elsewhere."""
    stereo = studio.stereo
    face = studio.camera_from_base @ studio.base_from_panel
    p = stereo.left.p
    rays = np.column_stack([(left_px - p[:2, 2]) / (p[0, 0], p[1, 1]), np.ones(len(left_px))])
    normal = face.rotation[:, 2]
    depth = (normal @ face.translation) / (rays @ normal)
    at = face.inverse().apply(rays * depth[:, None])[:, :2] * 1e3
    width, height = LAYOUT.size_mm
    flat = (at > 3).all(axis=1) & (at[:, 0] < width - 3) & (at[:, 1] < height - 3)
    for control in LAYOUT.controls:
        if control.height_mm > 0:
            # The cameras look from below and from both sides, so raised controls hide the face above and next to them.
            reach = np.array(control.size_mm) / 2 + 0.7 * control.height_mm + 4
            flat &= (np.abs(at - control.position_mm) > reach).any(axis=1)
    shift = stereo.left.p[0, 2] - stereo.right.p[0, 2]
    return np.where(flat, stereo.focal_px * stereo.baseline / depth + shift, np.nan)


def drawn_pair(disparity: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    wall = cv2.GaussianBlur(rng.normal(0, 1, (480, 640 + disparity)), (0, 0), 1.5) * 120 + 128
    left, right = (np.clip(wall[:, x : x + 640] + rng.normal(0, 1, (480, 640)), 0, 255) for x in (0, disparity))
    return left.astype(np.uint8), right.astype(np.uint8)


def speed() -> list[Row]:
    rows: list[Row] = []
    for count in (64, 128):
        left, right = drawn_pair(count // 2)
        functions = {n: lambda m=m, a=left, b=right: m(a, b) for n, m in dense_methods(count).items()}
        ms = interleaved_ms(functions, repeats=20)
        what = f"640x480, {count} disparities, 2 threads [ms]"
        rows += [row(what, ms["ours"], ms[name], name) for name in functions if name != "ours"]
    rows.append(bound("640x480, 128 disparities: node's work for one pair [ms]", whole_ms(), FRAME_MS))
    rows.append(bound("1280x720, binning 2, the bench's depths: node's work for one pair [ms]", panel_ms(), FRAME_MS))
    return rows


def whole_ms() -> float:
    """Return the time from two raw colour images to both messages."""
    k = np.array([[600.0, 0, 319.5], [0, 600, 239.5], [0, 0, 1]])
    p = np.column_stack([k, np.zeros(3)])
    moved = p.copy()
    moved[0, 3] = -600 * 0.12
    models = [
        CameraModel(name=n, width=640, height=480, k=k, d=np.array([-0.08, 0, 0, 0, 0]), r=np.eye(3), p=q)
        for n, q in (("left", p), ("right", moved))
    ]
    limits = DenseConfig(min_depth_m=72 / 125, max_depth_m=72 / 2)
    stereo = DenseStereo(StereoModel(left=models[0], right=models[1]), limits, SemiGlobalConfig())
    return pair_ms(stereo, [cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR) for picture in drawn_pair(64)])


def pair_ms(stereo: DenseStereo, pair: list[np.ndarray]) -> float:
    """Return the time from a raw colour pair to both messages."""
    head = header(1, "left")

    def work() -> None:
        disparity = stereo.disparity(*(cv2.cvtColor(p, cv2.COLOR_BGR2GRAY) for p in pair))
        searched = stereo.least_px, stereo.largest_px
        disparity_message(disparity, stereo.focal_px, stereo.baseline_m, searched, DELTA_PX, head)
        organised_cloud_message(stereo.points(disparity), stereo.rectified(0, pair[0]), head)

    return interleaved_ms({"work": work}, repeats=20)["work"]


def panel_ms() -> float:
    """Return the same for the bench's images, with the node's parameters on the bench."""
    studio = Studio(BenchConfig())
    pair = studio.renderer.render(Moment(tip=OUT_OF_SIGHT, state=InstrumentState(), now_s=1.0))
    limits = DenseConfig(min_depth_m=0.4, max_depth_m=1.2, binning=2)
    return pair_ms(DenseStereo(studio.stereo, limits, SemiGlobalConfig()), pair)


def main() -> int:
    argparse.ArgumentParser(description=__doc__).parse_args()
    keep_large_blocks()
    cv2.setNumThreads(2)
    write("stereo", errors() + on_the_panel() + speed(), title="stereo: errors and time")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
