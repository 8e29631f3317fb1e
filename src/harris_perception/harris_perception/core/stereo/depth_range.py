"""Limits of depth, common to sparse stereo, dense stereo and the stylus tracker."""

from __future__ import annotations

from dataclasses import dataclass

from icu_common.core.configuration.config import Config, ConfigError, setting


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthRange(Config):
    """Limits of depth; a subclass with a narrower purpose declares them again."""

    min_depth_m: float = setting(0.2, "Minimum depth of any point", minimum=0.01, maximum=100.0, unit="m")
    max_depth_m: float = setting(1.5, "Maximum depth of any point", minimum=0.02, maximum=1000.0, unit="m")

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        if self.max_depth_m <= self.min_depth_m:
            raise ConfigError(f"max_depth_m = {self.max_depth_m} is not above min_depth_m = {self.min_depth_m}")
