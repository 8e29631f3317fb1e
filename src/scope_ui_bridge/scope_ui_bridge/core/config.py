"""Parameters of the bridge node; the keys of config/params/ui_bridge.yaml are these fields."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass

from icu_common.core.configuration.config import WALL_TIME, Config, ConfigError, setting


@dataclass(frozen=True, slots=True, kw_only=True)
class BridgeConfig(Config):
    """Address and sign-in of the page, its files, limits of age, and timeouts."""

    host: str = setting("127.0.0.1", "Address to serve on; any other than loopback needs TLS", read_only=True)
    port: int = setting(8080, "TCP port, 0 = any free port", minimum=0, maximum=65535, read_only=True)
    tls_certificate: str = setting("", "PEM file with the certificate chain, empty = no TLS", read_only=True)
    tls_key: str = setting("", "PEM file with the certificate's private key", read_only=True)
    extra_origins: str = setting(
        "", "Further origins that may connect to the bridge, separated by spaces (https://name:port)", read_only=True
    )
    token_file: str = setting(
        "~/.ros/ui_token", "File (mode 0600) that holds the unused sign-in token, empty = no file", read_only=True
    )
    token_role: str = setting(
        "operator", "Role of a user who signs in by a token", choices=("viewer", "operator", "engineer"), read_only=True
    )
    passwords_file: str = setting(
        "", "File of names, roles and hashed passwords, written by page_admin password; empty = no file", read_only=True
    )
    session_lifetime_s: float = setting(
        43200.0,
        "Duration of a sign-in",
        minimum=60.0,
        maximum=604800.0,
        unit="s",
        clock=WALL_TIME,
        read_only=True,
    )
    sign_in_warning_s: float = setting(
        600.0,
        "Time before the end of the sign-in from which on the page shows a warning and accepts a new sign-in",
        minimum=0.0,
        maximum=86400.0,
        unit="s",
        clock=WALL_TIME,
    )
    audit_file: str = setting("", "File of hash-chained command records, empty = no file", read_only=True)
    audit_max_mb: float = setting(
        16.0,
        "Size at which the audit file is renamed with a number and a new file continues; no file is deleted",
        minimum=0.01,
        maximum=10_000.0,
        unit="MB",
        read_only=True,
    )
    layout: str = setting(
        "",
        "Layout file of the panel, for the labels of the controls; empty = labels made from their names",
        read_only=True,
    )
    max_viewers: int = setting(
        24, "Maximum number of pages served at the same time", minimum=1, maximum=200, read_only=True
    )
    replay: bool = setting(
        False, "Show a recorded session: no page gets control and the bridge sends nothing", read_only=True
    )
    record_folder: str = setting(
        "", "Folder for recorded sessions, each in a subfolder; empty = no recording", read_only=True
    )
    sequence_folder: str = setting(
        "", "Folder of sequence files (YAML) that pages offer, empty = no folder", read_only=True
    )
    jpeg_quality: int = setting(80, "JPEG quality of the live image", minimum=20, maximum=100)
    frame_amber_s: float = setting(
        0.25, "Age from which on the page marks an image as late", minimum=0.05, maximum=10.0, unit="s"
    )
    frame_max_age_s: float = setting(
        0.5,
        "Maximum age of the image for a selection or an actuation",
        minimum=0.05,
        maximum=5.0,
        unit="s",
        guards="a person acts on an old image",
    )
    frame_stale_s: float = setting(
        1.0, "Age from which on the page greys an image out", minimum=0.1, maximum=10.0, unit="s"
    )
    min_confidence: float = setting(
        0.5,
        "Minimum confidence of the recognition for an actuation",
        minimum=0.0,
        maximum=1.0,
        guards="a panel recognised with low confidence may be another panel or at another position",
    )
    recognition_max_age_s: float = setting(
        2.0,
        "Silence of the recognition after which actuation is refused and the panel's state is hidden",
        minimum=0.1,
        maximum=10.0,
        unit="s",
        guards="the panel may have moved since it was recognised",
    )
    panel_moved_limit_m: float = setting(
        0.002,
        "Movement of the panel beyond which a selection is void",
        minimum=0.0001,
        maximum=0.02,
        unit="m",
        guards="a selection may mean another position than the one seen",
    )
    keepalive_fresh_s: float = setting(
        0.4,
        "Maximum age of the page's keep-alive for the bridge to publish the heartbeat",
        minimum=0.1,
        maximum=1.0,
        unit="s",
        clock=WALL_TIME,
        guards="the driver stops too late after the operator has left",
    )
    silence_stop_s: float = setting(
        0.6,
        "Silence of the operator's page after which the bridge stops a motion",
        minimum=0.1,
        maximum=2.0,
        unit="s",
        clock=WALL_TIME,
        guards="the machine keeps moving although its page cannot stop it",
    )
    picture_stop_s: float = setting(
        0.6,
        "Time without a new image after which the bridge stops a motion",
        minimum=0.1,
        maximum=2.0,
        unit="s",
        guards="the machine moves unseen",
    )
    jog_hold_s: float = setting(
        0.3,
        "Time without a request from the page after which a jog ends",
        minimum=0.1,
        maximum=1.0,
        unit="s",
        clock=WALL_TIME,
        guards="the machine keeps moving after the arrow has been released",
    )
    jog_step_max_m: float = setting(
        0.01,
        "Maximum length of a jog step: the distance still travelled after release",
        minimum=0.0001,
        maximum=0.05,
        unit="m",
        guards="the machine moves this far after the arrow has been released",
    )
    lease_timeout_s: float = setting(
        5.0,
        "Silence after which an operator loses control",
        minimum=1.0,
        maximum=30.0,
        unit="s",
        clock=WALL_TIME,
        guards="no other person can take control meanwhile",
    )
    answer_timeout_s: float = setting(
        3.0, "Time without an answer after which a command has failed", minimum=0.2, maximum=120.0, unit="s"
    )

    def __post_init__(self) -> None:
        # Slotted dataclasses are new classes, so super() without arguments would look for the wrong one.
        Config.__post_init__(self)
        if self.keepalive_fresh_s > self.silence_stop_s:
            raise ConfigError(
                f"keepalive_fresh_s = {self.keepalive_fresh_s} is above silence_stop_s = {self.silence_stop_s}"
            )
        if bool(self.tls_certificate) != bool(self.tls_key):
            raise ConfigError("tls_certificate and tls_key belong together: one of them is empty")
        if not self.tls and not is_loopback(self.host):
            raise ConfigError(
                f"host = {self.host!r} is not loopback: set tls_certificate and tls_key, or serve on 127.0.0.1"
            )
        for origin in self.extra_origins.split():
            if not origin.startswith("https://" if self.tls else ("http://", "https://")) or origin.count("/") != 2:
                raise ConfigError(f"extra_origins: {origin!r} is not scheme://name:port of the right scheme")

    @property
    def tls(self) -> bool:
        """Whether the page is served with TLS."""
        return bool(self.tls_certificate)

    def origins(self, port: int) -> frozenset[str]:
        """Return the exact origins that may open WebSockets and post, for the port in use."""
        scheme, default_port = ("https", 443) if self.tls else ("http", 80)
        names = {"127.0.0.1", "localhost"} if is_loopback(self.host) else {self.host}
        names |= {f"[{self.host}]"} if ":" in self.host else set()
        suffix = "" if port == default_port else f":{port}"
        return frozenset({f"{scheme}://{name}{suffix}" for name in names} | set(self.extra_origins.split()))

    def url(self, port: int) -> str:
        """Return the page's address as shown to people."""
        scheme = "https" if self.tls else "http"
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{scheme}://{host}:{port}/"


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach ``host``."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
