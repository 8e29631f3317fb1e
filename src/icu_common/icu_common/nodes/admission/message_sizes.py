"""Maximum sizes of serialised messages, checked before a message is unpacked.

rclpy unpacks a message under the interpreter's lock: a trajectory of 3.5 MB stops every thread of a process for 0.6 s.
A subscription of :class:`icu_common.nodes.graph_node.GraphNode` therefore receives the serialised bytes, compares
their number with its limit, and drops a larger message; the log names the topic.

The limit is that of the message's type in this module, unless ``create_subscription`` gets another one::

    node.create_subscription(JointTrajectory, "trajectory", on_message, COMMAND, max_bytes=400_000, too_large=refuse)

``too_large`` is called with the size in bytes instead of the callback, for a node that must answer or stop.
"""

from __future__ import annotations

from typing import Any

from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseStamped, PoseWithCovarianceStamped, TransformStamped
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2
from std_msgs.msg import Bool, Empty, Float32, Float64MultiArray, Header, String
from stereo_msgs.msg import DisparityImage
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

_KB, _MB = 1_000, 1_000_000
UNLIMITED = 0
"""Limit of types without strings and arrays: they always unpack to the same few values."""
OTHER_BYTES = 100 * _KB
"""Limit of all other types."""
MAX_BYTES: dict[Any, int] = {
    **dict.fromkeys((Bool, Clock, Duration, Empty, Float32, Time), UNLIMITED),
    **dict.fromkeys((Header, PointStamped, PoseStamped, PoseWithCovarianceStamped, TransformStamped), 2 * _KB),
    JointState: 4 * _KB,
    Float64MultiArray: 4 * _KB,
    CameraInfo: 16 * _KB,
    String: 300 * _KB,
    DiagnosticArray: 300 * _KB,
    MarkerArray: 1 * _MB,
    JointTrajectory: 1 * _MB,
    PointCloud2: 100 * _MB,
    Image: 100 * _MB,
    DisparityImage: 100 * _MB,
}
"""Limit of each type in bytes: several times the largest message of the graph.

The types from Header to TransformStamped hold a frame's name. A panel of 100 controls needs 25 kB as DiagnosticArray
and 60 kB as MarkerArray. A String may be a sequence or the request to teach a panel. A trajectory of 10,000 points has
0.9 MB.
"""


def max_bytes_of(message_type: Any) -> int:
    """Return the limit of a message's type in bytes, 0 for none."""
    return MAX_BYTES.get(message_type, OTHER_BYTES)
