"""QoS profiles and message classes between rclpy and bags."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Any

from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

_DEPTH = 50
_LARGE = (
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/PointCloud2",
    "stereo_msgs/msg/DisparityImage",
)
_HEARD, _HEARD_LARGE = 1000, _DEPTH
"""So many messages wait for a recorder that is held up; of what is large there is no memory for more."""


def message_class(name: str) -> Any:
    """Return the class of ``package/msg/Name``.

    Raises
    ------
    ModuleNotFoundError, AttributeError, ValueError
        If it is not installed here.
    """
    package, _, kind = name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), kind)


def recorded_qos(profile: QoSProfile) -> Qos:
    """Return a publisher's profile as bags keep it."""

    def time(duration: Duration) -> QosTime:
        return QosTime(*divmod(duration.nanoseconds, 1_000_000_000))

    return Qos(
        QosHistory(profile.history.value),
        profile.depth,
        QosReliability(profile.reliability.value),
        QosDurability(profile.durability.value),
        time(profile.deadline),
        time(profile.lifespan),
        QosLiveliness(profile.liveliness.value),
        time(profile.liveliness_lease_duration),
        profile.avoid_ros_namespace_conventions,
    )


def is_large(kind: str) -> bool:
    """Return whether messages of ``package/msg/Name`` are pictures or clouds."""
    return kind in _LARGE


def listening_qos(kind: str, offers: Sequence[QoSProfile]) -> QoSProfile:
    """Return what a recorder asks for: the strictest that all publishers of a topic offer, as ros2 bag does.

    ``kind`` is ``package/msg/Name``.
    """
    reliable = all(offer.reliability is ReliabilityPolicy.RELIABLE for offer in offers)
    latched = all(offer.durability is DurabilityPolicy.TRANSIENT_LOCAL for offer in offers)
    return QoSProfile(
        depth=_HEARD_LARGE if is_large(kind) else _HEARD,
        history=HistoryPolicy.KEEP_LAST,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def playing_qos(offers: Sequence[Qos]) -> QoSProfile:
    """Return what a player offers: what all of the recorded publishers offered, else reliable and volatile.

    The player replaces all publishers: for late subscribers it keeps as many messages as they kept together.

    Bags of Jazzy do not know the publishers' history; a depth of 50 takes its place. Volatile topics have no less:
    nobody can tell the difference, but what is played faster than it was recorded arrives whole.
    """
    same = offers[0] if len(set(offers)) == 1 else None
    if same is None:
        return QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.RELIABLE)
    profile = QoSProfile(depth=(same.depth or _DEPTH) * len(offers), history=HistoryPolicy.KEEP_LAST)
    if same.reliability in (QosReliability.RELIABLE, QosReliability.BEST_EFFORT):
        profile.reliability = ReliabilityPolicy(same.reliability.value)
    if same.durability in (QosDurability.TRANSIENT_LOCAL, QosDurability.VOLATILE):
        profile.durability = DurabilityPolicy(same.durability.value)
    if profile.durability is not DurabilityPolicy.TRANSIENT_LOCAL:
        profile.depth = max(profile.depth, _DEPTH)
    if same.liveliness in (QosLiveliness.AUTOMATIC, QosLiveliness.MANUAL_BY_TOPIC):
        profile.liveliness = LivelinessPolicy(same.liveliness.value)
    return profile
