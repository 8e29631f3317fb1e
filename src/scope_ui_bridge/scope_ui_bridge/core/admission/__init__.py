"""Limits of each client's share of the server: connections, rates, sizes.

Enters: a connection or a message with its user and the time. Leaves: whether it may pass. ``places`` are the slots for
connections, ``rates`` the buckets for messages, requests, pictures and stops.
"""

from scope_ui_bridge.core.admission.places import KEPT_PLACES, OWN_PLACES, Places
from scope_ui_bridge.core.admission.rates import (
    BURST,
    BURST_BYTES,
    BYTES_PER_S,
    DROPPED_BURST,
    DROPPED_PER_S,
    MAX_USERS,
    MESSAGES_PER_S,
    OPENED_BURST,
    OPENED_PER_S,
    PICTURES_BURST,
    PICTURES_PER_S,
    PINGS_BURST,
    PINGS_PER_S,
    REQUESTS_BURST,
    REQUESTS_PER_S,
    STOP_BURST,
    STOPS_PER_S,
    USER_BURST,
    Bucket,
    OfUsers,
    UserBudget,
)

__all__ = [
    "BURST",
    "BURST_BYTES",
    "BYTES_PER_S",
    "DROPPED_BURST",
    "DROPPED_PER_S",
    "KEPT_PLACES",
    "MAX_USERS",
    "MESSAGES_PER_S",
    "OPENED_BURST",
    "OPENED_PER_S",
    "OWN_PLACES",
    "PICTURES_BURST",
    "PICTURES_PER_S",
    "PINGS_BURST",
    "PINGS_PER_S",
    "REQUESTS_BURST",
    "REQUESTS_PER_S",
    "STOPS_PER_S",
    "STOP_BURST",
    "USER_BURST",
    "Bucket",
    "OfUsers",
    "Places",
    "UserBudget",
]
