"""`harris evaluate`: repeatability of corners, and agreement of edges with hand-drawn boundaries, against others."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.adapters.boundary_files import drawn_pictures, read_drawn
from harris_perception.adapters.picture_files import SUFFIXES, read_gray, sequences
from harris_perception.cli.tables import progress, write_table
from harris_perception.core.evaluation.boundary_evaluation import (
    THRESHOLDS,
    counts_of,
    ods_ois,
    our_finders,
    peer_finders,
    precision_recall_f,
)
from harris_perception.core.evaluation.repeatability import (
    EPSILONS_PX,
    WARPS,
    Detect,
    HomographyPair,
    Points,
    best_on_average,
    means,
    our_detectors,
    peer_detectors,
    repeatability,
    warps,
)

AMOUNTS = {
    "rotation": "angle [deg]",
    "scale": "how many times smaller",
    "light": "gain (0: from 0.4 at the left to 1.3 at the right)",
    "viewpoint": "tilt [deg]",
    "noise": "standard deviation of the noise [grey levels]",
}
"""Meaning of the amounts of a photograph's warps; for sequences the amounts are image numbers."""

_LEAST_PX = 64


def evaluate(options: argparse.Namespace) -> int:
    """Run the command for its sources: boundaries where there are .mat files, interest points on the rest.

    All files are read once first, so that a faulty file is reported before hours of work.
    """
    for name, value, least, most in (("count", options.count, 1, 5000), ("seed", options.seed, 0, 2**32 - 1)):
        if not least <= value <= most:
            raise ValueError(f"--{name} {value}; expected {least} to {most}")
    drawn = [source for source in options.sources if source.is_dir() and any(source.rglob("*.mat"))]
    others = [source for source in options.sources if source not in drawn or any(sequences(source))]
    groups = list(_groups(others, options))
    pictures = [pair for folder in drawn for pair in drawn_pictures(folder)]
    for picture, truth in pictures:
        read_drawn(picture, truth)
    options.output.mkdir(parents=True, exist_ok=True)
    if groups:
        _points(groups, options)
    if pictures:
        _boundaries(pictures, options.output)
    return 0


@dataclass(frozen=True, slots=True)
class _Group:
    """A group of pairs: their number, and the iterator that reads or makes them (many do not fit into memory)."""

    count: int
    pairs: Callable[[], Iterator[HomographyPair]]


def _groups(sources: Iterable[Path], options: argparse.Namespace) -> Iterator[_Group]:
    """Yield a group for each sequence below the folders, and for the warps of each photograph."""
    curves = {(options.output / f"{change}.png").resolve() for change in WARPS}
    for source in sources:
        if source.is_dir():
            known = list(sequences(source))
            for sequence in known:
                for _ in sequence.pairs():
                    pass
                yield _Group(len(sequence.others), sequence.pairs)
            photographs = [p for p in sorted(source.glob("*")) if p.suffix.lower() in SUFFIXES] if not known else []
            if not known and not photographs:
                raise ValueError(f"{source} has neither sequences (img1, H1to2p, or 1, H_1_2) nor pictures")
        else:
            photographs = [source]
        for photograph in photographs:
            if photograph.resolve() in curves:
                raise ValueError(f"{photograph}: curves would be written over it; expected another --output")
            _to_be_warped(photograph)
            yield _Group(sum(map(len, WARPS.values())), partial(_warps, photograph, options.seed))


def _warps(photograph: Path, seed: int) -> Iterator[HomographyPair]:
    return warps(_to_be_warped(photograph), np.random.default_rng(seed))


def _to_be_warped(path: Path) -> npt.NDArray[np.uint8]:
    picture = read_gray(path)
    if min(picture.shape) < _LEAST_PX:
        size = f"{picture.shape[1]} x {picture.shape[0]} px"
        raise ValueError(f"{path}: {size}; expected at least {_LEAST_PX} each way to be warped")
    return picture


