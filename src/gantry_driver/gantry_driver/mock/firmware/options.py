"""What does not depend on the settings: the board's line, times and dialect."""

from __future__ import annotations

from dataclasses import dataclass

RX_BYTES = {"GRBL": 128, "grblHAL": 1024, "FluidNC": 256}
"""Receive buffers of the dialects; FluidNC does not tell its size."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardOptions:
    """What does not depend on the settings."""

    baud: int = 115200
    """0 = bytes take no time."""
    latency_s: float = 0.0
    """What the host receives is this much later than the line alone makes it, as behind a USB adapter's timer."""
    line_s: float = 0.0005
    """Seconds that the firmware needs for a line."""
    boot_s: float = 0.1
    """From power-up to the banner; bytes that arrive meanwhile are lost."""
    mist: bool = False
    """Built with M7."""
    dialect: str = "GRBL"
    """One of :data:`RX_BYTES`; of the others only banner, build information, buffer, what is told of settings, and what
    reset, homing and alarm do to offsets and tools (grblHAL's gcode.c, motion_control.c; FluidNC's Protocol.cpp)."""

    @property
    def rx_bytes(self) -> int:
        return RX_BYTES[self.dialect]
