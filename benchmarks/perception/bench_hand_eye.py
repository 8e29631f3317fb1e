"""Measure hand-eye calibration over seeds of hidden mechanical errors: actual errors against goal and prediction.

Each seed is one machine with backlash, scale, skew, a tilted stylus axis and motor steps. The whole chain runs on drawn
images: the calibration run moves, the tracker measures the ball, the solver computes the calibration. Then the panel is
recognised, and the tip moves to positions all over it, open loop, before any visual correction. The truth comes from
the simulated mechanism.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from harris_perception.core.hand_eye.carriage_camera import shifted
from harris_perception.core.hand_eye.hand_eye import HandEye
from harris_perception.core.hand_eye.hand_eye_config import HandEyeConfig
from harris_perception.core.hand_eye_procedure.calibration_plan import RunConfig
from harris_perception.core.hand_eye_procedure.still_watch import StillConfig
from icu_common.adapters.memory import keep_large_blocks
from icu_common.core.geometry.geometry import Array
from icu_simulator.core.configuration import BenchCameraConfig, BenchConfig
from icu_simulator.core.renderer import base_from_panel

sys.path.append(str(Path(__file__).resolve().parents[1]))
from perception.simulated_robot import LAYOUT, Robot, Studio
from rows import Row, bound, row, write

AIM_P95_MM = 0.5
CHI_SQUARE, _MACHINES = (0.8, 1.2), 50
"""Bounds of the mean chi-square, and minimum number of machines for a verdict.

A mean of fewer machines scatters beyond the bounds and is only reported."""
_BALL_M = 0.002
STILL = StillConfig(panels=1)
"""Configuration of the node with cameras on the carriage; with fixed cameras it needs no panel."""
ON_CARRIAGE = BenchCameraConfig(mounting="carriage", aim_m=(0.0, 0.012, -0.022))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outcome:
    """Result of one seed: errors in metres, chi-squares per degree of freedom."""

    chi_square: float
    factor: float
    predicted: float
    measured: float
    held_out: float
    play: Array
    true_play: Array
    aim: Array


def panel_grid() -> Array:
    """Return positions (N, 3) in panel_link, m, all over the face."""
    width, height = (side / 1000 for side in LAYOUT.size_mm)
    xs, ys = np.linspace(0.008, width - 0.008, 8), np.linspace(0.008, height - 0.008, 5)
    return np.array([(x, y, 0.0) for y in ys for x in xs])


def queries() -> Array:
    """Return readings (N, 3), spread over the calibrated volume and down to the panel."""
    return np.array([(x, y, z) for x in (0.04, 0.18, 0.32) for y in (0.04, 0.17) for z in (0.0, 0.03)])


def aim_errors(robot: Robot, calibration: HandEye) -> Array:
    """Move the tip to each panel position by calibration and recognition alone; return the lateral errors (N,) m."""
    # Cameras on the carriage look at the panel from the middle of the table.
    look = np.array([0.18, 0.1, 0.0]) if calibration.on_carriage else np.zeros(3)
    robot.machine.go(look[:2], 0.0)
    now = calibration.camera_from_base
    if calibration.on_carriage:
        now = shifted(now, calibration.base_from_reading, robot.machine.readings)
    seen = now.inverse() @ robot.see_panel()
    errors = []
    for place in panel_grid():
        target = seen.apply(place) + (0.0, 0.0, _BALL_M)
        aim = np.linalg.solve(calibration.base_from_reading, target[:2])
        robot.machine.go(aim, -target[2])
        truth = robot.studio.base_from_panel.apply(place)
        errors.append(np.linalg.norm(robot.machine.tip[:2] - truth[:2]))
    return np.array(errors)


def one(studio: Studio, seed: int) -> Outcome:
    robot = Robot(studio, seed)
    # As in carriage.yaml: the error common to all sightings of the panel is larger, and more positions do not reduce
    # it.
    enough = {"enough_m": 0.00004} if studio.on_carriage else {}
    run = RunConfig(mounting=studio.config.camera.mounting, **enough)
    done = robot.calibrate(run, STILL, HandEyeConfig())
    calibration = done.calibration
    places = queries()
    truth = []
    for x, y, extension in places:
        robot.machine.go(np.array([x, y]), extension)
        tip = robot.machine.tip
        if calibration.on_carriage:
            # The error is that of the tip's position relative to the panel, whose origin the calibration predicts.
            tip = tip - studio.base_from_panel.translation
            truth.append(studio.camera_from_base.rotation @ tip)
        else:
            truth.append(studio.camera_from_base.apply(tip))
    error = predicted_tips(calibration, places) - np.array(truth)
    covariance = calibration.covariance(places)
    distances = [e @ np.linalg.solve(c, e) / 3 for e, c in zip(error, covariance)]
    robot.machine.go(np.zeros(2), 0.0)
    return Outcome(
        chi_square=float(np.mean(distances)),
        factor=calibration.fit.variance_factor,
        predicted=calibration.sigma_m(places),
        measured=float(np.sqrt(np.mean(np.sum(error**2, axis=1)))),
        held_out=float(done.held_out_m.max()),
        play=np.array([(b.play_m, b.sigma_m) for b in done.backlash if b is not None]),
        true_play=robot.machine.errors.play_mm[:2] / 1000 * np.diag(robot.machine.errors.base_from_carriage),
        aim=aim_errors(robot, calibration),
    )


def predicted_tips(calibration: HandEye, places: Array) -> Array:
    """Return (N, 3) m in the camera's frame: the fitted tip or, with cameras on the carriage, tip less panel."""
    ones = np.ones(len(places))
    if calibration.tip_fit is None:
        return np.asarray(np.column_stack([places, ones]) @ calibration.fit.regression)
    tip = np.column_stack([places[:, 2], ones]) @ calibration.tip_fit.regression
    return np.asarray(tip - np.column_stack([places[:, :2], ones]) @ calibration.fit.regression)


