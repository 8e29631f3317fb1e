"""Topics with more than one source, and the stop that they have caused."""

from __future__ import annotations

from icu_common.core.reasons.message import joined, parts
from icu_common.core.reasons.state_text import state_name


class RivalTopics:
    """Remembers the topics until a person has reset the driver's stop."""

    def __init__(self) -> None:
        self._texts: dict[str, str] = {}
        self._held_for = ""

    def take(self, topic: str, text: str) -> bool:
        """Record the programs that publish a topic (empty: only one); return whether the machine must be stopped."""
        if not text:
            self._texts.pop(topic, None)
            return False
        self._texts[topic] = self._held_for = text
        return True

    @property
    def text(self) -> str:
        """Programs and topics of all present conflicts, empty for none."""
        return joined(self._texts.values())

    def besides(self, reason: str) -> str:
        """Return the present conflicts other than the one that is the reason, joined by ``; ``; empty for none."""
        return joined(conflict for conflict in self._texts.values() if conflict != reason)

    def driver_is(self, state: str) -> None:
        """Forget the cause of the stop once the driver has left it."""
        if state != "stopped" and not self._texts:
            self._held_for = ""

    def clause(self, driver: str) -> str:
        """Return the cause of a stop as a clause for the driver's state, empty if the state names it already."""
        told = any(part == self._held_for for part in parts(driver))
        return self._held_for if state_name(driver) == "stopped" and not told else ""
