"""Selects the live views of a board to keep: the board is still, and its pose differs from earlier views."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from harris_perception.core.cameras.board import CalibrationBoard
from harris_perception.core.cameras.board_detection import BoardView
from harris_perception.core.cameras.view_coverage import Reach, coverage, is_still, view_place
from icu_common.core.reasons.message import Message, joined

_DIFFERENCE = 0.2  # summed over x, y, size and skew, as in ROS's camera_calibration


class ViewCollection:
    """The views kept so far; each is one view, or one per camera.

    Parameters
    ----------
    board
        The board shown.
    wanted
        Number of views that is enough when nothing is missing.
    """

    def __init__(self, board: CalibrationBoard, wanted: int = 20) -> None:
        self.board, self.wanted = board, wanted
        self.kept: list[tuple[BoardView, ...]] = []
        self._places: list[np.ndarray] = []
        self._last: BoardView | None = None

    def offer(self, views: Sequence[BoardView | None]) -> str:
        """Keep the views of one instant, or return the reason for not keeping them; empty means kept."""
        found = [view for view in views if view is not None]
        if len(found) < len(views):
            self._last = None
            return (
                Message("views.board_not_seen_whole")
                if len(views) == 1
                else Message("views.board_not_seen_both_cameras")
            )
        last, self._last = self._last, found[0]
        if last is None or not is_still(last, found[0]):
            return Message("views.hold_board_still")
        place = view_place(self.board, found[0])
        if self._places and min(np.abs(place - other).sum() for other in self._places) < _DIFFERENCE:
            return Message("views.hold_board_differently")
        self._places.append(place)
        self.kept.append(tuple(found))
        return ""

    @property
    def reaches(self) -> tuple[Reach, ...]:
        """Coverage by the first camera's views."""
        return coverage(self.board, [views[0] for views in self.kept])

    @property
    def complete(self) -> bool:
        """Whether there are enough views and nothing is missing."""
        return len(self.kept) >= self.wanted and not any(reach.missing for reach in self.reaches)

    @property
    def progress(self) -> str:
        """Progress and the next step, in one line."""
        missing = (
            [reach.missing for reach in self.reaches if reach.missing] if self.kept else [Message("views.show_board")]
        )
        return joined([Message("views.views", kept=len(self.kept), wanted=self.wanted), *missing])
