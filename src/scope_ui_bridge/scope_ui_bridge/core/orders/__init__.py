"""An operator's request as an order to the robot.

Enters: typed requests, the scene, and what recognition sees. Leaves: a selection, a gesture or a lesson, or a refusal
with the value and the limit. ``selection`` has controls, points and lines and the gestures possible there, and
``teaching`` the points from which perception makes a panel.
"""

from scope_ui_bridge.core.orders.selection import (
    Selection,
    action_text,
    goal_words,
    make_gesture,
    make_selection,
    result_words,
)
from scope_ui_bridge.core.orders.teaching import HeldPicture, teaching_text

__all__ = [
    "HeldPicture",
    "Selection",
    "action_text",
    "goal_words",
    "make_gesture",
    "make_selection",
    "result_words",
    "teaching_text",
]
