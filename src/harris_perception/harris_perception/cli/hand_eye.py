"""Hand-eye calibration of an arm whose wrist turns, from a file of poses: AX = XB and AX = ZB.

The file has one row per pose, comma separated, with an optional first line of names. A row has x, y, z in metres and
the quaternion x, y, z, w of base_from_gripper, then the same seven of camera_from_target. Poses are numbered from 1, in
the file's order.
"""

from __future__ import annotations

import argparse
import csv
import sys
from pathlib import Path

import numpy as np
import yaml

from harris_perception.core.wrist.wrist_camera import calibrate_wrist
from harris_perception.core.wrist.wrist_motion import WristConfig
from harris_perception.core.wrist.wrist_refinement import WristCamera
from icu_common.adapters.processes.program_end import ends_quietly
from icu_common.core.configuration.option_bounds import named_path
from icu_common.core.geometry.geometry import Array, Transform

COLUMNS = 14
_UNIT = 0.01


def read_poses(path: Path) -> tuple[list[Transform], list[Transform]]:
    """Return base_from_gripper and camera_from_target of each row.

    Raises
    ------
    ValueError
        With the invalid line, or a note that the file is not text.
    """
    grippers: list[Transform] = []
    targets: list[Transform] = []
    named = False
    try:
        with path.open(
            newline="", encoding="utf-8-sig"
        ) as file:  # spreadsheets write a byte order mark before the first number
            rows = list(csv.reader(file))
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{path} is no table of poses: {error}") from error
    for number, row in enumerate(rows, 1):
        cells = [cell.strip() for cell in row]
        if not any(cells) or cells[0].startswith("#"):
            continue
        if not grippers and not named and not any(_is_number(cell) for cell in cells):
            named = True
            continue
        try:
            values = np.array([float(cell) for cell in cells])
        except ValueError as error:
            raise ValueError(f"{path}, line {number}: {error}") from error
        if len(values) != COLUMNS:
            raise ValueError(f"{path}, line {number}: {len(values)} values; expected {COLUMNS}")
        try:
            grippers.append(_pose(values[:7]))
            targets.append(_pose(values[7:]))
        except ValueError as error:
            raise ValueError(f"{path}, line {number}: {error}") from error
    return grippers, targets


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _pose(values: Array) -> Transform:
    """Return the pose of x, y, z and a quaternion; values of another length than 1 are most likely no quaternion."""
    pose = Transform.from_quaternion(values[3:], values[:3])
    length = float(np.linalg.norm(values[3:]))
    if abs(length - 1) > _UNIT:
        raise ValueError(
            f"quaternion {values[3:].tolist()} has length {length:.3f}; expected 1 to within {_UNIT:g}: "
            "the order is x, y, z in metres, then the quaternion's x, y, z, w"
        )
    return pose


def parser() -> argparse.ArgumentParser:
    """Return the command line's description."""
    result = argparse.ArgumentParser(prog="hand_eye_solve", description=__doc__)
    result.add_argument("poses", type=named_path, help="CSV file")
    result.add_argument("--fixed-camera", action="store_true", help="the camera stands still and sees the gripper")
    result.add_argument("--min-turn-deg", type=float, default=10.0, help="least turn that counts (%(default)s)")
    result.add_argument("--max-misfit-deg", type=float, default=3.0, help="greatest misfit of the turns (%(default)s)")
    result.add_argument("--max-misfit-mm", type=float, default=20.0, help="greatest misfit of the shifts (%(default)s)")
    result.add_argument("-o", "--output", type=named_path, help="write the result there as YAML")
    return result


def report(result: WristCamera, names: tuple[str, str]) -> str:
    """Return the result for people."""
    turn, shift = result.sigmas()
    left_out = np.flatnonzero(~result.used) + 1
    lines = [
        f"{int(result.used.sum())} poses used"
        + (f", left out: {', '.join(map(str, left_out))}" if len(left_out) else ""),
        f"misfit {np.degrees(result.rotation_rms_rad):.4f} degrees and {1e3 * result.translation_rms_m:.4f} mm rms; "
        f"best start: {result.start}",
        f"predicted sigma of {names[0]}: {np.degrees(turn):.4f} degrees and {1e3 * shift:.4f} mm",
    ]
    for name, transform in zip(names, (result.gripper_from_camera, result.base_from_target)):
        x, y, z, w = transform.quaternion()
        place = ", ".join(f"{v:.6f}" for v in transform.translation)
        lines.append(f"{name}: ({place}) m, quaternion ({x:.6f}, {y:.6f}, {z:.6f}, {w:.6f})")
    return "\n".join(lines)


@ends_quietly
def main(arguments: list[str] | None = None) -> int:
    """Run the command."""
    options = parser().parse_args(arguments)
    names = ("gripper_from_camera", "base_from_target")
    if options.fixed_camera:
        names = ("base_from_camera", "gripper_from_target")
    try:
        if options.output is not None and options.output.resolve() == options.poses.resolve():
            raise ValueError(f"--output {options.output}: the same file is read; expected another name")
        grippers, targets = read_poses(options.poses)
        if options.fixed_camera:
            grippers = [g.inverse() for g in grippers]
        config = WristConfig(
            min_turn_rad=float(np.radians(options.min_turn_deg)),
            max_turn_rms_rad=float(np.radians(options.max_misfit_deg)),
            max_shift_rms_m=options.max_misfit_mm * 1e-3,
        )
        result = calibrate_wrist(grippers, targets, config)
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    if options.output is not None:
        document = {
            name: {"translation_m": t.translation.tolist(), "quaternion_xyzw": t.quaternion().tolist()}
            for name, t in zip(names, (result.gripper_from_camera, result.base_from_target))
        }
        figures = {
            "poses_used": (np.flatnonzero(result.used) + 1).tolist(),
            "rotation_rms_rad": result.rotation_rms_rad,
            "translation_rms_m": result.translation_rms_m,
            "covariance": result.covariance.tolist(),
        }
        try:
            options.output.write_text(yaml.safe_dump({**document, **figures}, sort_keys=False), encoding="utf-8")
        except OSError as error:
            print(report(result, names), flush=True)
            print(f"error: {error}", file=sys.stderr)
            return 1
    print(report(result, names))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
