"""Properties of the board that do not depend on its settings: line, times and dialect."""

from __future__ import annotations

from dataclasses import dataclass

RX_BYTES = {"GRBL": 128, "grblHAL": 1024, "FluidNC": 256}
"""Sizes of the dialects' receive buffers in bytes; FluidNC does not report its size."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardOptions:
    """Properties that do not depend on the settings."""

    baud: int = 115200
    """Baud rate of the line; 0: bytes take no time."""
    latency_s: float = 0.0
    """Additional delay in seconds of bytes to the host, such as that of a USB adapter's timer."""
    line_s: float = 0.0005
    """Seconds that the firmware needs for a line."""
    boot_s: float = 0.1
    """Seconds from power-up to the banner; bytes that arrive in this time are lost."""
    mist: bool = False
    """Whether the firmware is built with M7."""
    dialect: str = "GRBL"
    """One of :data:`RX_BYTES`. Of the other dialects the mock has only the banner, build information, buffer, and
    reported settings. It also has the effects of reset, homing and alarm on offsets and tools (grblHAL's gcode.c,
    motion_control.c; FluidNC's Protocol.cpp)."""

    @property
    def rx_bytes(self) -> int:
        return RX_BYTES[self.dialect]
