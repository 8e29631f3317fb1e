"""Find Harris corners and edges in pictures, match two pictures, and evaluate detectors."""

from __future__ import annotations

import argparse
import sys
import textwrap
from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np

from harris_perception.adapters.picture_files import read_bgr, read_deep_gray, read_gray, write_picture
from harris_perception.cli.harris_evaluate import evaluate
from harris_perception.cli.tables import check_table, write_table
from harris_perception.core.corners.harris import Corners, HarrisConfig, HarrisDetector
from harris_perception.core.corners.harris_laplace import HarrisLaplaceConfig, HarrisLaplaceDetector, ScaledCorners
from harris_perception.core.corners.matching import MatchConfig, describe_over_scales, match
from harris_perception.core.corners.repeatable import RepeatableConfig, RepeatableDetector
from harris_perception.core.edges.combined_detector import CombinedDetector
from harris_perception.core.edges.edges import EDGE, EdgeConfig, EdgeDetector, Edges, TracingConfig
from harris_perception.core.evaluation.repeatability import EPSILONS_PX, mapped
from harris_perception.core.image.gray import bgr_of_gray
from harris_perception.core.image.overlay import draw_corners, matches_picture
from icu_common.adapters.processes.program_end import ends_quietly
from icu_common.core.configuration.config import from_mapping, settings_of
from icu_common.core.configuration.option_bounds import named_path
from icu_common.core.configuration.yaml_text import values_of_pairs

T = TypeVar("T")
EDGE_COLOR = (255, 160, 0)
LOSSLESS = (".png", ".tif", ".tiff", ".bmp", ".pgm")
MIN_AGREEING = 10
"""Minimum number of agreeing matches; fewer can agree by chance (measured on images with nothing in common)."""


def _settings(config_class: type[T], pairs: Sequence[str]) -> T:
    return from_mapping(config_class, values_of_pairs(pairs))


def detect(options: argparse.Namespace) -> int:
    gray = read_deep_gray(options.picture)
    drawn = bgr_of_gray(gray)
    edges: Edges | None = None
    corners: Corners | ScaledCorners
    of_corners: HarrisDetector | HarrisLaplaceDetector | RepeatableDetector
    if options.scales is not None:
        of_corners = HarrisLaplaceDetector(_over_scales(options))
    elif options.repeatable:
        of_corners = RepeatableDetector(_settings(RepeatableConfig, options.set))
    else:
        of_corners = HarrisDetector(_settings(HarrisConfig, options.set))
    if options.edges == "combined":
        traced = _settings(TracingConfig, options.set_edges)
        corners, edges = CombinedDetector(_settings(HarrisConfig, options.set), traced).detect(gray)
    else:
        corners = of_corners.detect(gray)
    scales = (corners.scale,) if isinstance(corners, ScaledCorners) else ()
    if options.edges == "outlines":
        detector = EdgeDetector(_settings(EdgeConfig, options.set_edges))
        # Unknown pixels would be black, with edges, in an 8-bit image.
        picture = read_bgr(options.picture) if np.isfinite(gray).all() else gray
        edges = detector.detect(picture, corners.xy, of_corners.strengths_of(corners.response))
    if edges is not None:
        drawn[edges.labels == EDGE] = EDGE_COLOR
    draw_corners(drawn, corners.xy)
    if options.output:
        write_picture(options.output, drawn)
    if options.labels and edges is not None:
        write_picture(options.labels, np.ascontiguousarray(edges.labels))
    if options.table:
        columns = ("x_px", "y_px", "response", "scale")[: 3 + len(scales)]
        write_table(options.table, columns, np.column_stack((corners.xy, corners.response, *scales)).tolist())
    if options.chains and edges is not None:
        rows = [(i, x, y) for i, chain in enumerate(edges.chains) for x, y in chain.tolist()]
        write_table(options.chains, ("chain", "x_px", "y_px"), rows)
    print(f"{len(corners)} corners" + (f", {len(edges.chains)} chains of edges" if edges is not None else ""))
    return 0


