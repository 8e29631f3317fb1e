"""Fast DDS's part of the environment (profile, domain, peers), and whether images fit into its socket buffers."""

from __future__ import annotations

import os
import socket
from importlib import resources
from pathlib import Path

PROFILE_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
RANGE_VARIABLE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_SOCKET_BUFFER_BYTES = 4 << 20
_LAST_DOMAIN = 232
"""Largest ROS domain: the ports of the next one would be above 65535 (RTPS 2.5, 9.6.2.3)."""


def check_environment() -> None:
    """Check domain and peers: Fast DDS would end the process without a message on an invalid one.

    Raises
    ------
    ValueError
        With the variable, its value and the expected values.
    """
    domain = os.environ.get("ROS_DOMAIN_ID", "")
    try:
        known = not domain or 0 <= int(domain, 0) <= _LAST_DOMAIN
    except ValueError:
        known = False
    if not known:
        raise ValueError(f"ROS_DOMAIN_ID = {domain!r}; expected a whole number from 0 to {_LAST_DOMAIN}")
    for peer in filter(None, os.environ.get("ROS_STATIC_PEERS", "").split(";")):
        try:
            socket.getaddrinfo(peer, None)
        except (OSError, UnicodeError) as error:
            raise ValueError(f"ROS_STATIC_PEERS: no address of {peer!r} is found: {error}") from error


def profiles_folder() -> Path:
    """Return the folder of the graph's own profiles."""
    return Path(str(resources.files("icu_common"))).resolve()


def is_users_own() -> bool:
    """Whether the environment names a profile that is not the graph's."""
    named = os.environ.get(PROFILE_VARIABLE, "")
    return named != "" and Path(named).resolve().parent != profiles_folder()


def keeps_to_this_host() -> bool:
    """Whether the environment limits the graph to this host: no discovery range, peer or server opens the network."""
    opened = any(os.environ.get(name) for name in ("ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER"))
    wanted = os.environ.get(RANGE_VARIABLE, "LOCALHOST")
    of_parent = Path(os.environ.get(PROFILE_VARIABLE, "")).name.startswith("fastdds_local_sockets")
    return (wanted == "LOCALHOST" or (wanted == "SYSTEM_DEFAULT" and of_parent)) and not opened


def sockets_hold_pictures() -> bool:
    """Whether this system grants the buffers that the profiles request (Linux: net.core.rmem_max, wmem_max)."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
            probe.setsockopt(socket.SOL_SOCKET, option, _SOCKET_BUFFER_BYTES)
            if probe.getsockopt(socket.SOL_SOCKET, option) < 2 * _SOCKET_BUFFER_BYTES:  # socket(7) reports double
                return False
    return True
