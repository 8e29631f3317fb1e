"""Print a calibration board; calibrate one camera, or a pair, from pictures of it."""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import yaml

from harris_perception.adapters.camera_sources import SourceError, picture_files
from harris_perception.adapters.picture_files import read_sensor_gray, write_picture
from harris_perception.cli.marker_sheets import add_markers
from harris_perception.core.cameras.board import CalibrationBoard, board_pdf, board_svg
from harris_perception.core.cameras.board_detection import BoardDetector, BoardView, size_shown
from harris_perception.core.cameras.calibration_config import INTRINSICS, CalibrationConfig
from harris_perception.core.cameras.camera_calibration import CameraCalibration, calibrate_camera
from harris_perception.core.cameras.pair_calibration import PairCalibration, calibrate_stereo
from harris_perception.core.cameras.print_page import PAPERS_MM
from harris_perception.core.cameras.residual_picture import residual_picture
from harris_perception.core.cameras.view_coverage import CalibrationError, coverage
from harris_perception.core.cameras.view_errors import ViewError
from icu_common.adapters.processes.program_end import ends_quietly
from icu_common.core.configuration.config import settings_of
from icu_common.core.configuration.option_bounds import check_bounds, named_path
from icu_common.core.geometry.camera_model import CameraModel

Say: TypeAlias = Callable[[str], None]


def _columns_by_rows(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d+)x(\d+)", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"{text!r}; expected inner corners as COLUMNSxROWS, for example 9x6")
    return int(match[1]), int(match[2])


def _camera_name(text: str) -> str:
    # camera_info_manager accepts only letters, digits and underscores.
    if not re.fullmatch(r"\w+", text, re.ASCII):
        raise argparse.ArgumentTypeError(f"{text!r}; expected a name of letters, digits and '_'")
    return text


def _board(options: argparse.Namespace) -> CalibrationBoard:
    kind = "charuco" if options.charuco else "chessboard"
    columns, rows = options.charuco or options.chessboard
    marker_mm = options.marker_mm if options.marker_mm is not None else 0.72 * options.square_mm
    return CalibrationBoard(
        kind=kind,
        columns=columns,
        rows=rows,
        square_m=options.square_mm * 1e-3,
        marker_m=marker_mm * 1e-3,
        dictionary=options.dictionary,
    )


def _config(options: argparse.Namespace) -> CalibrationConfig:
    return CalibrationConfig(**{item.name: getattr(options, item.name) for item in settings_of(CalibrationConfig)})


@contextlib.contextmanager
def _telling() -> Iterator[Say]:
    """Collect lines and print them at the end, also before an error.

    Results are written by then, so a reader such as ``head`` may have ended.
    """
    lines: list[str] = []
    try:
        yield lines.append
    finally:
        print("".join(f"{line}\n" for line in lines), end="")


def _detect_all(board: CalibrationBoard, files: Sequence[Path], what: str) -> list[BoardView | None]:
    """Search for the board in every file, with a progress bar on standard error if that is a terminal."""
    shown, detector = sys.stderr.isatty(), BoardDetector(board)
    views = []
    for i, file in enumerate(files, start=1):
        views.append(detector.detect(read_sensor_gray(file), file.name))
        if shown:
            done = 30 * i // len(files)
            print(f"\r{what} [{'#' * done}{'.' * (30 - done)}] {i}/{len(files)}", end="", file=sys.stderr, flush=True)
    if shown:
        print(file=sys.stderr)
    return views


def _require_some(board: CalibrationBoard, files: Sequence[Path], views: Sequence[BoardView | None], say: Say) -> None:
    """Report the files without the board; raise an error if all lack it, with a matching board size if there is one."""
    lost = [file.name for file, view in zip(files, views) if view is None]
    if len(lost) < len(files):
        if lost:
            say(f"board not found in {len(lost)} of {len(files)}: {', '.join(lost)}")
        return
    advice = "check the size (inner corners, one less than squares), and that the whole board is sharp and evenly lit"
    if board.kind == "charuco":
        advice = "check the dictionary and the size (inner corners, one less than squares)"
    else:
        for file in files[:2]:
            size = size_shown(read_sensor_gray(file), board)
            if size is not None:
                advice = f"{file.name} shows {size[0]}x{size[1]} inner corners: try --chessboard {size[0]}x{size[1]}"
                break
    raise CalibrationError(f"no {board.title} in any of {len(files)} pictures: {advice}")


