"""Harris corners and edges of pictures, matches of two, and the evaluation of detectors, from the command line."""

from __future__ import annotations

import argparse
import csv
import json
import sys
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
import yaml

from harris_perception.adapters.picture_files import (
    SUFFIXES,
    pairs_of_sequence,
    read_bgr,
    read_deep_gray,
    read_gray,
    sequences,
)
from harris_perception.core.edges import EDGE, CombinedDetector, EdgeConfig, EdgeDetector, Edges, TracingConfig
from harris_perception.core.gray import bgr_of_gray
from harris_perception.core.harris import Corners, HarrisConfig, HarrisDetector
from harris_perception.core.harris_laplace import HarrisLaplaceConfig, HarrisLaplaceDetector, ScaledCorners
from harris_perception.core.matching import MatchConfig, describe_over_scales, match
from harris_perception.core.overlay import draw_corners, matches_picture
from harris_perception.core.repeatability import (
    EPSILONS_PX,
    Detect,
    Pair,
    best_on_average,
    mapped,
    means,
    our_detectors,
    peer_detectors,
    repeatability,
    warps,
)
from harris_perception.core.repeatable import RepeatableConfig, RepeatableDetector
from icu_common.core.config import from_mapping, settings_of

T = TypeVar("T")
EDGE_COLOR = (255, 160, 0)
AMOUNTS = {
    "rotation": "angle [deg]",
    "scale": "how many times smaller",
    "light": "gain (0: from 0.4 at the left to 1.3 at the right)",
    "viewpoint": "tilt [deg]",
    "noise": "standard deviation of the noise [grey levels]",
}
"""What the amounts of the warps of a photograph mean; for sequences they are the numbers of the pictures."""
MIN_AGREEING = 10
"""Fewer matches than this agree by chance (measured on pictures that have nothing in common)."""


def _settings(config_class: type[T], pairs: Sequence[str]) -> T:
    """Build a configuration from KEY=VALUE texts."""
    values = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not equals:
            raise ValueError(f"{pair!r}: KEY=VALUE is needed")
        try:
            values[name] = yaml.safe_load(value)
        except yaml.YAMLError as error:
            raise ValueError(f"{pair!r}: the value cannot be read") from error
    return from_mapping(config_class, values)


def _progress(items: Sequence[T], what: str) -> Iterator[T]:
    """Yield the items while a bar on standard error tells how far it is; silent where nobody sees it."""
    shown = sys.stderr.isatty()
    for i, item in enumerate(items):
        if shown:
            done = 30 * i // len(items)
            print(f"\r{what} [{'#' * done}{'.' * (30 - done)}] {i}/{len(items)}", end="", file=sys.stderr, flush=True)
        yield item
    if shown:
        print(f"\r{what} [{'#' * 30}] {len(items)}/{len(items)}", file=sys.stderr)


