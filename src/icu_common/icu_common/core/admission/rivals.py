"""The topics with more than one source that a program knows of, and the stop that they have caused."""

from __future__ import annotations


class RivalTopics:
    """Remembers them until a person has reset the driver's stop."""

    def __init__(self) -> None:
        self._texts: dict[str, str] = {}
        self._held_for = ""

    def take(self, topic: str, text: str) -> bool:
        """Take which programs publish a topic, empty for one alone; return whether the machine must be stopped."""
        if not text:
            self._texts.pop(topic, None)
            return False
        self._texts[topic] = self._held_for = text
        return True

    @property
    def text(self) -> str:
        """Which programs publish which topics now, empty for none."""
        return "; ".join(self._texts.values())

    def driver_is(self, state: str) -> None:
        """Forget the cause of a stop that the driver is not in any more."""
        if state != "stopped" and not self._texts:
            self._held_for = ""

    def clause(self, driver: str) -> str:
        """Return what to add to the driver's state: the cause of its stop, where it does not name that itself."""
        stopped = driver.partition(":")[0] == "stopped"
        return f"; {self._held_for}" if stopped and self._held_for and self._held_for not in driver else ""
