"""Reports of the graph, as the desk knows them.

Enters: states, positions, results and reports of nodes. Leaves: messages for the pages, and refusals while the machine
must not move. ``machine_view`` has the machine and the stamps of its images, ``panel_view`` lamps and knobs,
``sequence_view`` stored and running sequences, ``recordings`` the recorders, and ``liveness`` nodes that are late.
"""

from scope_ui_bridge.core.status.liveness import Change, Condition, LivenessMonitor, Sender, judge
from scope_ui_bridge.core.status.machine_view import MachineView
from scope_ui_bridge.core.status.panel_view import PanelView
from scope_ui_bridge.core.status.recordings import Recordings
from scope_ui_bridge.core.status.sequence_view import SequenceView, stored_name

__all__ = [
    "Change",
    "Condition",
    "LivenessMonitor",
    "MachineView",
    "PanelView",
    "Recordings",
    "Sender",
    "SequenceView",
    "judge",
    "stored_name",
]
