"""The configuration's bounds, and the origins that follow from it."""

from __future__ import annotations

import pytest

from icu_common.core.configuration.config import ConfigError
from scope_ui_bridge.core.config import BridgeConfig


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.5", "::", "bridge.example"])
def test_other_addresses_than_loopback_need_tls(host: str) -> None:
    with pytest.raises(ConfigError, match="not loopback"):
        BridgeConfig(host=host)
    assert BridgeConfig(host=host, tls_certificate="a.pem", tls_key="b.pem").tls


def test_half_a_certificate_bad_origins_and_bad_times_are_refused() -> None:
    with pytest.raises(ConfigError, match="belong together"):
        BridgeConfig(tls_certificate="a.pem")
    with pytest.raises(ConfigError, match="ftp://x"):
        BridgeConfig(extra_origins="ftp://x")
    with pytest.raises(ConfigError, match="http://x"):
        BridgeConfig(host="10.0.0.1", tls_certificate="a", tls_key="b", extra_origins="http://x")
    with pytest.raises(ConfigError, match="keepalive_fresh_s"):
        BridgeConfig(keepalive_fresh_s=0.7)


def test_origins_are_exact() -> None:
    assert BridgeConfig().origins(8080) == {"http://127.0.0.1:8080", "http://localhost:8080"}
    secure = BridgeConfig(host="10.0.0.1", tls_certificate="a", tls_key="b", extra_origins="https://room.example")
    assert secure.origins(443) == {"https://10.0.0.1", "https://room.example"}
    assert secure.url(8443) == "https://10.0.0.1:8443/"
