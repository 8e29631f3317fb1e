"""Log and record of refused requests and messages, limited so that a flood fills neither log nor disk."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

from aiohttp.http_exceptions import HttpProcessingError

from icu_common.core.configuration.text_bounds import plain

_LOG = logging.getLogger(__name__)
_PERIOD_S = 1.0
_MAX_NAMES = 256
MAX_NAME = 80
_SHOWN = 120

SUSPECT = frozenset(
    {"malformed", "oversized", "rate_limited", "old_boot", "replayed", "stale_epoch", "no_lease", "role_needed"}
)
"""Refusals that are rare for an honest page."""


class TurnedAway:
    """Writes at most one line a second for each kind and origin of refusals; the next line counts the omitted ones.

    Parameters
    ----------
    write
        Called with each record for the audit file.
    """

    def __init__(self, write: Callable[[dict[str, Any]], None]) -> None:
        self._write = write
        self._last: dict[tuple[str, str], tuple[float, int]] = {}

    def note(self, who: str, what: str, why: str) -> None:
        """Record that ``what`` from ``who`` was refused, and why; all three may contain a stranger's text."""
        who, what, why = plain(who, MAX_NAME), plain(what, MAX_NAME), plain(why)
        now_s = time.monotonic()
        key = (who, what)
        last_s, more = self._last.get(key, (-_PERIOD_S, 0))
        if now_s - last_s < _PERIOD_S:
            self._last[key] = (last_s, more + 1)
            return
        if len(self._last) >= _MAX_NAMES:
            self._last.clear()
        self._last[key] = (now_s, 0)
        _LOG.warning("%s of %s refused: %s%s", what, who, why, f" (and {more} more before)" if more else "")
        record = {"wall_s": round(time.time(), 3), "who": who, "command": what, "result": f"refused: {why}"}
        self._write(record | ({"more": more} if more else {}))

    def logger(self) -> logging.Logger:
        """Return a logger for the HTTP library that notes invalid HTTP as a refusal, not as a failure of the server."""
        made = logging.Logger("scope_ui_bridge.http")
        made.parent = _LOG
        made.addFilter(self._is_failure)
        return made

    def _is_failure(self, record: logging.LogRecord) -> bool:
        error = record.exc_info[1] if record.exc_info else None
        if not isinstance(error, HttpProcessingError):
            return True
        remote = record.args[0] if isinstance(record.args, tuple) and record.args else ""
        self.note(str(remote), "request", f"{error.code} {' '.join(error.message.split())[:_SHOWN]}")
        return False
