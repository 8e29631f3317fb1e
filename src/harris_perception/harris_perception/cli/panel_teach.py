"""Teach recognition a new panel, from a picture and places in it or from a layout file alone, and check that it works.

    panel_teach check config/scopes/dso_bench_4.yaml
    panel_teach picture photo.png --model pump_2 --size-mm 200 120 --corners 90,610 1180,598 1122,140 151,149 \\
        --control START:button:310,520:14x9:3 --control SCREEN:touch_area:640,300:110x70 -o config/scopes
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.panel_teaching import (
    TeachingError,
    layout_text,
    mm_from_pixel,
    parse_pointed,
    straight_on,
)
from harris_perception.core.panel_template import draw_panel
from harris_perception.core.recognition import PanelRecogniser
from icu_common.core.panel_layout import LayoutError, PanelLayout, load_layout, parse_layout


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="panel_teach", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    check = commands.add_parser("check", help="is a layout right, and has its face enough print to be recognised?")
    check.add_argument("layout", type=Path)
    check.add_argument("--drawing", type=Path, metavar="PNG", help="also write the face as recognition draws it")
    picture = commands.add_parser("picture", help="make a layout and a template from a picture")
    picture.add_argument("picture", type=Path)
    picture.add_argument("--model", required=True)
    picture.add_argument("--title", default="")
    picture.add_argument("--size-mm", nargs=2, type=float, required=True, metavar=("WIDTH", "HEIGHT"))
    picture.add_argument("--corners", nargs=4, required=True, metavar="U,V", help="lower left, then counter-clockwise")
    picture.add_argument("--control", action="append", required=True, metavar="NAME:kind:u,v:WxH[:height]")
    picture.add_argument("--px-per-mm", type=float, default=4.0)
    picture.add_argument("-o", "--out", type=Path, default=Path())
    given = parser.parse_args(arguments)
    try:
        return _check(given) if given.command == "check" else _picture(given)
    except (OSError, LayoutError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1


def _check(given: argparse.Namespace) -> int:
    layout = load_layout(given.layout)
    _say_whether_recognisable(layout, None, 0.0)
    if given.drawing is not None:
        _write(given.drawing, draw_panel(layout, 4.0))
    return 0


def _picture(given: argparse.Namespace) -> int:
    photo = cv2.imread(str(given.picture), cv2.IMREAD_COLOR)
    if photo is None:
        raise TeachingError(f"{given.picture} is not a picture that can be read")
    try:
        corners = [[float(n) for n in text.split(",")] for text in given.corners]
    except ValueError:
        raise TeachingError(f"--corners {' '.join(given.corners)}: pixels u,v are needed") from None
    width, height = given.size_mm
    to_mm = mm_from_pixel(corners, (width, height))
    template = straight_on(np.asarray(photo, np.uint8), to_mm, (width, height), given.px_per_mm)
    controls = [parse_pointed(text) for text in given.control]
    text = layout_text(given.model, given.title or given.model, (width, height), controls, to_mm)
    layout = parse_layout(text, f"{given.model}.yaml")
    _say_whether_recognisable(layout, template, given.px_per_mm)
    given.out.mkdir(parents=True, exist_ok=True)
    place, shown = given.out / f"{given.model}.yaml", given.out / f"{given.model}.png"
    if place.exists():
        raise TeachingError(f"{place} is there already; remove it, or choose another --model")
    _write(shown, template)
    place.write_text(f"# Taught from {given.picture.name}.\n{text}", encoding="utf-8")
    print(f"wrote {place} and {shown}; start with:")
    print(f"  bring_up --scope {given.model} --set recognition.template={shown.resolve()}", end=" ")
    print(f"--set recognition.template_px_per_mm={given.px_per_mm:g}")
    return 0


def _say_whether_recognisable(layout: PanelLayout, picture: npt.NDArray[np.uint8] | None, scale: float) -> None:
    PanelRecogniser(layout, picture=picture, picture_px_per_mm=scale)  # a ValueError says what is missing
    kinds = {
        kind: sum(c.kind == kind for c in layout.controls) for kind in dict.fromkeys(c.kind for c in layout.controls)
    }
    counted = ", ".join(f"{count} {kind}" for kind, count in kinds.items())
    print(f"{layout.model}: {layout.size_mm[0]:g} x {layout.size_mm[1]:g} mm, {counted}; enough print to be recognised")


def _write(path: Path, picture: npt.NDArray[np.uint8]) -> None:
    if not cv2.imwrite(str(path), picture):
        raise TeachingError(f"{path} cannot be written")


if __name__ == "__main__":
    raise SystemExit(main())
