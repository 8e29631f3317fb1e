"""Settings of the comparison between both cameras."""

from __future__ import annotations

from dataclasses import dataclass

from icu_common.core.configuration.config import Config, setting


@dataclass(frozen=True, slots=True, kw_only=True)
class PairConfig(Config):
    """Settings that decide when a rotation of the right camera counts, is corrected, or forbids motion."""

    period_s: float = setting(
        1.0, "Interval between measurements; 0: the cameras are not compared", minimum=0.0, maximum=60.0, unit="s"
    )
    max_turn_deg: float = setting(
        0.1, "Maximum rotation of the right camera that is corrected", minimum=0.001, maximum=2.0, unit="deg"
    )
    max_sigma_px: float = setting(
        0.1,
        "Maximum standard deviation of pitch and yaw; above it a measurement is dropped",
        minimum=0.01,
        maximum=5.0,
        unit="px",
    )
    jump_px: float = setting(
        0.08, "Size of a change of pitch or yaw that must repeat before it counts", minimum=0.01, maximum=5.0, unit="px"
    )
    frames: int = setting(2, "Number of successive measurements that must agree", minimum=1, maximum=20)
    window: int = setting(8, "Number of agreeing measurements that are averaged", minimum=1, maximum=100)
    significant_sigmas: float = setting(
        3.0, "Size, in standard deviations, from which a rotation is reported", minimum=1.0, maximum=100.0
    )
