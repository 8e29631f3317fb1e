"""The way of a STOP out of the server: everything that stops goes through here, and nothing is waited for.

It goes out before it is written down, and needs no place, no rate and no free encoder. Requests of `/stop` are not read
beyond their head.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from aiohttp import web

from scope_ui_bridge.adapters.graph_port import GraphPort
from scope_ui_bridge.core.desk import Desk
from scope_ui_bridge.core.effects import Effect, Now, StopNow
from scope_ui_bridge.core.sign_in import Session

_MAX_PRESS, _MAX_DIGITS = 64, 15


class StopPath:
    """Sends stops, and takes the page's second way to one.

    Parameters
    ----------
    graph
        The way to the graph.
    write_later
        Takes the record, without waiting for the disk.
    answered
        Is called, in any thread, with the log entry's number and what the driver has answered.
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
        """Stop by every way there is, then hand the record over."""
        self._graph.stop(functools.partial(self._answered, stop.entry))
        self._write_later(stop.record)

    @staticmethod
    def effects_of(request: web.Request, session: Session, desk: Desk, now: Now) -> list[Effect]:
        """Return what a request of a signed-in browser to stop leads to."""
        press, sent = request.query.get("press", "")[:_MAX_PRESS], request.query.get("sent", "")
        if sent.isascii() and sent.isdigit() and len(sent) <= _MAX_DIGITS:
            desk.stop_overtakes(request.query.get("page", ""), session.name, int(sent))
        return desk.stop(session.name, now, press=press)
