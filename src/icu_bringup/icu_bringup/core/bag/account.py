"""Account of the missing messages of a playback or a recording, by topic and reason."""

from __future__ import annotations

from collections.abc import Collection

INCOMPLETE = 3
"""Exit code of a program that ran to its end with missing messages."""


class Account:
    """Counts missing messages.

    Parameters
    ----------
    allowed
        Topics whose messages may be missing: the account lists them and stays complete.

    Attributes
    ----------
    missing
        Numbers of missing messages and of all messages (None: unknown), by topic and reason.
    """

    def __init__(self, allowed: Collection[str] = ()) -> None:
        self._allowed = frozenset(allowed)
        self.missing: dict[tuple[str, str], tuple[int, int | None]] = {}

    def miss(self, topic: str, reason: str, count: int = 1, of: int | None = None) -> None:
        """Add missing messages of a topic; ``of`` is the number of all its messages, None if unknown."""
        before, _ = self.missing.get((topic, reason), (0, None))
        self.missing[topic, reason] = before + count, of

    @property
    def complete(self) -> bool:
        """Whether no message is missing, apart from the allowed topics."""
        return all(topic in self._allowed for topic, _ in self.missing)

    @property
    def count(self) -> int:
        """Number of missing messages of all topics."""
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
