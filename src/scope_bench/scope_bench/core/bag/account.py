"""Account of a playback or a recording: which messages are missing, by topic and reason."""

from __future__ import annotations

from collections.abc import Collection

INCOMPLETE = 3
"""Exit code of a program that ran to its end while messages are missing."""


class Account:
    """Counts missing messages.

    Parameters
    ----------
    allowed
        Topics whose messages may be missing: they are listed, and the account stays complete.

    Attributes
    ----------
    missing
        Number of missing messages, and of all that there were (None: not known), by topic and reason.
    """

    def __init__(self, allowed: Collection[str] = ()) -> None:
        self._allowed = frozenset(allowed)
        self.missing: dict[tuple[str, str], tuple[int, int | None]] = {}

    def miss(self, topic: str, reason: str, count: int = 1, of: int | None = None) -> None:
        """Add missing messages of a topic; ``of`` is the number that there were, None if it is not known."""
        before, _ = self.missing.get((topic, reason), (0, None))
        self.missing[topic, reason] = before + count, of

    @property
    def complete(self) -> bool:
        """Whether no message is missing, apart from the allowed topics."""
        return all(topic in self._allowed for topic, _ in self.missing)

    @property
    def count(self) -> int:
        """Missing messages of all topics."""
        return sum(count for count, _ in self.missing.values())

    def lines(self) -> list[str]:
        """Return a line for each topic and reason."""
        return [
            f"missing: {topic}: {_counted(count, of)}: {reason}{' (allowed)' if topic in self._allowed else ''}"
            for (topic, reason), (count, of) in sorted(self.missing.items())
        ]


def _counted(count: int, of: int | None) -> str:
    if of is not None:
        return f"{count} of {of} messages"
    return f"{count} message{'' if count == 1 else 's'}" if count else "all messages"
