"""Contents of gantry_monitor: positions, states, counts and throughput, from values with their times; no ROS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

COUNTS = ("sent", "acknowledged", "executed", "refused", "lost")
STALE_S = 1.0


@dataclass(slots=True)
class Monitor:
    """Keeps the newest of each value; times are seconds of one clock."""

    state: str = "?"
    _reading_m: tuple[float, ...] = ()
    _reading_at: float = 0.0
    _values: dict[str, str] = field(default_factory=dict)
    _values_at: float = 0.0
    _bytes_s: float | None = None

    def reading(self, positions_m: Sequence[float], now: float) -> None:
        """Take the readings of x, y and stylus in metres."""
        self._reading_m, self._reading_at = tuple(positions_m), now

    def diagnostics(self, values: Mapping[str, str], now: float) -> None:
        """Take the driver's counts; two of them give the throughput, unless the driver restarted between them."""
        before, passed = self._values.get("bytes_sent"), now - self._values_at
        sent = values.get("bytes_sent", "")
        self._bytes_s = None
        if before is not None and sent.isdecimal() and passed > 0 and int(sent) >= int(before):
            self._bytes_s = (int(sent) - int(before)) / passed
        if sent.isdecimal():
            self._values, self._values_at = dict(values), now

    def line(self, now: float) -> str:
        """Return the line to show at ``now``; old values are marked as old."""
        if self._reading_m:
            place = "  ".join(
                f"{axis} {1e3 * value:8.3f}" for axis, value in zip(("x", "y", "stylus"), self._reading_m)
            )
            age = now - self._reading_at
            place += " mm" if age <= STALE_S else f" mm ({age:.0f} s old)"
        else:
            place = "no position"
        if not self._values:
            return f"{self.state}  |  {place}  |  no diagnostics"
        counts = "  ".join(f"{name} {self._values.get(name, '?')}" for name in COUNTS)
        rate = "- B/s" if self._bytes_s is None else f"{self._bytes_s:.0f} B/s"
        latency = self._values.get("answer_latency_ms", "?")
        age = now - self._values_at
        old = "" if age <= 3.0 * STALE_S else f" ({age:.0f} s old)"
        return f"{self.state}  |  {place}  |  {counts}{old}  |  {rate}, answer in {latency} ms"
