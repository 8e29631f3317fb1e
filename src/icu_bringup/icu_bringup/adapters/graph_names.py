"""Prevents a second graph with the same topics and services: its orders would also reach the first graph's machine."""

from __future__ import annotations

import errno
import os
import socket

from icu_bringup.core.startup.graph_description import GraphDescriptionError

_LONGEST_NAME = 100
"""Maximum length in bytes of a Unix socket's name; the system's limit is 108."""
OTHER_DOMAINS = range(1, 33)
"""ROS domains for simulated graphs after the first one: above 101 their ports may be taken by outgoing connections."""


def hold(name: str) -> bool:
    """Hold a name until this process ends; return False if another process holds it."""
    holder = socket.socket(socket.AF_UNIX)
    try:
        # An abstract name belongs to the network namespace, as domains and ports do, and ends with the process.
        holder.bind(f"\0icu_gantry/{name}".encode()[:_LONGEST_NAME])
    except OSError as error:
        holder.close()
        if error.errno != errno.EADDRINUSE:
            raise
        return False
    holder.detach()  # it stays open until the process ends
    return True


def is_held(name: str) -> bool:
    """Return whether a process holds a name."""
    with socket.socket(socket.AF_UNIX) as probe:
        try:
            probe.bind(f"\0icu_gantry/{name}".encode()[:_LONGEST_NAME])
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            return True
    return False


def hold_names(namespace: str) -> None:
    """Hold the names of a graph under this namespace in the ROS domain, until this process ends.

    Raises
    ------
    GraphDescriptionError
        If another process holds them.
    """
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not hold(f"{domain}/{namespace.strip('/')}"):
        raise GraphDescriptionError(
            f"a graph of these names runs already in ROS domain {domain}: end it, "
            "or take another namespace or ROS_DOMAIN_ID"
        )


def hold_another_domain(namespace: str) -> str:
    """Hold the names in the first ROS domain where no process holds them, and return that domain.

    Raises
    ------
    GraphDescriptionError
        If other processes hold the names in all of these domains.
    """
    for domain in OTHER_DOMAINS:
        if hold(f"{domain}/{namespace.strip('/')}"):
            return str(domain)
    raise GraphDescriptionError(f"graphs of these names run in ROS domains 0 to {OTHER_DOMAINS[-1]}: end one of them")
