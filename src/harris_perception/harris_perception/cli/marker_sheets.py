"""The command ``camera_calibration markers``: markers of a panel to print, in true size."""

from __future__ import annotations

import argparse
from typing import Any

from harris_perception.core.cameras.marker_sheet import marker_sheet
from harris_perception.core.cameras.print_page import PAPERS_MM, pdf, svg
from icu_common.core.configuration.option_bounds import named_path
from icu_common.core.geometry.fiducial import DICTIONARIES


def draw_markers(options: argparse.Namespace) -> int:
    """Write the sheet to the files.

    Raises
    ------
    ValueError
        If a name has another ending, or the sheet cannot have these markers.
    """
    sheet = marker_sheet(options.dictionary, options.ids, options.size_mm, options.paper)
    for path in options.files:
        if path.suffix not in (".svg", ".pdf"):
            raise ValueError(f"{path}: the name must end in .svg or .pdf")
    for path in options.files:
        if path.suffix == ".svg":
            path.write_text(svg(sheet), encoding="utf-8")
        else:
            path.write_bytes(pdf(sheet))
        print(f"{path}: {len(options.ids)} markers; print at 100 % and measure the line of 100 mm")
    return 0


def add_markers(commands: Any) -> None:
    """Add the command to the parsers of the program's commands."""
    draw = commands.add_parser("markers", help="draw markers of a panel to print, of true size")
    draw.add_argument("files", type=named_path, nargs="+", help="files ending in .svg or .pdf")
    draw.add_argument("--ids", type=int, nargs="+", required=True, metavar="N", help="numbers of the markers")
    draw.add_argument("--dictionary", choices=DICTIONARIES, default="APRILTAG_36h11", help="default APRILTAG_36h11")
    draw.add_argument("--size-mm", type=float, default=12.0, help="side of the black square (default 12)")
    draw.add_argument("--paper", choices=tuple(PAPERS_MM), default="a4", help="sheet (default a4)")
    draw.set_defaults(run=draw_markers)
