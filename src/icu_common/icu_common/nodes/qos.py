"""The QoS profiles of the graph (REP-2003); no other module defines one."""

from __future__ import annotations

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from icu_common.adapters.transport_profile import is_users_own, keeps_to_this_host, sockets_hold_pictures

ARRIVES_WHOLE = keeps_to_this_host() and sockets_hold_pictures() and not is_users_own()
"""Whether messages to best-effort readers arrive complete: on this host, by sockets whose buffers hold an image."""
_AS_SENT = ReliabilityPolicy.BEST_EFFORT if ARRIVES_WHOLE else ReliabilityPolicy.RELIABLE
"""Reliability of image readers: complete messages need no retransmission, and readers that request it can hang after a
kill (docs/decisions/transport.md)."""

IMAGES = QoSProfile(
    depth=5,
    history=HistoryPolicy.KEEP_LAST,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""Publisher of images: reliable, so that both reliable and best-effort readers match; see docs/decisions."""

SENSOR = QoSProfile(depth=5, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Small periodic values of which only the newest counts."""

NEWEST = QoSProfile(depth=2, history=HistoryPolicy.KEEP_LAST, reliability=_AS_SENT)
"""Reader of the newest image only, see icu_common.nodes.newest: the depth of two makes an overrun detectable."""

PICTURES = QoSProfile(depth=5, history=HistoryPolicy.KEEP_LAST, reliability=_AS_SENT)
"""Reader of all images, and of the messages that belong to each image."""

RESULTS = QoSProfile(depth=10, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.RELIABLE)
"""Results and streams without losses."""

REPORTS = QoSProfile(depth=200, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.RELIABLE)
"""Reader of all programs' reports that decides by their codes: none is lost while it is blocked for seconds."""

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
"""Reader of a latched state that must process each change even when it is late, such as a stop that was since reset."""

COMMAND = QoSProfile(
    depth=10,
    history=HistoryPolicy.KEEP_LAST,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
    lifespan=Duration(seconds=1),
)
"""Commands that move the machine: never late, never twice. The middleware drops commands older than a second.

Of several simultaneous commands the first is obeyed and the others are rejected. With a depth of one, the last replaced
the others, and they got no answer."""
