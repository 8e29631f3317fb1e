"""Detects changes of a screen other than its periodic content.

A running trace changes hundreds of cells, and each of them may rest for a second between two changes. A cell therefore
counts only after a rest longer than the period of the trace. A cell that changed without others must rest twice as long
from then on. A change must last: a cell that keeps changing belongs to a trace.

A stopped trace leaves the whole screen at rest, which a running one never does. Then all cells count at once, and the
trace may run for a moment before the change lasts, as after a single acquisition. This does not apply to a screen that
rests between changes of its own, for example of a reading.

Glass reflects the room. An arm above it takes a part of this reflected light away, alike in all colours. Such cells
count as hidden.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from harris_perception.core.recognition.control_samples import on_top
from harris_perception.core.recognition.state_config import StateConfig
from icu_common.core.geometry.geometry import Array
from icu_common.core.panel.panel_layout import Control

CONFIRMED = 3
"""Number of successive images that must show a change."""
FORGOTTEN = 10
"""Number of images after which a lasting change of too few cells becomes usual."""
LONGEST_GAP_S = 0.5
"""Maximum time between two images without a gap in the observation."""
LONGEST_REST_S = 60.0
"""Maximum rest that a cell needs."""
STILL_S = 1.5
"""Time at rest of a whole screen after which all its cells count."""
UNBROKEN = 2.0
"""Time without a shorter rest of the whole screen before its rest counts, as a multiple of a cell's required rest."""
LONGEST_RUN_NS = 2_000_000_000
"""Maximum time for which a screen at rest may keep changing before the change lasts."""
KEPT_REST = 0.75
"""Share of the required rest that a cell keeps after a reported change: the next press comes within three seconds."""
_SHARE = 0.3
"""Weight of a new image in the usual appearance."""
_DEEPEST_SHADE = 0.45
"""Maximum share of the reflected light that a shadow takes away."""
_EVEN = 0.4
"""Minimum ratio of the smallest to the largest loss of a colour channel in a shadow."""
_NOT_DRAWN = 20.0
"""Percentile of the cells' brightness that shows the reflected light alone: most of a screen is dark."""