def _write_table(path: Path, columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    """Write rows as JSON or CSV, as the name's ending says."""
    if path.suffix == ".json":
        path.write_text(json.dumps([dict(zip(columns, row)) for row in rows], indent=1) + "\n")
    elif path.suffix == ".csv":
        with path.open("w", newline="") as stream:
            csv.writer(stream).writerows([columns, *rows])
    else:
        raise ValueError(f"{path}: the name must end in .csv or .json")


def _write_picture(path: Path, picture: Any) -> None:
    try:
        written = cv2.imwrite(str(path), picture)
    except cv2.error as error:
        raise ValueError(f"{path} cannot be written: {error.err}") from error
    if not written:
        raise ValueError(f"{path} cannot be written")


def detect(options: argparse.Namespace) -> int:
    gray = read_deep_gray(options.picture)
    drawn = bgr_of_gray(gray)
    edges: Edges | None = None
    corners: Corners | ScaledCorners
    scales: tuple[Any, ...] = ()
    if options.scales:
        corners = HarrisLaplaceDetector(_over_scales(options)).detect(gray)
        scales = (corners.scale,)
    elif options.repeatable:
        corners = RepeatableDetector(_settings(RepeatableConfig, options.set)).detect(gray)
    elif options.edges == "combined":
        traced = _settings(TracingConfig, options.set_edges)
        corners, edges = CombinedDetector(_settings(HarrisConfig, options.set), traced).detect(gray)
    else:
        corners = HarrisDetector(_settings(HarrisConfig, options.set)).detect(gray)
    if options.edges == "outlines":
        detector = EdgeDetector(_settings(EdgeConfig, options.set_edges))
        edges = detector.detect(read_bgr(options.picture), corners.xy)
    if edges is not None:
        drawn[edges.labels == EDGE] = EDGE_COLOR
    draw_corners(drawn, corners.xy)
    if options.output:
        _write_picture(options.output, drawn)
    if options.labels and edges is not None:
        _write_picture(options.labels, np.ascontiguousarray(edges.labels))
    if options.table:
        columns = ("x_px", "y_px", "response", "scale")[: 3 + len(scales)]
        _write_table(options.table, columns, np.column_stack((corners.xy, corners.response, *scales)).tolist())
    if options.chains and edges is not None:
        rows = [(i, x, y) for i, chain in enumerate(edges.chains) for x, y in chain.tolist()]
        _write_table(options.chains, ("chain", "x_px", "y_px"), rows)
    print(f"{len(corners)} corners" + (f", {len(edges.chains)} chains of edges" if edges is not None else ""))
    return 0


def _over_scales(options: argparse.Namespace) -> HarrisLaplaceConfig:
    return HarrisLaplaceConfig(detector=_settings(HarrisConfig, options.set), levels=options.scales, select=False)


def match_pictures(options: argparse.Namespace) -> int:
    first, second = read_gray(options.first), read_gray(options.second)
    detector, config = HarrisLaplaceDetector(_over_scales(options)), _settings(MatchConfig, options.set_match)
    one, other = detector.detect(first), detector.detect(second)
    found = match(describe_over_scales(first, one, config), describe_over_scales(second, other, config), config)
    pairs, a, b = found.pairs, one.xy, other.xy
    if options.output:
        _write_picture(options.output, matches_picture(first, second, a[pairs[:, 0]], b[pairs[:, 1]]))
    if options.table:
        ends = np.hstack((a[pairs[:, 0]], b[pairs[:, 1]])).tolist()
        _write_table(options.table, ("x1_px", "y1_px", "x2_px", "y2_px"), ends)
    print(f"{len(a)} and {len(b)} corners, {found.tentative} tentative matches, {len(pairs)} agree ({config.geometry})")
    if 0 < len(pairs) < MIN_AGREEING and config.geometry != "none":
        print(f"so few may agree by chance: from {MIN_AGREEING} on they hardly do")
    if config.geometry == "homography" and found.model is not None and len(pairs) >= MIN_AGREEING:
        height, width = first.shape
        outline = mapped(np.array([(0, 0), (width - 1, 0), (width - 1, height - 1), (0, height - 1)]), found.model)
        print("the first lies in the second at " + ", ".join(f"({x:.0f}, {y:.0f})" for x, y in outline))
    return 0


def _pairs(sources: Iterable[Path], seed: int) -> Iterator[list[Pair]]:
    """Yield the pairs of each sequence below the folders, and of the warps of each photograph."""
    for source in sources:
        if source.is_dir():
            known = list(sequences(source))
            for sequence in known:
                yield list(pairs_of_sequence(*sequence))
            photographs = [p for p in sorted(source.glob("*")) if p.suffix.lower() in SUFFIXES] if not known else []
            if not known and not photographs:
                raise ValueError(f"{source} has neither sequences (img1, H1to2p) nor pictures")
        else:
            photographs = [source]
        for photograph in photographs:
            yield list(warps(read_gray(photograph), np.random.default_rng(seed)))


def evaluate(options: argparse.Namespace) -> int:
    if options.count < 1:
        raise ValueError(f"--count {options.count}: at least 1 is needed")
    ours, peers = our_detectors(), peer_detectors()
    detectors: dict[str, Detect] = ours | peers
    options.output.mkdir(parents=True, exist_ok=True)
    # The first, third, ... sequence or photograph is for choosing one of our settings, the others are reported.
    groups = list(_pairs(options.sources, options.seed))
    tasks = [("chosen on" if i % 2 == 0 else "reported", pair) for i, group in enumerate(groups) for pair in group]
    rows: list[dict[str, Any]] = []
    for half, pair in _progress(tasks, "evaluate"):
        for name, find in detectors.items():
            rate = repeatability(pair, find(pair.first, options.count), find(pair.second, options.count))
            for epsilon, value, chance in zip(EPSILONS_PX, rate.rates, rate.chance):
                rows.append(
                    {"half": half, "change": pair.change, "amount": pair.amount, "detector": name}
                    | {"epsilon_px": epsilon, "repeatability": value, "chance": chance, "points": rate.count}
                )
    for ending in ("csv", "json"):
        table = options.output / f"repeatability.{ending}"
        _write_table(table, list(rows[0]), [list(row.values()) for row in rows])
    _plot(rows, list(ours), list(peers), options.output)
    _report(rows, list(ours), list(peers), options)
    return 0


def _report(rows: Sequence[dict[str, Any]], ours: list[str], peers: list[str], options: argparse.Namespace) -> None:
    """Print the table of the reported half and where the setting chosen on the other half is not first."""
    rows = [r for r in rows if r["epsilon_px"] == options.epsilon]
    reported = [r for r in rows if r["half"] == "reported"] or rows
    chosen = best_on_average([r for r in rows if r["half"] == "chosen on"], ours)
    rates, chances = (means(reported, key) for key in ("repeatability", "chance"))
    changes = list(dict.fromkeys(r["change"] for r in reported))
    print(f"repeatability (chance) in %, epsilon {options.epsilon} px, strongest {options.count}")
    if reported is rows:
        print("one sequence or photograph only: chosen and reported on the same one")
    else:
        print("chosen (*) on the first, third, ... sequence or photograph, reported on the others")
    print(f"{'':<26}" + "".join(f"{c:>16}" for c in changes))
    for name in (*ours, *peers):
        cells = [f"{100 * rates[c, name]:9.1f} ({100 * chances[c, name]:4.1f})" for c in changes]
        print(f"{'* ' if name == chosen else '  '}{name:<24}" + "".join(f"{c:>16}" for c in cells))
    for change in changes:
        first = max(peers, key=lambda name: rates[change, name])
        behind = 100 * (rates[change, first] - rates[change, chosen])
        if behind > 0:
            print(f"not first on {change}: {first} is {behind:.1f} points ahead of {chosen}")


def _plot(rows: Sequence[dict[str, Any]], ours: Sequence[str], peers: Sequence[str], folder: Path) -> None:
    """Draw, for each change, the rate over its amount at 1.5 px and over epsilon, peers dashed, chance as an area."""
    try:
        import matplotlib
    except ImportError as error:
        raise ValueError(
            "the curves need matplotlib (apt install python3-matplotlib); the tables are written"
        ) from error
    matplotlib.use("Agg")
    from matplotlib import pyplot

    for change in dict.fromkeys(r["change"] for r in rows):
        figure, axes = pyplot.subplots(1, 2, figsize=(12, 5), layout="constrained")
        for axis, key in zip(axes, ("amount", "epsilon_px")):
            kept = [r for r in rows if r["change"] == change and (key != "amount" or r["epsilon_px"] == 1.5)]
            xs = sorted({r[key] for r in kept})
            curves = {
                (name, what): [np.mean([r[what] for r in kept if r["detector"] == name and r[key] == x]) for x in xs]
                for name in (*ours, *peers)
                for what in ("repeatability", "chance")
            }
            for names, line, marker in ((ours, "-", "o"), (peers, "--", "x")):
                for number, name in enumerate(names):
                    style = {"linestyle": line, "marker": marker, "markersize": 4, "color": f"C{number}"}
                    axis.plot(xs, curves[name, "repeatability"], label=name, **style)
            chances = [curve for (_, what), curve in curves.items() if what == "chance"]
            axis.fill_between(
                xs, np.min(chances, axis=0), np.max(chances, axis=0), color="0.85", label="chance, of all"
            )
            axis.grid(color="0.93")
        axes[0].set(title=f"{change}, epsilon 1.5 px", xlabel=AMOUNTS.get(change, "number of the picture"))
        axes[0].set(ylabel="repeatability", ylim=(0, 1))
        if change not in AMOUNTS:
            axes[0].set_xticks(sorted({r["amount"] for r in rows if r["change"] == change}))
        axes[1].set(title=f"{change}, mean over all pictures", xlabel="epsilon [px]", ylim=(0, 1))
        axes[1].legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1.0))
        figure.savefig(folder / f"{change}.png", dpi=100)
        pyplot.close(figure)


