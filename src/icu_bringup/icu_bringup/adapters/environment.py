"""Checks of this computer before bring-up starts programs: the page's port and the disk space."""

from __future__ import annotations

import contextlib
import errno
import shutil
import socket
from pathlib import Path

from icu_bringup.adapters.graph_names import hold
from icu_bringup.core.startup.graph_description import GraphDescriptionError

NEEDED_BYTES = 64 * 1024 * 1024
"""Free space for the log, the audit file and a calibration; recordings check for themselves."""
_OTHER_PORTS = 50


def check_space(folder: Path) -> None:
    """Raise an error if the disk of a folder is full.

    Raises
    ------
    GraphDescriptionError
        With the folder, the free space and the option that names another folder.
    """
    free = shutil.disk_usage(folder).free
    if free < NEEDED_BYTES:
        raise GraphDescriptionError(
            f"the disk of {folder} is full: {free >> 20} MB are free; expected {NEEDED_BYTES >> 20} MB; "
            "delete files there, or choose another folder: --state FOLDER"
        )


def is_free(host: str, port: int) -> bool:
    """Return whether a server could listen there now."""
    with contextlib.closing(socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET)) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the page's server does
        try:
            probe.bind((host, port))
            probe.listen(1)
        except OSError as error:
            # Other errors, as for a host that this computer does not have, are reported by the page's server.
            return error.errno != errno.EADDRINUSE
    return True


def free_port(host: str, port: int, *, may_choose: bool) -> int:
    """Return the port, or the next free one, and reserve it against other bring-ups until this process ends.

    Raises
    ------
    GraphDescriptionError
        If it is in use and no other may be chosen, with the option that sets another one.
    """
    candidates = range(port, min(port + _OTHER_PORTS, 65536) if may_choose else port + 1)
    for candidate in candidates:
        if is_free(host, candidate) and hold(f"page/{candidate}"):
            return candidate
    other = next((p for p in range(port + 1, min(port + _OTHER_PORTS, 65536)) if is_free(host, p)), port + 1)
    raise GraphDescriptionError(
        f"the page's port {port} is in use by another program; choose another one: --set ui_bridge.port={other}"
    )