def _number(file: Path) -> int | None:
    digits = re.findall(r"\d+", file.stem)
    return int(digits[-1]) if digits else None


def _paired(left: Sequence[Path], right: Sequence[Path], say: Say) -> list[tuple[Path, Path]]:
    """Pair files by the last number in their names; by order where there are no numbers.

    A file without a number among numbered ones, such as the residuals of an earlier calibration, has no partner.
    """
    numbered = [[(n, file) for file in side if (n := _number(file)) is not None] for side in (left, right)]
    by_number = [dict(side) for side in numbered]
    if any(not side or len(numbers) < len(side) for side, numbers in zip(numbered, by_number)):
        if len(left) != len(right):
            raise CalibrationError(
                f"{len(left)} left and {len(right)} right pictures without numbers to pair them by: "
                "name them left01.png, right01.png and so on"
            )
        return list(zip(left, right))
    pairs = [(file, by_number[1][n]) for n, file in numbered[0] if n in by_number[1]]
    alone = [f.name for f in (*left, *right) if not any(f in pair for pair in pairs)]
    if not pairs:
        raise CalibrationError("no left picture has a right one with the same number")
    if alone:
        say(f"without a partner: {', '.join(alone)}")
    return pairs


def _say_coverage(board: CalibrationBoard, views: Sequence[BoardView], say: Say) -> None:
    say("coverage   from    to")
    for reach in coverage(board, views):
        say(f"  {reach.name:<6} {reach.low:6.2f} {reach.high:6.2f}  {reach.missing or 'enough'}")


def _say_views(views: Sequence[ViewError], left_out: Sequence[ViewError], say: Say) -> None:
    say("view                             corners  rms [px]")
    for view in (*views, *left_out):
        note = "left out" if view in left_out else "OUTLIER: look at it, or --drop-outliers" if view.outlier else ""
        say(f"  {view.name:<30} {view.corners:8d} {view.rms_px:9.3f}  {note}".rstrip())


def _say_camera(model: CameraModel, sigma: dict[str, float], say: Say, prefix: str = "") -> None:
    values = (*model.k[[0, 1, 0, 1], [0, 1, 2, 2]], *model.d)
    for name, value in zip(INTRINSICS, values):
        known = f"+- {sigma[prefix + name]:.5f}" if prefix + name in sigma else "(not estimated)"
        say(f"  {name:<6} {value:12.5f} {known}")
    loose = sigma[prefix + "fx_px"] / model.k[0, 0]
    if loose > 0.01:
        say(f"  focal length is known to {100 * loose:.1f} % only: add views with the board tilted by 20 to 45 degrees")


def _write_model(model: CameraModel, folder: Path) -> Path:
    path = folder / f"{model.name}.yaml"
    text = yaml.safe_dump(model.to_mapping(), sort_keys=False, default_flow_style=None, width=120)
    path.write_text(text, encoding="utf-8")
    return path


def _write_residuals(calibration: CameraCalibration, folder: Path) -> Path:
    path = folder / f"{calibration.model.name}_residuals.png"
    write_picture(path, residual_picture(calibration))
    return path


def _views_report(views: Sequence[ViewError]) -> list[dict[str, Any]]:
    return [{"name": v.name, "corners": v.corners, "rms_px": v.rms_px, "outlier": v.outlier} for v in views]


def _report(
    board: CalibrationBoard, result: CameraCalibration | PairCalibration, views: Sequence[BoardView]
) -> dict[str, Any]:
    reaches = coverage(board, views)
    report: dict[str, Any] = {
        "board": board.title,
        "rms_px": result.rms_px,
        "sigma": result.sigma,
        "views": _views_report(result.views),
        "left_out": _views_report(result.left_out),
        "coverage": {r.name: {"low": r.low, "high": r.high, "missing": r.missing} for r in reaches},
    }
    if isinstance(result, CameraCalibration):
        return report | {"camera": result.model.to_mapping()}
    return report | {
        "rows_rms_px": result.rows_rms_px,
        "baseline_m": result.stereo.baseline,
        "left_alone_rms_px": result.left.rms_px,
        "right_alone_rms_px": result.right.rms_px,
        "left": result.stereo.left.to_mapping(),
        "right": result.stereo.right.to_mapping(),
    }