def _told(option: str, config_class: type[Any]) -> str:
    """Return what can be set, with default, range, unit and meaning, for ``--help``."""
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
    one.add_argument("picture", type=Path, help="of more than 8 bits is stretched to its largest value")
    one.add_argument("-o", "--output", type=Path, help="picture with the corners drawn")
    one.add_argument("--table", type=Path, help="corners as .csv or .json")
    one.add_argument(
        "--edges",
        nargs="?",
        const="outlines",
        choices=("outlines", "combined"),
        help="edges too: outlines, by color and two scales (as without a word), or combined, in the corners' own pass",
    )
    one.add_argument("--scales", type=int, default=0, help="corners of so many scales, each 1.26 times coarser")
    one.add_argument(
        "--repeatable",
        action="store_true",
        help="the corners that repeat best when the picture changes: those that stand out from its noise",
    )
    one.add_argument("--labels", type=Path, help="picture of labels: 0 flat, 128 edge, 255 corner; needs --edges")
    one.add_argument("--chains", type=Path, help="linked pixels of the edges as .csv or .json; needs --edges")
    one.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="see below")
    one.add_argument("--set-edges", action="append", default=[], metavar="KEY=VALUE", help="see below; needs --edges")
    one.set_defaults(run=detect)

    two = commands.add_parser(
        "match",
        help="matching corners of two pictures",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog=_told("--set", HarrisConfig) + "\n\n" + _told("--set-match", MatchConfig),
    )
    two.add_argument("first", type=Path)
    two.add_argument("second", type=Path)
    two.add_argument("-o", "--output", type=Path, help="both pictures with the matches drawn")
    two.add_argument("--table", type=Path, help="matches as .csv or .json")
    two.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="see below")
    two.add_argument("--set-match", action="append", default=[], metavar="KEY=VALUE", help="see below")
    two.add_argument(
        "--scales", type=int, default=8, help="levels of the pyramid, each 1.26 times coarser; 1 = one scale"
    )
    two.set_defaults(run=match_pictures)

    many = commands.add_parser("evaluate", help="repeatability of this detector and of others")
    many.add_argument("sources", type=Path, nargs="+", help="folders of sequences (img1.., H1to2p..), or photographs")
    many.add_argument("-o", "--output", type=Path, required=True, help="folder for tables and curves")
    many.add_argument("--count", type=int, default=1000, help="strongest so many points of each picture")
    many.add_argument("--epsilon", type=float, default=1.5, choices=EPSILONS_PX, help="for the printed table, px")
    many.add_argument("--seed", type=int, default=1, help="of the noise in the warps")
    many.set_defaults(run=evaluate)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; errors in what the user gave end with code 2 and one line."""
    options = _parser().parse_args(arguments)
    try:
        if options.run is detect and options.edges is None and (options.labels or options.chains or options.set_edges):
            raise ValueError("--labels, --chains and --set-edges need --edges")
        if options.run is detect and (options.repeatable or options.scales):
            if options.repeatable and options.scales:
                raise ValueError("--repeatable has one scale: it does not go with --scales")
            if options.edges == "combined":
                raise ValueError("--edges combined needs the corners of its own pass; take --edges outlines")
        return int(options.run(options))
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    raise SystemExit(main())
