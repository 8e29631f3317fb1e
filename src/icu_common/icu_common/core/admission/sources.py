"""Programs that publish a topic with only one allowed source; pure, no clock.

A killed program stays in the graph until its lease ends (10 s by the graph's profile). Its successor has the same name
and another process, so both are in the graph for a while. A source whose process has ended does not count, so they are
one program. A process on another host is not visible; there, sources of one name count as one until the lease must
have ended.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass

from icu_common.core.reasons.message import Message

LEASE_S = 25.0
"""Maximum seconds for which an ended program stays in the graph: Fast DDS's default lease is 20 s."""
NAMED_WITHIN_S = 0.3
"""Maximum seconds until the name of a new source is known; measured: up to 0.12 s."""
UNNAMED = Message("sources.program_without_name")
_NUMBERS = {2: "two", 3: "three", 4: "four"}


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class Source:
    """A node that publishes a topic, by its full name (empty: not known yet), and its process."""

    name: str
    process: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """The living sources of a topic.

    Attributes
    ----------
    names
        Full names of their nodes, ``UNNAMED`` for an unknown name.
    unnamed
        Whether the name of a source is about to become known.
    undecided
        Whether a repeated query may soon give another result.
    """

    names: tuple[str, ...] = ()
    unnamed: bool = False
    undecided: bool = False


class TopicSources:
    """The sources of one topic.

    Parameters
    ----------
    is_alive
        Returns whether a process exists; None if that cannot be known, for example on another host.
    """

    def __init__(self, is_alive: Callable[[bytes], bool | None]) -> None:
        self._is_alive = is_alive
        self._since_s: dict[bytes, float] = {}
        self._ended_s: dict[bytes, float] = {}
        """Time at which each process was first found to have ended."""

    def judge(self, sources: Iterable[Source], now_s: float) -> Found:
        """Return the living sources among those of the graph."""
        sources = sorted(set(sources))
        self._since_s = {s.process: self._since_s.get(s.process, now_s) for s in sources}
        if len(sources) < 2:
            unnamed = any(not source.name for source in sources)
            return Found(names=tuple(s.name or UNNAMED for s in sources), unnamed=unnamed, undecided=unnamed)
        alive = {s.process: self._is_alive(s.process) for s in sources}
        self._ended_s = {p: self._ended_s.get(p, now_s) for p, lives in alive.items() if lives is False}
        living: list[Source] = []
        undecided = unnamed = False
        for source in sources:
            age_s = now_s - self._since_s[source.process]
            # A source that stays in the graph renews its lease, so its process runs where it cannot be seen, for
            # example in a container.
            ended = now_s - self._ended_s.get(source.process, -math.inf) <= LEASE_S
            successor = alive[source.process] is None and self._is_successor(source, sources, now_s)
            if ended or successor:
                undecided = True
                continue
            living.append(source)
            unnamed |= not source.name and age_s <= NAMED_WITHIN_S
        names = tuple(source.name or UNNAMED for source in living)
        return Found(names=names, unnamed=unnamed, undecided=undecided or unnamed)

    def _is_successor(self, source: Source, sources: Iterable[Source], now_s: float) -> bool:
        """Return whether this source may be the successor of an older one of the same name that may have ended."""
        order = self._since_s[source.process], source.process
        earlier = ((self._since_s[s.process], s.process) < order for s in sources if s.name == source.name)
        return any(earlier) and now_s - order[0] <= LEASE_S


def rivals_text(topic: str, names: Collection[str]) -> str:
    """Return ``two programs publish panel/pose: /a and /b``, empty for fewer than two."""
    if len(names) < 2:
        return ""
    counted = [
        Message("sources.times", name=name, count=count) if count > 1 else name
        for name, count in sorted(Counter(names).items())
    ]
    listed = " and ".join(filter(None, (", ".join(counted[:-1]), counted[-1])))
    count = _NUMBERS.get(len(names), str(len(names)))
    return Message("sources.programs_publish", count=count, topic=topic.lstrip("/"), listed=listed)


def distrust_text(names: Collection[str], allowed: str) -> str:
    """Return why a message with these possible sources may come from a program that is not allowed, empty if it cannot.

    Parameters
    ----------
    names
        Full names of the topic's sources.
    allowed
        Names of nodes without namespace, separated by spaces; ``*`` for any.
    """
    if allowed.strip() == "*":
        return ""
    strangers = [name for name in names if base_name(name) not in allowed.split()]
    if names and not strangers:
        return ""
    found = " and ".join(strangers) or Message("sources.no_known_program")
    return Message("sources.trajectory_programs_allows", found=found, allowed=allowed or Message("sources.no_program"))


def base_name(name: str) -> str:
    """Return a node's name without its namespace."""
    return name.rpartition("/")[2]
