"""The QoS profiles of the graph (REP-2003); nowhere else is a profile written down."""

from __future__ import annotations

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from icu_common.adapters.transport_profile import is_users_own, keeps_to_this_host, sockets_hold_pictures

ARRIVES_WHOLE = keeps_to_this_host() and sockets_hold_pictures() and not is_users_own()
"""Whether what a best-effort reader gets arrives complete: on this host, by sockets whose buffers hold an image."""
_AS_SENT = ReliabilityPolicy.BEST_EFFORT if ARRIVES_WHOLE else ReliabilityPolicy.RELIABLE
"""Of readers of pictures: what arrives whole need not be asked for again, and readers that do hang after a kill
(docs/decisions/transport.md)."""

IMAGES = QoSProfile(
    depth=5,
    history=HistoryPolicy.KEEP_LAST,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""Publisher of pictures: reliable, so that both reliable and best-effort readers match; see docs/decisions."""

SENSOR = QoSProfile(depth=5, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Small periodic values of which only the newest counts."""

NEWEST = QoSProfile(depth=2, history=HistoryPolicy.KEEP_LAST, reliability=_AS_SENT)
"""Reader that works on the newest picture only, see icu_common.nodes.newest: two, so that an overrun is noticed."""

PICTURES = QoSProfile(depth=5, history=HistoryPolicy.KEEP_LAST, reliability=_AS_SENT)
"""Reader of all pictures, and of what belongs to each of them."""

RESULTS = QoSProfile(depth=10, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.RELIABLE)
"""Results and streams of which none should be lost."""

LATCHED = QoSProfile(
    depth=1,
    history=HistoryPolicy.KEEP_LAST,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""State that a late subscriber needs at once."""

EACH_LATCHED = QoSProfile(
    depth=20,
    history=HistoryPolicy.KEEP_LAST,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""Reader of a latched state that acts on each change, be it held up meanwhile: a stop that was reset since is one."""

COMMAND = QoSProfile(
    depth=10,
    history=HistoryPolicy.KEEP_LAST,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
    lifespan=Duration(seconds=1),
)
"""What moves the machine: never late, never twice. Commands older than a second die on the way.

Of several that come at once the first is obeyed and the others are refused; at a depth of one the last drove the others
out, and nobody answered them."""
