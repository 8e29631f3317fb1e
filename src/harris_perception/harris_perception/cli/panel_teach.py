"""Teach recognition a new panel from a picture and positions in it, or from a layout file, and check the result.

    panel_teach check config/scopes/dso_bench_4.yaml
    panel_teach picture photo.png --model pump_2 --size-mm 200 120 --corners 90,610 1180,598 1122,140 151,149 \\
        --control START:button:310,520:14x9:3 --control SCREEN:touch_area:640,300:110x70 -o config/scopes
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from harris_perception.adapters.panel_files import how_to_start, write_panel
from harris_perception.adapters.picture_files import read_bgr, write_picture
from harris_perception.core.recognition.panel_teaching import Lesson, TeachingError, parse_pointed, teach
from harris_perception.core.recognition.panel_template import draw_panel
from harris_perception.core.recognition.recognition import PanelRecogniser
from icu_common.adapters.processes.program_end import ends_quietly
from icu_common.core.configuration.option_bounds import named_path
from icu_common.core.panel.panel_layout import PanelLayout, load_layout


@ends_quietly
def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="panel_teach", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    check = commands.add_parser("check", help="is a layout right, and has its face enough print to be recognised?")
    check.add_argument("layout", type=named_path)
    check.add_argument("--drawing", type=named_path, metavar="PNG", help="also write the face as recognition draws it")
    picture = commands.add_parser("picture", help="make a layout and a template from a picture")
    picture.add_argument("picture", type=named_path)
    picture.add_argument("--model", required=True)
    picture.add_argument("--title", default="")
    picture.add_argument("--size-mm", nargs=2, type=float, required=True, metavar=("WIDTH", "HEIGHT"))
    picture.add_argument("--corners", nargs=4, required=True, metavar="U,V", help="lower left, then counter-clockwise")
    picture.add_argument("--control", action="append", required=True, metavar="NAME:kind:u,v:WxH[:height]")
    picture.add_argument("--px-per-mm", type=float, default=4.0)
    picture.add_argument("-o", "--out", type=named_path, default=Path())
    given = parser.parse_args(arguments)
    try:
        return _check(given) if given.command == "check" else _picture(given)
    except (OSError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1


def _check(given: argparse.Namespace) -> int:
    layout = load_layout(given.layout)
    PanelRecogniser(layout)  # a ValueError states what is missing
    if given.drawing is not None:
        write_picture(given.drawing, draw_panel(layout, 4.0))
    _say_that_it_is_recognisable(layout)
    return 0


def _picture(given: argparse.Namespace) -> int:
    photo = read_bgr(given.picture)
    try:
        corners = [(float(u), float(v)) for u, v in (text.split(",") for text in given.corners)]
    except ValueError:
        raise TeachingError(f"--corners {' '.join(given.corners)}; expected pixels u,v") from None
    lesson = Lesson(
        model=given.model,
        title=given.title or given.model,
        size_mm=tuple(given.size_mm),
        corners_px=np.array(corners),
        controls=tuple(parse_pointed(text) for text in given.control),
        px_per_mm=given.px_per_mm,
    )
    taught = teach(photo, lesson)
    layout, template = write_panel(taught, given.out, given.picture.name)
    _say_that_it_is_recognisable(taught.layout)
    print(f"wrote {layout} and {template}; start with:\n  {how_to_start(taught, template)}")
    return 0


def _say_that_it_is_recognisable(layout: PanelLayout) -> None:
    kinds = {
        kind: sum(c.kind == kind for c in layout.controls) for kind in dict.fromkeys(c.kind for c in layout.controls)
    }
    counted = ", ".join(f"{count} {kind}" for kind, count in kinds.items())
    print(f"{layout.model}: {layout.size_mm[0]:g} x {layout.size_mm[1]:g} mm, {counted}; enough print to be recognised")


if __name__ == "__main__":
    raise SystemExit(main())