def _finish(folder: Path, report: dict[str, Any], written: Sequence[Path], say: Say) -> None:
    path = folder / "calibration.json"
    path.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    say("written: " + ", ".join(str(p) for p in (*written, path)))


def _capture(
    options: argparse.Namespace, board: CalibrationBoard, topics: Sequence[str], folders: Sequence[Path]
) -> None:
    """Fill the folders from live topics."""
    # Imported only here, so that everything else runs without ROS.
    from harris_perception.nodes.calibration_capture import capture
    from icu_common.nodes.topic_names import check_names

    check_names(topics)
    for folder in (options.output, *folders):
        folder.mkdir(parents=True, exist_ok=True)
        if folder in folders and any(folder.iterdir()):
            raise CalibrationError(f"{folder} is not empty: give new folders for live pictures")

    def say(line: str) -> None:
        with contextlib.suppress(OSError):  # the reader may have ended: the views matter
            print(line, flush=True)

    say(f"listening to {', '.join(topics)}; Ctrl-C ends it and calibrates with what there is")
    collection = capture(board, topics, folders, wanted=options.views, within_s=options.within, say=say)
    if not collection.kept:
        raise CalibrationError(
            f"no view of the {board.title} was kept: is the camera running, is this the board, was it held still? "
            "See ros2 topic hz on the topics above"
        )


def draw_board(options: argparse.Namespace) -> int:
    board = _board(options)
    for path in options.files:
        if path.suffix not in (".svg", ".pdf"):
            raise ValueError(f"{path}: the name must end in .svg or .pdf")
    for path in options.files:
        if path.suffix == ".svg":
            path.write_text(board_svg(board, options.paper), encoding="utf-8")
        else:
            path.write_bytes(board_pdf(board, options.paper))
        print(f"{path}: {board.title}; print at 100 % and measure the line of 100 mm")
    return 0


def mono(options: argparse.Namespace) -> int:
    check_bounds(options, views=(1, math.inf), within=(0, math.inf))
    board, config = _board(options), _config(options)
    if options.live:
        _capture(options, board, [options.topic], [options.pictures])
    files = picture_files(options.pictures)
    found = _detect_all(board, files, "looking for the board")
    with _telling() as say:
        _require_some(board, files, found, say)
        views = [view for view in found if view is not None]
        _say_coverage(board, views, say)
        result = calibrate_camera(board, views, config, options.name)
        _say_views(result.views, result.left_out, say)
        say(f"{options.name}: rms {result.rms_px:.3f} px, {len(result.views)} views")
        _say_camera(result.model, result.sigma, say)
        options.output.mkdir(parents=True, exist_ok=True)
        written = [_write_model(result.model, options.output), _write_residuals(result, options.output)]
        _finish(options.output, _report(board, result, views), written, say)
    return 0


def stereo(options: argparse.Namespace) -> int:
    if options.names[0] == options.names[1]:  # the names identify the results
        raise ValueError(f"--names {' '.join(options.names)}; expected two different names")
    check_bounds(options, views=(1, math.inf), within=(0, math.inf))
    board, config = _board(options), _config(options)
    if options.live:
        topics = [f"{options.namespace}/{side}/image_raw" for side in ("left", "right")]
        _capture(options, board, topics, [options.left, options.right])
    with _telling() as say:
        files = _paired(picture_files(options.left), picture_files(options.right), say)
        found = []
        for side, name in enumerate(("left", "right")):
            found.append(_detect_all(board, [pair[side] for pair in files], f"looking for the board, {name}"))
            _require_some(board, [pair[side] for pair in files], found[side], say)
        pairs = [(a, b) for a, b in zip(*found) if a is not None and b is not None]
        _say_coverage(board, [pair[0] for pair in pairs], say)
        result = calibrate_stereo(board, pairs, config, tuple(options.names))
        _say_views(result.views, result.left_out, say)
        models = (("left", result.left, result.stereo.left), ("right", result.right, result.stereo.right))
        for name, alone, model in models:
            say(f"{model.name}: rms alone {alone.rms_px:.3f} px")
            _say_camera(model, result.sigma, say, f"{name}_")
        say(
            f"pair: rms {result.rms_px:.3f} px, rectified rows {result.rows_rms_px:.3f} px, {len(result.views)} pairs, "
            f"baseline {result.stereo.baseline * 1e3:.2f} +- {result.sigma['baseline_m'] * 1e3:.2f} mm"
        )
        options.output.mkdir(parents=True, exist_ok=True)
        written = [_write_model(model, options.output) for _, _, model in models]
        written += [_write_residuals(alone, options.output) for _, alone, _ in models]
        _finish(options.output, _report(board, result, [pair[0] for pair in pairs]), written, say)
    return 0


