"""Check of G-code programs, line by line, before the first byte is sent: modes, length, arcs, travel.

The rules are those of GRBL 1.1's parser; messages name its error numbers. This machine adds one rule: every target,
relative or with a work offset, must lie inside the travel, and so must a whole arc.

The driver sends an equivalent program (docs/decisions/lines-after-a-reset.md). Each move names its motion at the end of
the line, and a feed only where the feed changes. A rapid move becomes a G1 at the highest feed, and an inverse time
becomes the equivalent feed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from gantry_driver.core.grbl.lines import MAX_LINE_BYTES, plain
from gantry_driver.core.program.arcs import Arc
from gantry_driver.core.program.gcode_words import GROUP_OF, GcodeError, ParsedLine, Word, parse_words
from gantry_driver.core.program.polyline import Polyline

Vector = tuple[float, float, float]

_NO_AXES = frozenset({"G4", "G49", "G92.1", "M2", "M30"})
"""Commands without axis words: with most of them GRBL executes axis words as a separate move; with G49 it ignores
them."""
_PLANES = {"G17": (0, 1, 2), "G18": (2, 0, 1), "G19": (1, 2, 0)}
_ROUNDING_MM = 1e-6
"""Rounding that sums and the sixth decimal of a line may add to a target; a board allows nothing beyond its travel."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckedLine:
    """A line as it will be sent, its source, and the approximate duration of its motion at its feed."""

    number: int
    text: str
    seconds: float
    along_mm: float
    """Distance along the program's path at its end."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """Travel in machine coordinates, mm, and rates of rapid moves, mm/min; each for x, y, z."""

    low_mm: Vector
    high_mm: Vector
    rapid_mm_min: Vector


@dataclass(slots=True)
class _Modes:
    motion: str = "G0"
    plane: str = "G17"
    distance: str = "G90"
    feed_mode: str = "G94"
    scale: float = 1.0
    system: str = "G54"
    feed: float = 0.0
    sent_feed: float = 0.0
    shift: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])


class ProgramChecker:
    """Follows the modes and the position of a program in the same way as the board.

    Parameters
    ----------
    bounds
        Travel and rapid rates of the machine.
    start_mm
        Machine position at which the program starts.
    offsets_mm
        Work offsets by coordinate system, as ``$#`` prints them; the program may select only these systems.
    kept_g92
        Whether they may include an earlier G92, which G92.1 would cancel.
    axes
        Number of axes in the board's reports.
    """

    def __init__(
        self,
        bounds: Bounds,
        start_mm: Sequence[float],
        offsets_mm: Mapping[str, Vector] | None = None,
        *,
        kept_g92: bool = False,
        axes: int = 3,
    ) -> None:
        self._bounds = bounds
        self._at = [float(v) for v in start_mm[:3]]
        self.path = Polyline(self._at, axes)
        """The path of the lines checked so far."""
        self._offsets = dict(offsets_mm or {"G54": (0.0, 0.0, 0.0)})
        self._kept_g92 = kept_g92
        self.begins = (self.position_mm, dict(self._offsets), kept_g92)
        """Start position and offsets of the program."""
        self.seconds = 0.0
        """Approximate duration of the lines checked so far."""
        self._modes = _Modes()
        self._number = 0

    @property
    def position_mm(self) -> Vector:
        """Machine position after the lines checked so far."""
        x, y, z = self._at
        return x, y, z

    def check_all(self, lines: Iterable[str]) -> Iterator[CheckedLine]:
        """Check a program; yield the lines that must be sent.

        Raises
        ------
        GcodeError
            At the first line that cannot be sent.
        """
        for raw in lines:
            checked = self.check(raw)
            if checked is not None:
                yield checked

    def check(self, raw: str) -> CheckedLine | None:
        """Check the next line; return None if no part of it must be sent."""
        self._number += 1
        line = parse_words(self._number, raw)
        if line is None:
            return None
        seconds, feed = self._follow(line)
        self.seconds += seconds
        self._all_used(line)
        text = self._written(line.words, feed)
        if len(text) + 1 > MAX_LINE_BYTES:
            reason = f"{len(text) + 1} bytes with the newline, {MAX_LINE_BYTES} can be sent"
            raise GcodeError(self._number, MAX_LINE_BYTES, reason)
        if not text:
            return None
        return CheckedLine(number=self._number, text=text, seconds=seconds, along_mm=self.path.length_mm)

    def _written(self, words: Sequence[Word], feed: float) -> str:
        """Return the line for the board; ``feed`` is in mm/min, 0 if nothing moves."""
        modes = self._modes
        kept = [w for w in words if w.letter != "F" and GROUP_OF.get(w.name) not in ("motion", "feed_mode")]
        if not any(w.letter in "XYZ" for w in kept):
            return "".join(f"{w.letter}{plain(w.value, 6)}" for w in kept if w.name != "G53")
        # Values before commands: after a reset cuts a line, its rest is not a move.
        text = "".join(f"{w.letter}{plain(w.value, 6)}" for w in sorted(kept, key=lambda w: w.letter in "GM"))
        if not feed:
            return text
        speed = "" if feed == modes.sent_feed else f"F{plain(feed / modes.scale, 6)}"
        modes.sent_feed = feed
        return f"{speed}{text}{'G1' if modes.motion == 'G0' else modes.motion}"

    def _follow(self, line: ParsedLine) -> tuple[float, float]:
        """Return the line's duration in seconds and the feed of its move in mm/min, 0 without a move."""
        modes, commands, values, axes = self._modes, line.commands, line.values, line.axes
        modes.scale = {"G20": 25.4, "G21": 1.0}.get(commands.get("units", ""), modes.scale)
        modes.plane = commands.get("plane", modes.plane)
        modes.distance = commands.get("distance", modes.distance)
        self._feed_by(commands.get("feed_mode", modes.feed_mode))
        system = commands.get("coordinate system", modes.system)
        if system not in self._offsets:
            raise line.error(line.words[0], f"the offset of {system} is not known here")
        modes.system = system
        if "F" in values:
            modes.feed = values["F"].value * (modes.scale if modes.feed_mode == "G94" else 1.0)
        if "program" in commands:
            modes.motion, modes.plane, modes.distance, modes.system = "G1", "G17", "G90", "G54"
            self._feed_by("G94")
        special = commands.get("non-modal", "")
        if axes and (taken := _NO_AXES.intersection(commands.values())):
            raise line.error(line.axes[0], f"{min(taken)} takes no axis words: a board would move by them")
        if special == "G4":
            if "P" not in values:
                raise line.error(line.words[0], "G4 needs P (error:28)")
            return values["P"].value, 0.0
        if special.startswith("G92"):
            self._shift(special, line)
            return 0.0, 0.0
        modes.motion = commands.get("motion", modes.motion)
        if special == "G53" and modes.motion not in ("G0", "G1"):
            raise line.error(line.words[0], "G53 needs G0 or G1 (error:30)")
        if modes.motion == "G80":
            if axes:
                raise line.error(line.axes[0], "axis words without a motion (error:31)")
            return 0.0, 0.0
        if not axes:
            if "motion" in commands and modes.motion in ("G2", "G3"):
                raise line.error(line.words[0], "an arc needs an axis word of its plane (error:26)")
            return 0.0, 0.0
        none = plain(modes.feed / modes.scale, 6) == "0"
        if modes.motion != "G0" and (none or (modes.feed_mode == "G93" and "F" not in values)):
            raise line.error(line.axes[0], "no feed rate (error:22)")
        return self._move(special == "G53", line)

    def _all_used(self, line: ParsedLine) -> None:
        used, commands, values = "FNSTXYZ", line.commands, line.values
        if commands.get("non-modal") == "G4":
            used += "P"
        elif "non-modal" not in commands and self._modes.motion in ("G2", "G3") and not values.keys().isdisjoint("XYZ"):
            used += "R" if "R" in values else "IJK"
        for letter, word in values.items():
            if letter not in used:
                raise line.error(word, f"{letter} is of no use here (error:36)")

    def _feed_by(self, mode: str) -> None:
        """Switch to a feed mode; an F value of another mode is no feed in this one."""
        if mode != self._modes.feed_mode:
            self._modes.feed_mode, self._modes.feed = mode, 0.0

    def _shift(self, special: str, line: ParsedLine) -> None:
        modes, values = self._modes, line.values
        if special == "G92.1":
            offset = self._offsets[modes.system]
            if self._kept_g92 and any(offset):
                raise line.error(
                    next(word for word in line.words if word.name == special),
                    f"G92.1 moves all targets by what of the work offset ({', '.join(f'{v:g}' for v in offset)}) mm is "
                    "a G92, and how much that is, is not known here: leave it out, and send it from a terminal before",
                )
            modes.shift, self._kept_g92 = [0.0, 0.0, 0.0], False
            return
        if not line.axes:
            raise line.error(line.words[0], "G92 needs axis words (error:26)")
        for axis, letter in enumerate("XYZ"):
            if letter in values:
                value = values[letter].value * modes.scale
                modes.shift[axis] = self._at[axis] - self._offsets[modes.system][axis] - value

    def _move(self, machine: bool, line: ParsedLine) -> tuple[float, float]:
        modes, values, target = self._modes, line.values, list(self._at)
        for axis, letter in enumerate("XYZ"):
            if letter not in values:
                continue
            value = values[letter].value * modes.scale
            if machine:
                target[axis] = value
            elif modes.distance == "G91":
                target[axis] += value
            else:
                target[axis] = value + self._offsets[modes.system][axis] + modes.shift[axis]
        if modes.motion in ("G2", "G3"):
            arc = self._arc(target, line)
            length, extremes, way = arc.length, arc.extremes(), arc.chords()
        else:
            length, extremes, way = math.dist(self._at, target), [target], [target]
        for point in extremes:
            self._inside(point, line)
        seconds, feed = self._pace(length, target)
        for point in way:
            self.path.append(point, feed)
        self._at = target
        return seconds, feed

    def _inside(self, point: Sequence[float], line: ParsedLine) -> None:
        for axis, letter in enumerate("XYZ"):
            low, high = self._bounds.low_mm[axis], self._bounds.high_mm[axis]
            if not low - _ROUNDING_MM <= point[axis] <= high + _ROUNDING_MM:
                word = line.values.get(letter, line.axes[0])
                found = f"{point[axis]:.3f}"
                if low <= float(found) <= high:
                    found = f"{point[axis]:.6f}"
                raise line.error(word, f"{letter} = {found} mm (machine) is outside {low:g} to {high:g} mm (ALARM:2)")

    def _pace(self, length: float, target: Sequence[float]) -> tuple[float, float]:
        """Return the duration of a move in seconds and its feed in mm/min."""
        modes, rapid = self._modes, self._bounds.rapid_mm_min
        if modes.motion == "G0":
            # The board limits each axis to its rate, so a move at this feed is rapid in any direction.
            return max(60.0 * abs(t - a) / r for t, a, r in zip(target, self._at, rapid)), math.ceil(math.hypot(*rapid))
        if modes.feed_mode == "G93":
            # Below 1 mm/min the planner needs minutes for one step.
            return 60.0 / modes.feed, max(length * modes.feed, 1.0)
        return 60.0 * length / modes.feed, modes.feed

    def _arc(self, target: list[float], line: ParsedLine) -> Arc:
        modes, values = self._modes, line.values
        a, b, _ = plane = _PLANES[modes.plane]
        if "XYZ"[a] not in values and "XYZ"[b] not in values:
            raise line.error(line.axes[0], "an arc needs an axis word of its plane (error:26)")
        clockwise = modes.motion == "G2"
        start, end = (self._at[a], self._at[b]), (target[a], target[b])
        centre = self._centre(start, end, clockwise, (a, b), line)
        return Arc(start=self._at, end=target, plane=plane, centre=centre, clockwise=clockwise)

    def _centre(
        self,
        start: tuple[float, float],
        end: tuple[float, float],
        clockwise: bool,
        plane: tuple[int, int],
        line: ParsedLine,
    ) -> tuple[float, float]:
        modes, values = self._modes, line.values
        if "R" in values:
            radius = values["R"].value * modes.scale
            chord = math.dist(start, end)
            if chord == 0 or chord > 2 * abs(radius) * (1 + 1e-9):
                raise line.error(values["R"], f"radius {radius:g} mm does not span {chord:g} mm (error:34)")
            height = math.sqrt(max(radius * radius - chord * chord / 4, 0.0))
            side = height if clockwise == (radius < 0) else -height
            along = ((end[0] - start[0]) / chord, (end[1] - start[1]) / chord)
            middle = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)
            return middle[0] - side * along[1], middle[1] + side * along[0]
        offsets = ["IJK"[axis] for axis in plane]
        if not any(letter in values for letter in offsets):
            raise line.error(line.axes[0], f"an arc needs {offsets[0]}, {offsets[1]} or R (error:35)")
        di, dj = (values[letter].value * modes.scale if letter in values else 0.0 for letter in offsets)
        centre = (start[0] + di, start[1] + dj)
        error = abs(math.dist(start, centre) - math.dist(end, centre))
        # GRBL rejects a difference above 0.5 mm, and one above 0.005 mm that exceeds 0.1 % of the radius.
        if error > 0.5 or (error > 0.005 and error > 0.001 * math.dist(start, centre)):
            raise line.error(line.axes[0], f"the arc's radii differ by {error:.3f} mm (error:33)")
        return centre
