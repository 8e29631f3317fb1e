"""Rejection of views from which no calibration can be computed."""

from __future__ import annotations

from collections.abc import Sequence

from harris_perception.core.cameras.board import CalibrationBoard
from harris_perception.core.cameras.board_detection import BoardView
from harris_perception.core.cameras.calibration_config import CalibrationConfig
from harris_perception.core.cameras.view_coverage import CalibrationError, tilt_spread_deg

_MIN_SPREAD_DEG = 6.0


def require_tilts(spread: float, count: int) -> None:
    """Reject ``count`` views whose boards are parallel.

    Raises
    ------
    CalibrationError
        If the tilts differ by less than is needed.
    """
    if spread < _MIN_SPREAD_DEG:
        raise CalibrationError(
            f"the board is parallel to itself in all {count} views (tilts differ by {spread:.1f} degrees, at least "
            f"{_MIN_SPREAD_DEG:g} are needed): focal length and distance cannot be told apart; add views with the "
            "board tilted by 20 to 45 degrees to the left, right, up and down"
        )


def require_views(board: CalibrationBoard, views: Sequence[BoardView], config: CalibrationConfig) -> tuple[int, int]:
    """Return the size of all images.

    Raises
    ------
    CalibrationError
        For too few views, images of different sizes, a repeated image, or a board that was always held in the same way.
    """
    if len(views) < config.min_views:
        raise CalibrationError(
            f"the board was found in {len(views)} pictures; expected at least {config.min_views} (15 are good): "
            "take more, with the whole board sharp and evenly lit"
        )
    for view in views:
        if view.size != views[0].size:
            raise CalibrationError(
                f"{view.name} is {view.size[0]} x {view.size[1]} px but {views[0].name} is {views[0].size[0]} x "
                f"{views[0].size[1]} px: use pictures of one size, the one that the camera will run with"
            )
    seen: dict[bytes, BoardView] = {}
    for view in views:
        if (before := seen.setdefault(view.xy.tobytes(), view)) is not view:
            raise CalibrationError(
                f"{before.name} and {view.name} are one picture: every corner is at the same place, to the last digit; "
                "take one of them out"
            )
    require_tilts(tilt_spread_deg(board, views), len(views))
    return views[0].size
