"""Time of a recording during playback: faster or slower than the wall clock, with pauses."""

from __future__ import annotations


class PlayClock:
    """Bag time as a function of a monotonic time.

    Parameters
    ----------
    start_ns
        Bag time at the beginning.
    rate
        Seconds of bag time per second of wall time.
    now_s
        Monotonic time at the beginning.
    paused
        Begin with a pause.
    """

    def __init__(self, start_ns: int, rate: float, now_s: float, *, paused: bool = False) -> None:
        if not 0.001 <= rate <= 1000.0:
            raise ValueError(f"rate = {rate}: 0.001 to 1000 is possible")
        self._bag_ns, self._rate, self._since_s, self.paused = start_ns, rate, now_s, paused

    def bag_ns(self, now_s: float) -> int:
        """Return the bag's time."""
        return self._bag_ns if self.paused else self._bag_ns + round((now_s - self._since_s) * self._rate * 1e9)

    def wall_s_until(self, bag_ns: int, now_s: float) -> float:
        """Return the wall seconds until ``bag_ns`` is due; infinite during a pause."""
        return float("inf") if self.paused else (bag_ns - self.bag_ns(now_s)) / 1e9 / self._rate

    def toggle(self, now_s: float) -> bool:
        """Pause or continue; return whether playback is now paused."""
        self._bag_ns, self._since_s = self.bag_ns(now_s), now_s
        self.paused = not self.paused
        return self.paused


def progress_bar(fraction: float, width: int = 30) -> str:
    """Return a bar of ``width`` characters that is filled by ``fraction``."""
    filled = round(min(max(fraction, 0.0), 1.0) * width)
    return "[" + "#" * filled + "." * (width - filled) + "]"