def _over_scales(options: argparse.Namespace) -> HarrisLaplaceConfig:
    most = {item.name: item.setting.maximum for item in settings_of(HarrisLaplaceConfig)}["levels"]
    if not 1 <= options.scales <= (most or 1):
        raise ValueError(f"--scales {options.scales}; expected 1 to {most}")
    select = options.run is detect and options.select
    return HarrisLaplaceConfig(detector=_settings(HarrisConfig, options.set), levels=options.scales, select=select)


def match_pictures(options: argparse.Namespace) -> int:
    first, second = read_gray(options.first), read_gray(options.second)
    detector, config = HarrisLaplaceDetector(_over_scales(options)), _settings(MatchConfig, options.set_match)
    one, other = (detector.detect(read_deep_gray(path)) for path in (options.first, options.second))
    found = match(describe_over_scales(first, one, config), describe_over_scales(second, other, config), config)
    pairs, a, b = found.pairs, one.xy, other.xy
    if options.output:
        write_picture(options.output, matches_picture(first, second, a[pairs[:, 0]], b[pairs[:, 1]]))
    if options.table:
        ends = np.hstack((a[pairs[:, 0]], b[pairs[:, 1]])).tolist()
        write_table(options.table, ("x1_px", "y1_px", "x2_px", "y2_px"), ends)
    print(f"{len(a)} and {len(b)} corners, {found.tentative} tentative matches, {len(pairs)} agree ({config.geometry})")
    if 0 < len(pairs) < MIN_AGREEING and config.geometry != "none":
        print(f"so few may agree by chance: from {MIN_AGREEING} on they hardly do")
    if config.geometry == "homography" and found.model is not None and len(pairs) >= MIN_AGREEING:
        height, width = first.shape
        outline = mapped(np.array([(0, 0), (width - 1, 0), (width - 1, height - 1), (0, height - 1)]), found.model)
        print("the first lies in the second at " + ", ".join(f"({x:.0f}, {y:.0f})" for x, y in outline))
    return 0


