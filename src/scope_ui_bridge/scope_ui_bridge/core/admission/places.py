"""Slots for connections: a total, a maximum for each user, and some reserved for present and former operators."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar

from scope_ui_bridge.core.wire import Refusal

OWN_PLACES = 8
"""Maximum number of connections of one kind for one user; a new one beyond it ends the user's oldest."""
KEPT_PLACES = 4
"""Reserved slots of each kind of connection, for users who have or have had control."""


Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True, slots=True)
class _Place:
    name: str
    kind: str


class Places(Generic[Key]):
    """The slots and their owners.

    Parameters
    ----------
    total
        Number of slots for all kinds together, without the reserved ones.
    """

    def __init__(self, total: int) -> None:
        self._total = total
        self._taken: dict[Key, _Place] = {}

    def owners(self) -> list[Key]:
        """Return the owners of all slots."""
        return list(self._taken)

    def take(self, key: Key, name: str, kind: str, *, kept: bool, spared: Key | None = None) -> Key | None:
        """Give ``key`` a slot; return the owner of the same user's slot that it replaces, or None.

        Parameters
        ----------
        key
            Owner of the slot.
        name, kind
            User, and kind of connection.
        kept
            Whether the user has or has had control.
        spared
            Owner whose slot is never replaced: the page in control.

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
        """Free a slot."""
        self._taken.pop(key, None)
