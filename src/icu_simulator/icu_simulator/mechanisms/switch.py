"""A switch in the stylus, closed by compression of the spring and wired to the board's probe input."""

from __future__ import annotations

from dataclasses import dataclass

from icu_common.core.configuration.config import Config, ConfigError, setting


@dataclass(frozen=True, slots=True, kw_only=True)
class SwitchConfig(Config):
    """The switch; Omron's D2F-F has at most 0.12 mm of differential travel and needs 0.74 N (datasheet)."""

    enabled: bool = setting(False, "The stylus has a switch on the probe input of the board")
    threshold_mm: float = setting(
        0.2, "Compression of the spring at which the switch acts", minimum=0.01, maximum=5.0, unit="mm"
    )
    hysteresis_mm: float = setting(
        0.1,
        "Hysteresis: relaxation of the spring below this compression at which the switch releases",
        minimum=0.0,
        maximum=5.0,
        unit="mm",
    )
    contact: str = setting(
        "normally_open",
        "Contact between probe input and ground at rest; a normally closed one needs $6=1 and shows a broken wire",
        choices=("normally_open", "normally_closed"),
    )

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        if self.hysteresis_mm >= self.threshold_mm:
            raise ConfigError(
                f"hysteresis_mm = {self.hysteresis_mm:g}: expected less than threshold_mm {self.threshold_mm:g}, "
                "or the switch would never let go"
            )


class BenchStylusSwitch:
    """Follows the spring."""

    def __init__(self, config: SwitchConfig) -> None:
        self.config = config
        self._acts = False

    def compress(self, compression_mm: float) -> None:
        """Process the compression of the spring in mm."""
        config = self.config
        limit = config.threshold_mm - (config.hysteresis_mm if self._acts else 0.0)
        self._acts = compression_mm >= limit

    @property
    def closed(self) -> bool:
        """Whether the probe input is connected to ground."""
        return self.config.enabled and self._acts == (self.config.contact == "normally_open")