def _found(
    detectors: Mapping[str, Detect], pair: HomographyPair, options: argparse.Namespace, known: dict[str, Points]
) -> Iterator[tuple[str, Points, Points]]:
    """Yield each detector's points in both images of a pair; ``known`` are those in the first, if known."""
    first = known or {name: find(pair.first, options.count) for name, find in detectors.items()}
    known |= first
    second = {name: find(pair.second, options.count) for name, find in detectors.items()}
    limits = [min(map(len, each.values())) if options.equal_counts else options.count for each in (first, second)]
    for name in detectors:
        yield name, first[name][: limits[0]], second[name][: limits[1]]


def _points(groups: list[_Group], options: argparse.Namespace) -> None:
    ours, peers = our_detectors(), peer_detectors()
    detectors: dict[str, Detect] = ours | peers
    # The first, third, ... sequence or photograph is used to choose one of our settings; the others are reported.
    halves = (
        ("chosen on" if i % 2 == 0 else "reported", pair) for i, group in enumerate(groups) for pair in group.pairs()
    )
    rows: list[dict[str, Any]] = []
    last, known = None, dict[str, Points]()
    for half, pair in progress(halves, sum(group.count for group in groups), "evaluate"):
        if pair.first is not last:  # pairs of a sequence share their first image
            last, known = pair.first, {}
        for name, first, second in _found(detectors, pair, options, known):
            rate = repeatability(pair, first, second)
            for epsilon, value, chance in zip(EPSILONS_PX, rate.rates, rate.chance):
                rows.append(
                    {"half": half, "change": pair.change, "amount": pair.amount, "detector": name}
                    | {"epsilon_px": epsilon, "repeatability": value, "chance": chance, "points": rate.count}
                )
    for ending in ("csv", "json"):
        table = options.output / f"repeatability.{ending}"
        write_table(table, list(rows[0]), [list(row.values()) for row in rows])
    _plot(rows, list(ours), list(peers), options.output)
    _report(rows, list(ours), list(peers), options)


def _report(rows: Sequence[dict[str, Any]], ours: list[str], peers: list[str], options: argparse.Namespace) -> None:
    """Print the table of the reported half, and where the setting chosen on the other half is not first."""
    rows = [r for r in rows if r["epsilon_px"] == options.epsilon]
    reported = [r for r in rows if r["half"] == "reported"] or rows
    chosen = best_on_average([r for r in rows if r["half"] == "chosen on"], ours)
    rates, chances = (means(reported, key) for key in ("repeatability", "chance"))
    changes = list(dict.fromkeys(r["change"] for r in reported))
    counts = "as many of each as the fewest" if options.equal_counts else f"strongest {options.count}"
    print(f"repeatability (chance) in %, epsilon {options.epsilon} px, {counts}")
    if reported is rows:
        print("one sequence or photograph only: chosen and reported on the same one")
    else:
        print("chosen (*) on the first, third, ... sequence or photograph, reported on the others")
    width = max(16, 2 + max(map(len, changes)))
    print(f"{'':<26}" + "".join(f"{c:>{width}}" for c in changes))
    for name in (*ours, *peers):
        cells = [f"{100 * rates[c, name]:9.1f} ({100 * chances[c, name]:4.1f})" for c in changes]
        print(f"{'* ' if name == chosen else '  '}{name:<24}" + "".join(f"{c:>{width}}" for c in cells))
    for change in changes:
        first = max(peers, key=lambda name: rates[change, name])
        behind = 100 * (rates[change, first] - rates[change, chosen])
        if behind > 0:
            print(f"not first on {change}: {first} is {behind:.1f} points ahead of {chosen}")


def _plot(rows: Sequence[dict[str, Any]], ours: Sequence[str], peers: Sequence[str], folder: Path) -> None:
    """Draw, for each change, the rate over its amount at 1.5 px and over epsilon; peers dashed, chance as an area."""
    pyplot = _pyplot()
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


