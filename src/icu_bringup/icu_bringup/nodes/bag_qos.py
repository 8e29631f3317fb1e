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
"""Queue depths of a delayed recorder, for small and for large messages; memory allows no more large ones."""


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
    """Return a publisher's profile in the form of bags."""

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
    """Return whether messages of ``package/msg/Name`` are images or clouds."""
    return kind in _LARGE


def listening_qos(kind: str, offers: Sequence[QoSProfile]) -> QoSProfile:
    """Return a recorder's request: the strictest profile that all publishers of a topic offer, as in ros2 bag.

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
    """Return a player's offer: that of all recorded publishers, otherwise reliable and volatile.

    The player replaces all publishers: for late subscribers it keeps as many messages as they kept together.

    Bags of Jazzy do not contain the publishers' history; a depth of 50 replaces it. Volatile topics have at least this
    depth: subscribers cannot detect the difference, but messages played faster than recorded arrive completely.
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
