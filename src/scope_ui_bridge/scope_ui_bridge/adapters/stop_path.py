"""The path of a STOP out of the server: every stop takes it, and it never waits.

A stop is sent before it is recorded, and needs no connection slot, no rate and no free encoder. The server reads only
the head of requests to `/stop`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from aiohttp import web

from scope_ui_bridge.adapters.graph_port import GraphPort
from scope_ui_bridge.core.access import PageSession
from scope_ui_bridge.core.desk import Desk
from scope_ui_bridge.core.effects import Effect, Now, StopNow

_MAX_PRESS, _MAX_DIGITS = 64, 15


class StopPath:
    """Sends stops, and handles the page's request to `/stop`.

    Parameters
    ----------
    graph
        Connection to the graph.
    write_later
        Records the stop without waiting for the disk.
    answered
        Called in any thread with the log entry's number and the driver's answer.
    """

    def __init__(
        self,
        graph: GraphPort,
        write_later: Callable[[dict[str, Any]], None],
        answered: Callable[[int, bool, str], None],
    ) -> None:
        self._graph = graph
        self._write_later = write_later
        self._answered = answered

    def send(self, stop: StopNow) -> None:
        """Stop the machine by every path, then record it."""
        self._graph.stop(functools.partial(self._answered, stop.entry), stop.cause)
        self._write_later(stop.record)

    @staticmethod
    def effects_of(request: web.Request, session: PageSession, desk: Desk, now: Now) -> list[Effect]:
        """Return the effects of a signed-in browser's request to stop."""
        press, sent = request.query.get("press", "")[:_MAX_PRESS], request.query.get("sent", "")
        if sent.isascii() and sent.isdigit() and len(sent) <= _MAX_DIGITS:
            desk.stop_overtakes(request.query.get("page", ""), session.name, int(sent))
        return desk.stop(session.name, now, press=press)
