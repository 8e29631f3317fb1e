"""Places for connections: so many in all, so many for one user, and some that are kept for those who had control."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar

from scope_ui_bridge.core.refusal import Refusal

OWN_PLACES = 8
"""Connections of one kind that one user may have: when another one comes, the oldest of that user goes."""
KEPT_PLACES = 4
"""Places, for pages and for each kind of connection, that only those get who have or had control."""


Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True, slots=True)
class _Place:
    name: str
    kind: str


class Places(Generic[Key]):
    """Who has a place.

    Parameters
    ----------
    total
        How many there are of all kinds together, besides the kept ones.
    """

    def __init__(self, total: int) -> None:
        self._total = total
        self._taken: dict[Key, _Place] = {}

    def owners(self) -> list[Key]:
        """Return who has a place."""
        return list(self._taken)

    def take(self, key: Key, name: str, kind: str, *, kept: bool, spared: Key | None = None) -> Key | None:
        """Give ``key`` a place; return whose place of the same user has to be given up for it, or None.

        Parameters
        ----------
        key
            Names the place.
        name, kind
            The user, and the kind of connection.
        kept
            Whether the user has or had control.
        spared
            The place of the page in control, which is never given up.

        Raises
        ------
        Refusal
            ``too_many_viewers``.
        """
        own = [other for other, place in self._taken.items() if (place.name, place.kind) == (name, kind)]
        gone = None
        if len(own) >= OWN_PLACES:
            gone = next(other for other in own if other != spared)
            del self._taken[gone]
        elif len(self._taken) >= self._total + (2 * KEPT_PLACES if kept else 0):
            raise Refusal("too_many_viewers", limit=self._total // 2)
        self._taken[key] = _Place(name, kind)
        return gone

    def leave(self, key: Key) -> None:
        """Give a place up."""
        self._taken.pop(key, None)
