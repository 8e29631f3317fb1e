"""Keeps a second whole graph from the same topics and services: its orders would reach the first one's machine, too."""

from __future__ import annotations

import errno
import os
import socket

from scope_bench.core.graph_description import GraphError

_LONGEST_NAME = 100
"""Bytes of a Unix socket's name, of 108."""


def hold_names(namespace: str) -> None:
    """Hold the names of a graph under this namespace in the ROS domain, until this process ends.

    Raises
    ------
    GraphError
        If another process holds them.
    """
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    holder = socket.socket(socket.AF_UNIX)
    try:
        # An abstract name: it is the network namespace's own, as the domain is, and ends with the process.
        holder.bind(f"\0icu_gantry/{domain}/{namespace.strip('/')}".encode()[:_LONGEST_NAME])
    except OSError as error:
        holder.close()
        if error.errno != errno.EADDRINUSE:
            raise
        raise GraphError(
            f"a graph of these names runs already in ROS domain {domain}: end it, "
            "or take another namespace or ROS_DOMAIN_ID"
        ) from None
    holder.detach()  # nobody closes it before the process ends
