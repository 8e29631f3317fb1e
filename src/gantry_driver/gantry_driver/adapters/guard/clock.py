"""The guard's clock: the steady one, or the simulated time that the node passes on."""

from __future__ import annotations

from icu_common.adapters.real_time import steady_s


class GuardClock:
    """Goes by the node's time while a node says that it has another than the steady one.

    Without a node it goes on by the steady clock from the last time that it was told: a stop must come to its end.
    It never goes back, and a successor of the node finds it where it is.
    """

    def __init__(self) -> None:
        self._told_s: float | None = None
        self._offset_s: float | None = None
        self._since_s = 0.0
        self._alone = False

    def __call__(self) -> float:
        """Return the time in seconds; 0 while a simulation's is not known yet."""
        if self._told_s is None:
            return steady_s()
        return self._told_s + (steady_s() - self._since_s if self._alone else 0.0)

    def begin(self, now_s: float | None) -> None:
        """Take a node's time: None where it is the steady one, 0 where it is not known yet."""
        before_s = 0.0 if self._told_s is None else self()
        self._alone, self._offset_s = False, None
        self._told_s = None if now_s is None else before_s
        self.tell(now_s or 0.0)

    def tell(self, now_s: float) -> None:
        """Take the node's new time."""
        if self._told_s is None or not now_s:
            return
        if self._offset_s is None:
            self._offset_s = max(0.0, self._told_s - now_s)
        self._told_s = max(self._told_s, now_s + self._offset_s)

    def leave(self) -> None:
        """Go on without a node."""
        self._alone, self._since_s = self._told_s is not None, steady_s()