def campaign(mounting: str, seeds: range) -> list[Outcome]:
    """Calibrate one machine after another; print each as soon as it is done."""
    keep_large_blocks()
    config = BenchConfig(camera=ON_CARRIAGE if mounting == "carriage" else BenchCameraConfig())
    studio = Studio(config)
    outcomes: list[Outcome] = []
    for seed in seeds:
        # Each machine has its panel at another position: with the same images, the recogniser's errors would be the
        # same too.
        dx, dy, yaw, tilt = np.random.default_rng((5, seed)).uniform(-1, 1, 4) * (0.004, 0.004, 1.0, 0.4)
        x, y, z = config.panel.position_m
        moved = replace(config.panel, position_m=(x + dx, y + dy, z), yaw_deg=1.2 + yaw, tilt_deg=(tilt, -tilt))
        studio.stand(base_from_panel(moved))
        o = one(studio, seed)
        outcomes.append(o)
        rms, p95 = np.sqrt(np.mean(o.aim**2)), np.percentile(o.aim, 95)
        figures = (o.predicted, o.measured, o.held_out, rms, p95, *(o.play[:, 0] - o.true_play), *o.play[:, 1])
        print(
            f"{mounting:>8} {seed:>4} {o.chi_square:>9.2f} {' '.join(f'{1e3 * v:>8.3f}' for v in figures)}", flush=True
        )
    return outcomes


def rows(outcomes: list[Outcome], mounting: str) -> list[Row]:
    """Return the table's rows."""
    what = f"{mounting}, {len(outcomes)} seeds: "
    aims = np.concatenate([o.aim for o in outcomes]) * 1e3
    chi = float(np.mean([o.chi_square for o in outcomes]))
    rms = [
        1e3 * float(np.sqrt(np.mean([getattr(o, name) ** 2 for o in outcomes]))) for name in ("measured", "predicted")
    ]
    plays = np.array([o.play[:, 0] - o.true_play for o in outcomes]) * 1e3
    play_chi = float(np.mean([np.mean(((o.play[:, 0] - o.true_play) / o.play[:, 1]) ** 2) for o in outcomes]))
    return [
        bound(what + "backlash error rms [mm]", float(np.sqrt(np.mean(plays**2))), 0.05),
        *_chi_rows(what + "backlash chi-square", play_chi, len(outcomes)),
        *_chi_rows(what + "chi-square per degree of freedom", chi, len(outcomes)),
        bound(what + f"tip error rms [mm] (predicted {rms[1]:.4f})", rms[0], 1.2 * rms[1]),
        bound(what + "open-loop aim, 95 % of all places [mm]", float(np.percentile(aims, 95)), AIM_P95_MM),
        bound(
            what + "open-loop aim, 95 % at the worst seed [mm]",
            1e3 * max(float(np.percentile(o.aim, 95)) for o in outcomes),
            AIM_P95_MM,
        ),
    ]


def _chi_rows(what: str, value: float, machines: int) -> list[Row]:
    if machines < _MACHINES:
        return [row(f"{what} (judged of {_MACHINES})", value, None, "")]
    low, high = CHI_SQUARE
    return [bound(what + ", at least", value, low, at_least=True), bound(what + ", at most", value, high)]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fixed", type=int, default=50, metavar="N", help="machines with fixed cameras (%(default)s)")
    parser.add_argument("--carriage", type=int, default=5, metavar="N", help="with cameras that ride (%(default)s)")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="the first machine's seed (%(default)s)")
    options = parser.parse_args()
    wanted = [(name, getattr(options, name)) for name in ("fixed", "carriage") if getattr(options, name)]
    columns = ("predicted", "measured", "held-out", "aim rms", "aim p95", "play x", "play y", "sigma x", "sigma y")
    print(f"{'cameras':>8} {'seed':>4} {'chi2/dof':>9} {' '.join(f'{c:>8}' for c in columns)}  [mm]", flush=True)
    # One process for each mounting, each with its own images.
    with ProcessPoolExecutor(max_workers=2, mp_context=multiprocessing.get_context("spawn")) as pool:
        runs = [pool.submit(campaign, name, range(options.first, options.first + count)) for name, count in wanted]
        table = [row for (name, _), run in zip(wanted, runs) for row in rows(run.result(), f"{name} cameras")]
    write("hand_eye", table, title="hand-eye calibration over seeds")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
