"""The right to move the machine, its duration, and the cause of a stop.

Enters: requests for control, keep-alives, held arrows, stops and their causes. Leaves: the holder of control, the next
step of a jog, and the cause that the pages show. ``lease`` is the right to move, ``jog`` an arrow that a page holds,
and ``stop_cause`` distinguishes the causes of a stop.
"""

from scope_ui_bridge.core.control.jog import HeldJog
from scope_ui_bridge.core.control.lease import OperatorLease
from scope_ui_bridge.core.control.stop_cause import StopCauses

__all__ = ["HeldJog", "OperatorLease", "StopCauses"]