def _add_board(parser: argparse.ArgumentParser) -> None:
    choices = {item.name: item.setting.choices for item in settings_of(CalibrationBoard)}["dictionary"]
    which = parser.add_mutually_exclusive_group()
    size: dict[str, Any] = {"type": _columns_by_rows, "metavar": "COLUMNSxROWS"}
    which.add_argument("--chessboard", default=(9, 6), help="inner corners (default 9x6)", **size)
    which.add_argument("--charuco", help="inner corners, rows even, for example 10x6", **size)
    parser.add_argument("--square-mm", type=float, default=25.0, help="side of a square as printed (default 25)")
    parser.add_argument("--marker-mm", type=float, help="side of a charuco marker (default 0.72 of the square)")
    parser.add_argument("--dictionary", choices=choices, default="4X4_250", help="charuco markers (default 4X4_250)")


def _add_calibration(parser: argparse.ArgumentParser) -> None:
    _add_board(parser)
    for item in settings_of(CalibrationConfig):
        option, text = f"--{item.name.replace('_', '-')}", item.setting.description
        if item.kind is bool:
            parser.add_argument(option, action="store_true", help=text)
        else:
            parser.add_argument(option, type=item.kind, default=item.default, help=f"{text} (default {item.default:g})")
    parser.add_argument("-o", "--output", type=named_path, default=Path(), help="folder for results (default: here)")
    parser.add_argument("--live", action="store_true", help="first fill the folders from running cameras")
    parser.add_argument("--views", type=int, default=20, help="live: so many are enough (default 20)")
    parser.add_argument("--within", type=float, default=600.0, help="live: end after so many seconds (default 600)")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="camera_calibration", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    draw = commands.add_parser("board", help="draw a board to print, of true size")
    draw.add_argument("files", type=named_path, nargs="+", help="files ending in .svg or .pdf")
    draw.add_argument("--paper", choices=("fit", *PAPERS_MM), default="fit", help="sheet (default: fits the board)")
    _add_board(draw)
    draw.set_defaults(run=draw_board)
    add_markers(commands)

    one = commands.add_parser("mono", help="calibrate one camera")
    one.add_argument("pictures", type=named_path, help="folder, or pattern in quotes: 'folder/left*.png'")
    one.add_argument("--name", type=_camera_name, default="camera", help="the camera's, and the file's, name")
    one.add_argument("--topic", default="/camera/image_raw", help="live: pictures (default /camera/image_raw)")
    _add_calibration(one)
    one.set_defaults(run=mono)

    two = commands.add_parser("stereo", help="calibrate a pair")
    two.add_argument("left", type=named_path, help="folder, or pattern in quotes: 'folder/left*.png'")
    two.add_argument(
        "right", type=named_path, help="the same for the right camera; paired by the last number in the names"
    )
    two.add_argument("--names", type=_camera_name, nargs=2, default=["left", "right"], help="the cameras' names")
    two.add_argument("--namespace", default="/stereo", help="live: left/image_raw and right/image_raw are below this")
    _add_calibration(two)
    two.set_defaults(run=stereo)
    return parser


@ends_quietly
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; errors in the user's input end with code 2 and one line."""
    options = _parser().parse_args(arguments)
    try:
        return int(options.run(options))
    except (ValueError, OSError, SourceError) as error:
        with contextlib.suppress(OSError):
            sys.stdout.flush()  # earlier output precedes the error, also in a log
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    raise SystemExit(main())
