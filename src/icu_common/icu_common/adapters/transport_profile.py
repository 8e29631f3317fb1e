"""What of the environment is Fast DDS's: its profile, domain and peers; and whether pictures fit into its sockets."""

from __future__ import annotations

import os
import socket
from importlib import resources
from pathlib import Path

PROFILE_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
RANGE_VARIABLE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_SOCKET_BUFFER_BYTES = 4 << 20
_LAST_DOMAIN = 232
"""Ports of the next one would be above 65535 (RTPS 2.5, 9.6.2.3)."""


def check_environment() -> None:
    """Raise a ValueError for a domain or a peer that Fast DDS cannot take: it would end the process without a word.

    Raises
    ------
    ValueError
        With the variable, its value and what is needed.
    """
    domain = os.environ.get("ROS_DOMAIN_ID", "")
    try:
        known = not domain or 0 <= int(domain, 0) <= _LAST_DOMAIN
    except ValueError:
        known = False
    if not known:
        raise ValueError(f"ROS_DOMAIN_ID = {domain!r}: a whole number from 0 to {_LAST_DOMAIN} is needed")
    for peer in filter(None, os.environ.get("ROS_STATIC_PEERS", "").split(";")):
        try:
            socket.getaddrinfo(peer, None)
        except (OSError, UnicodeError) as error:
            raise ValueError(f"ROS_STATIC_PEERS: no address of {peer!r} is found: {error}") from error


def profiles_folder() -> Path:
    """Return where the graph's own profiles are."""
    return Path(str(resources.files("icu_common"))).resolve()


def is_users_own() -> bool:
    """Whether the environment names a profile that is not the graph's."""
    named = os.environ.get(PROFILE_VARIABLE, "")
    return named != "" and Path(named).resolve().parent != profiles_folder()


def keeps_to_this_host() -> bool:
    """Whether nothing in the environment asks for others than this host's programs: a range, a peer or a server."""
    opened = any(os.environ.get(name) for name in ("ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER"))
    wanted = os.environ.get(RANGE_VARIABLE, "LOCALHOST")
    of_parent = Path(os.environ.get(PROFILE_VARIABLE, "")).name.startswith("fastdds_local_sockets")
    return (wanted == "LOCALHOST" or (wanted == "SYSTEM_DEFAULT" and of_parent)) and not opened


def sockets_hold_pictures() -> bool:
    """Whether this system grants the buffers that the profiles ask for (Linux: net.core.rmem_max, wmem_max)."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
            probe.setsockopt(socket.SOL_SOCKET, option, _SOCKET_BUFFER_BYTES)
            if probe.getsockopt(socket.SOL_SOCKET, option) < 2 * _SOCKET_BUFFER_BYTES:  # socket(7): it tells twice
                return False
    return True