def _boundaries(pictures: list[tuple[Path, Path]], output: Path) -> None:
    """Compare edges with drawn boundaries; each peer uses its best sigma on these images, for ODS and for OIS."""
    ours, peers = our_finders(), peer_finders()
    named = {(name, 0.0): finder for name, finder in ours.items()}
    named |= {(name, sigma): finder for name, sigmas in peers.items() for sigma, finder in sigmas.items()}
    counts = np.zeros((len(named), len(pictures), len(THRESHOLDS), 4), np.int64)
    rows = []
    for p, (path, truth) in enumerate(progress(pictures, len(pictures), "evaluate")):
        picture, drawings = read_drawn(path, truth)
        for number, ((name, sigma), finder) in enumerate(named.items()):
            counts[number, p] = counts_of(finder, picture, drawings)
            rows += [
                (path.name, name, sigma, threshold, *numbers)
                for threshold, numbers in zip(THRESHOLDS, counts[number, p].tolist())
            ]
    columns = ("picture", "detector", "sigma_px", "threshold", "found", "right", "drawn", "met")
    for ending in ("csv", "json"):
        write_table(output / f"boundaries.{ending}", columns, rows)
    scores = {key: ods_ois(counts[number]) for number, key in enumerate(named)}
    best = {name: max((key for key in named if key[0] == name), key=lambda key: scores[key]) for name, _ in named}
    curves = {
        name if name in ours else f"{name}, sigma {key[1]}": precision_recall_f(
            counts[list(named).index(key)].sum(axis=0)
        )
        for name, key in best.items()
    }
    highest = {name: [max(scores[key][i] for key in named if key[0] == name) for i in (0, 1)] for name in best}
    print(f"edges beside drawn boundaries, {len(pictures)} pictures; peers at the sigma with the highest ODS on these")
    print(f"{'':<34}{'ODS':>8}{'OIS':>8}{'threshold':>11}{'precision':>11}{'recall':>8}")
    for title, key in zip(curves, best.values()):
        precision, recall, f = curves[title]
        at = int(f.argmax())
        cells = (
            f"{scores[key][0]:8.3f}{scores[key][1]:8.3f}{THRESHOLDS[at]:11.2f}{precision[at]:11.3f}{recall[at]:8.3f}"
        )
        print(f"{title:<34}{cells}")
    for name in ours:
        for peer in peers:
            ahead = [100.0 * (a - b) for a, b in zip(highest[name], highest[peer])]
            print(f"{name}: {ahead[0]:+.1f} points ODS, {ahead[1]:+.1f} points OIS to {peer}, each at its best sigma")
    _plot_boundaries(curves, len(ours), output / "boundaries.png")


def _plot_boundaries(curves: dict[str, Any], ours: int, path: Path) -> None:
    """Draw precision over recall, peers dashed, the best F-measure as a dot, over lines of equal F-measure."""
    pyplot = _pyplot()
    figure, axis = pyplot.subplots(figsize=(8, 7), layout="constrained")
    grid = np.linspace(0.01, 1.0, 200)
    recalls, precisions = np.meshgrid(grid, grid)
    equal = axis.contour(
        grid, grid, 2 * precisions * recalls / (precisions + recalls), np.arange(0.1, 1.0, 0.1), colors="0.85"
    )
    axis.clabel(equal, fmt="F %.1f", fontsize=8)
    for number, (title, (precision, recall, f)) in enumerate(curves.items()):
        at, some = int(f.argmax()), f > 0.0  # without any pixel there is no precision
        axis.plot(
            recall[some],
            precision[some],
            "-" if number < ours else "--",
            color=f"C{number}",
            label=f"{title}: {f[at]:.3f}",
        )
        axis.plot(recall[at], precision[at], "o", color=f"C{number}")
    axis.set(xlabel="recall", ylabel="precision", xlim=(0, 1), ylim=(0, 1), title="edges beside drawn boundaries (ODS)")
    axis.legend(loc="lower left")
    figure.savefig(path, dpi=100)
    pyplot.close(figure)


def _pyplot() -> Any:
    try:
        import matplotlib
    except ImportError as error:
        raise ValueError(
            f"the curves need matplotlib ({sys.executable} -m pip install matplotlib); the tables are written"
        ) from error
    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot
