"""Who reports on /diagnostics, and who has fallen silent."""

from __future__ import annotations


class Roll:
    """Remembers every reporter that was heard once.

    Parameters
    ----------
    limit_s
        Silent for longer counts as gone; the nodes report every second.
    """

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._heard_s: dict[str, float] = {}
        self._gone: set[str] = set()

    def heard(self, name: str, now_s: float) -> bool:
        """Take a report; return whether its reporter had been gone."""
        self._heard_s[name] = now_s
        was_gone = name in self._gone
        self._gone.discard(name)
        return was_gone

    def newly_gone(self, now_s: float) -> list[str]:
        """Return who has fallen silent since the last call, in alphabetical order."""
        silent = {name for name, heard_s in self._heard_s.items() if now_s - heard_s > self._limit_s}
        fresh, self._gone = sorted(silent - self._gone), silent
        return fresh