def _told(option: str, config_class: type[Any]) -> str:
    """Return the settings with default, range, unit and meaning, for ``--help``."""
    lines = [f"{option} KEY=VALUE:"]
    for item in settings_of(config_class):
        info = item.setting
        bounds = (
            "" if info.minimum is None else f"{info.minimum:g} to {info.maximum:g}" if info.maximum else "0 or more"
        )
        allowed = " ".join(part for part in (" | ".join(info.choices) or bounds, info.unit) if part)
        told = f"{item.name}={item.default}" + (f" ({allowed})" if allowed else "") + f": {info.description}"
        lines += textwrap.wrap(told, 100, initial_indent="  ", subsequent_indent="      ")
    return "\n".join(lines)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="harris", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    one = commands.add_parser(
        "detect",
        help="corners, and edges, of a picture",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="\n\n".join(
            (
                _told("--set", HarrisConfig),
                _told("--set (with --repeatable)", RepeatableConfig),
                _told("--set-edges (outlines)", EdgeConfig),
                _told("--set-edges (combined)", TracingConfig),
            )
        ),
    )
    one.add_argument("picture", type=named_path, help="of more than 8 bits is stretched to its largest value")
    one.add_argument("-o", "--output", type=named_path, help="picture with the corners drawn")
    one.add_argument("--table", type=named_path, help="corners as .csv or .json")
    one.add_argument(
        "--edges",
        nargs="?",
        const="outlines",
        choices=("outlines", "combined"),
        help="edges too: outlines, by color and two scales (as without a word), or combined, in the corners' own pass",
    )
    one.add_argument("--scales", type=int, help="corners of so many scales, each 1.26 times coarser")
    one.add_argument(
        "--select",
        action="store_true",
        help="of the corners over scales those at which the Laplacian answers most (Harris-Laplace); needs --scales",
    )
    one.add_argument(
        "--repeatable",
        action="store_true",
        help="the corners that repeat best when the picture changes: those that stand out from its noise",
    )
    one.add_argument("--labels", type=named_path, help="picture of labels: 0 flat, 128 edge, 255 corner; needs --edges")
    one.add_argument("--chains", type=named_path, help="linked pixels of the edges as .csv or .json; needs --edges")
    one.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="see below")
    one.add_argument("--set-edges", action="append", default=[], metavar="KEY=VALUE", help="see below; needs --edges")
    one.set_defaults(run=detect)

    two = commands.add_parser(
        "match",
        help="matching corners of two pictures",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog=_told("--set", HarrisConfig) + "\n\n" + _told("--set-match", MatchConfig),
    )
    two.add_argument("first", type=named_path)
    two.add_argument("second", type=named_path)
    two.add_argument("-o", "--output", type=named_path, help="both pictures with the matches drawn")
    two.add_argument("--table", type=named_path, help="matches as .csv or .json")
    two.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="see below")
    two.add_argument("--set-match", action="append", default=[], metavar="KEY=VALUE", help="see below")
    two.add_argument(
        "--scales", type=int, default=8, help="levels of the pyramid, each 1.26 times coarser; 1 = one scale"
    )
    two.set_defaults(run=match_pictures)

    many = commands.add_parser(
        "evaluate", help="repeatability, or edges beside boundaries that people drew, of this detector and of others"
    )
    many.add_argument(
        "sources",
        type=named_path,
        nargs="+",
        help="folders of sequences (img1.., H1to2p.., or as HPatches 1.., H_1_2..; also .txt, .xml), or photographs; "
        "folders of pictures with drawn boundaries (<name>.mat as in BSDS500) for edges",
    )
    many.add_argument("-o", "--output", type=named_path, required=True, help="folder for tables and curves")
    many.add_argument("--count", type=int, default=1000, help="strongest so many points of each picture")
    many.add_argument(
        "--equal-counts", action="store_true", help="only as many points of each as the detector with the fewest has"
    )
    many.add_argument("--epsilon", type=float, default=1.5, choices=EPSILONS_PX, help="for the printed table, px")
    many.add_argument("--seed", type=int, default=1, help="of the noise in the warps")
    many.set_defaults(run=evaluate)
    return parser


def _check_files(options: argparse.Namespace) -> None:
    """Reject output files that would overwrite an input image or each other."""
    given = vars(options)
    taken = {given[name].resolve(): "is read" for name in ("picture", "first", "second") if name in given}
    for name in ("output", "table", "labels", "chains"):
        path = given.get(name)
        if path is None:
            continue
        if path.resolve() in taken:
            raise ValueError(f"--{name} {path}: the same file {taken[path.resolve()]}; expected another name")
        taken[path.resolve()] = f"is written by --{name}"


@ends_quietly
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; errors in the user's input end with code 2 and one line."""
    options = _parser().parse_args(arguments)
    try:
        if options.run is detect and options.edges is None and (options.labels or options.chains or options.set_edges):
            raise ValueError("--labels, --chains and --set-edges need --edges")
        _check_files(options)
        for table in (getattr(options, "table", None), getattr(options, "chains", None)):
            if table is not None:
                check_table(table)
        if options.run is detect and options.labels and options.labels.suffix.lower() not in LOSSLESS:
            raise ValueError(f"{options.labels}: the name must end in one of {', '.join(LOSSLESS)}, or labels change")
        if options.run is detect and options.select and options.scales is None:
            raise ValueError("--select needs --scales")
        if options.run is detect and (options.repeatable or options.scales is not None):
            if options.repeatable and options.scales is not None:
                raise ValueError("--repeatable has one scale: it does not go with --scales")
            if options.edges == "combined":
                raise ValueError("--edges combined needs the corners of its own pass; take --edges outlines")
        return int(options.run(options))
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    raise SystemExit(main())
