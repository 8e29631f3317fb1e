"""What can be set on the bridge; the keys of config/params/ui_bridge.yaml are these fields."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass

from icu_common.core.config import WALL_TIME, Config, ConfigError, setting


@dataclass(frozen=True, slots=True, kw_only=True)
class BridgeConfig(Config):
    """Where the page is served, what it may do, and how old things may be."""

    host: str = setting("127.0.0.1", "Address to serve on; other than loopback needs TLS", read_only=True)
    port: int = setting(8080, "TCP port, 0 = any free one", minimum=0, maximum=65535, read_only=True)
    tls_certificate: str = setting("", "PEM file with the certificate chain, empty = no TLS", read_only=True)
    tls_key: str = setting("", "PEM file with the certificate's private key", read_only=True)
    extra_origins: str = setting(
        "", "Further origins that may talk to the bridge, separated by spaces (https://name:port)", read_only=True
    )
    token_file: str = setting(
        "~/.ros/ui_token", "File (mode 0600) that holds the unused sign-in token, empty = no file", read_only=True
    )
    token_role: str = setting(
        "operator", "What who signs in by a token may do", choices=("viewer", "operator", "engineer"), read_only=True
    )
    passwords_file: str = setting(
        "", "File of names, roles and hashed passwords (page_admin password), empty = none", read_only=True
    )
    session_lifetime_s: float = setting(
        43200.0,
        "A sign-in ends after this time",
        minimum=60.0,
        maximum=604800.0,
        unit="s",
        clock=WALL_TIME,
        read_only=True,
    )
    sign_in_warning_s: float = setting(
        600.0,
        "So long before its sign-in ends a page says so, and takes another one",
        minimum=0.0,
        maximum=86400.0,
        unit="s",
        clock=WALL_TIME,
    )
    audit_file: str = setting("", "File of hash-chained command records, empty = none", read_only=True)
    audit_max_mb: float = setting(
        16.0,
        "An audit file of this size is put aside with a number, and a new one goes on; none is deleted",
        minimum=0.01,
        maximum=10_000.0,
        unit="MB",
        read_only=True,
    )
    layout: str = setting(
        "", "Layout file of the panel, for the controls' labels, empty = labels made from their names", read_only=True
    )
    max_viewers: int = setting(24, "Pages served at the same time", minimum=1, maximum=200, read_only=True)
    replay: bool = setting(
        False, "A recorded session is shown: nobody gets control and nothing is sent", read_only=True
    )
    record_folder: str = setting(
        "", "Folder for recorded sessions, each in a folder of its own, empty = none", read_only=True
    )
    sequence_folder: str = setting(
        "", "Folder of sequence files (YAML) that pages can choose from, empty = none", read_only=True
    )
    jpeg_quality: int = setting(80, "Quality of the live picture", minimum=20, maximum=100)
    frame_amber_s: float = setting(
        0.25, "A picture older than this is shown as late", minimum=0.05, maximum=10.0, unit="s"
    )
    frame_max_age_s: float = setting(
        0.5,
        "No selection and no actuation on a picture older than this",
        minimum=0.05,
        maximum=5.0,
        unit="s",
        guards="a person acts on an old picture",
    )
    frame_stale_s: float = setting(1.0, "A picture older than this is greyed out", minimum=0.1, maximum=10.0, unit="s")
    min_confidence: float = setting(
        0.5,
        "No actuation below this confidence of the recognition",
        minimum=0.0,
        maximum=1.0,
        guards="a panel that is hardly recognised may be another one or elsewhere",
    )
    recognition_max_age_s: float = setting(
        2.0,
        "No actuation, and nothing shown as seen of the panel, when the recognition has been silent for this time",
        minimum=0.1,
        maximum=10.0,
        unit="s",
        guards="the panel may have moved since it was recognised",
    )
    panel_moved_limit_m: float = setting(
        0.002,
        "A selection is void when the panel has moved by more than this",
        minimum=0.0001,
        maximum=0.02,
        unit="m",
        guards="a selection may mean another position than the one seen",
    )
    keepalive_fresh_s: float = setting(
        0.4,
        "The heartbeat is published while the page's keep-alive is younger than this",
        minimum=0.1,
        maximum=1.0,
        unit="s",
        clock=WALL_TIME,
        guards="the driver stops late after the operator has left",
    )
    silence_stop_s: float = setting(
        0.6,
        "Something moves and the operator's page was silent for this time: stop",
        minimum=0.1,
        maximum=2.0,
        unit="s",
        clock=WALL_TIME,
        guards="the machine moves on although its page cannot stop it",
    )
    picture_stop_s: float = setting(
        0.6,
        "Something moves and no picture came for this time: stop",
        minimum=0.1,
        maximum=2.0,
        unit="s",
        guards="the machine moves unseen",
    )
    jog_hold_s: float = setting(
        0.3,
        "Moving on while held ends when the page has not asked again for this time",
        minimum=0.1,
        maximum=1.0,
        unit="s",
        clock=WALL_TIME,
        guards="the machine moves on after the arrow has been let go",
    )
    jog_step_max_m: float = setting(
        0.01,
        "Longest step of moving on while held: how far it still goes when let go",
        minimum=0.0001,
        maximum=0.05,
        unit="m",
        guards="the machine moves this far after the arrow has been let go",
    )
    lease_timeout_s: float = setting(
        5.0,
        "A silent operator loses control after this time",
        minimum=1.0,
        maximum=30.0,
        unit="s",
        clock=WALL_TIME,
        guards="no other person can take control meanwhile",
    )
    answer_timeout_s: float = setting(
        3.0, "A command without an answer for this time has failed", minimum=0.2, maximum=120.0, unit="s"
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
        """Return the page's address for people."""
        scheme = "https" if self.tls else "http"
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{scheme}://{host}:{port}/"


def is_loopback(host: str) -> bool:
    """Tell whether only this machine can reach ``host``."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