class ScreenWatch:
    """Cells of one screen.

    Parameters
    ----------
    shape
        Rows and columns.
    change
        Minimum difference of a changed cell, in grey levels.
    cells
        Number of changed cells that count as a change of the screen.
    rest_s
        Rest after which a cell counts.
    """

    def __init__(self, shape: tuple[int, int], change: float, cells: int, rest_s: float) -> None:
        self._change, self._cells, self._rest_s = change, cells, rest_s
        self.changed_ns = 0
        self._usual = self._last = np.zeros((*shape, 3))
        self._known = np.zeros(shape, bool)
        self._rest = np.zeros(shape)
        self._needed = np.full(shape, rest_s)
        self._age = np.zeros(shape, int)
        """Number of images that have shown the present change of a cell, 0 without one."""
        self._begin_ns = np.zeros(shape, np.int64)
        self._at_rest = np.zeros(shape, bool)
        """Whether the whole screen was at rest when the present change began."""
        self._still_s = self._unbroken_s = 0.0
        self._last_ns, self._light = 0, 1.0

    def add(self, value: Array, seen: npt.NDArray[np.bool_], stamp_ns: int, light: float) -> None:
        """Add one image.

        Parameters
        ----------
        value
            (rows, columns, 3) mean grey levels of each cell.
        seen
            (rows, columns) whether the cell is visible.
        stamp_ns
            Of the image.
        light
            Brightness of the room; 1 is usual.
        """
        seen = seen & ~(self._known & self._shaded(value, light))
        gap_s = min((stamp_ns - self._last_ns) / 1e9, LONGEST_GAP_S) if self._last_ns else 0.0
        quiet = unlit(value, self._last, light / self._light) < self._change / 2
        off = unlit(value, self._usual, light) > self._change
        first = seen & ~self._known
        at_rest = self._ends_rest(seen & self._known & off & ~quiet, gap_s)
        begins = seen & self._known & off & (self._age == 0) & (at_rest | (self._rest >= self._needed))
        runs = self._at_rest & (stamp_ns - self._begin_ns <= LONGEST_RUN_NS)
        lasts = seen & off & (quiet | runs) & (self._age > 0)
        fails = seen & (self._age > 0) & ~lasts
        self._age[lasts] = np.where(quiet, self._age + 1, 1)[lasts]
        self._age[begins], self._begin_ns[begins], self._at_rest[begins] = 1, stamp_ns, at_rest
        # The change ended or continues: this cell changes by itself, or shows a trace that has started.
        self._age[fails], self._rest[fails] = 0, 0.0
        own = fails & ~self._at_rest
        self._needed[own] = np.minimum(2.0 * self._needed[own], LONGEST_REST_S)
        self._accept(value)
        calm = seen & (self._age == 0)
        self._rest = np.where(calm, np.where(quiet, self._rest + gap_s, 0.0), self._rest)
        slow = np.where(calm[..., None], self._usual + _SHARE * (value - self._usual), self._usual)
        self._usual = np.where(first[..., None], value, slow)
        self._rest[first] = 0.0
        self._known |= seen
        self._last = np.where(seen[..., None], value, self._last)
        self._last_ns, self._light = stamp_ns, light

    def _shaded(self, value: Array, light: float) -> npt.NDArray[np.bool_]:
        """Return which cells a shadow may have darkened, by less than the screen alone may change."""
        if not self._known.any():
            return np.zeros(self._known.shape, bool)
        reflected = np.percentile(self._usual[self._known], _NOT_DRAWN, axis=0)
        lost = self._usual * min(light, 1.0) - value
        most, least = lost.max(axis=-1), lost.min(axis=-1)
        deep = (lost <= _DEEPEST_SHADE * reflected).all(axis=-1)
        return np.asarray((most > self._change / 2) & deep & (least >= _EVEN * most))

    def _ends_rest(self, stirred: npt.NDArray[np.bool_], gap_s: float) -> bool:
        """Return whether the cells that have just changed end a rest of the whole screen that counts."""
        self._unbroken_s += gap_s
        self._still_s += gap_s
        # Fewer cells than count as a change: of a small reading, now more and now fewer cells differ enough.
        if 2 * int(stirred.sum()) < self._cells:
            return False
        still_s, self._still_s = self._still_s, 0.0
        counts = still_s >= STILL_S and self._unbroken_s >= UNBROKEN * self._rest_s
        if STILL_S <= still_s < self._rest_s:
            self._unbroken_s = 0.0
        return counts

    def _accept(self, value: Array) -> None:
        """Report a change that enough cells confirm; accept a change of too few cells as usual."""
        confirmed = self._age >= CONFIRMED
        if int(confirmed.sum()) >= self._cells:
            # The latest stamp at or after which the required number of cells started to change.
            self.changed_ns = int(np.sort(self._begin_ns[confirmed])[-self._cells])
            self._rest[confirmed] = KEPT_REST * self._needed[confirmed]
        elif (old := self._age >= FORGOTTEN).any():
            confirmed = old
        else:
            return
        self._usual = np.where(confirmed[..., None], value, self._usual)
        self._age[confirmed] = 0


def unlit(value: Array, before: Array, light: float) -> Array:
    """Return the change of cells (rows, columns, channels) that light does not explain, (rows, columns).

    The exposure changes everything that a screen shows, a lamp in the room only what the screen reflects.
    """
    low, high = before * min(light, 1.0), before * max(light, 1.0)
    return np.asarray(np.abs(value - np.clip(value, low, high)).max(axis=-1))


class ScreenCells:
    """Usual appearance of each cell of a screen, and the time of the last change of enough resting cells."""

    def __init__(self, control: Control, config: StateConfig) -> None:
        columns, rows = (max(4, round(side / config.cell_mm)) for side in control.size_mm)
        fine = 2  # samples per cell, in each direction
        x = (np.arange(columns * fine) + 0.5) / (columns * fine) * 2 - 1
        y = (np.arange(rows * fine) + 0.5) / (rows * fine) * 2 - 1
        grid = np.stack(np.meshgrid(0.98 * x, 0.98 * y), axis=-1).reshape(-1, 2)
        self.points_m = on_top(control, grid)
        self.shape = (rows, fine, columns, fine)
        self._watch = ScreenWatch((rows, columns), config.cell_change, config.changed_cells, config.cell_rest_s)

    @property
    def changed_ns(self) -> int:
        """Stamp of the newest change."""
        return self._watch.changed_ns

    def cells(self, samples: Array) -> Array:
        """Return the means of the cells, (rows, columns, channels)."""
        means: Array = samples.reshape(*self.shape, -1).mean(axis=(1, 3))
        return means

    def add(self, samples: Array, hidden: npt.NDArray[np.bool_], stamp_ns: int, light: float) -> None:
        """Add one image's samples (N, 3), which of them are hidden (N,), and its brightness (1 is usual)."""
        seen = self.cells(hidden.astype(np.float64))[..., 0] == 0
        self._watch.add(self.cells(samples), seen, stamp_ns, light)
