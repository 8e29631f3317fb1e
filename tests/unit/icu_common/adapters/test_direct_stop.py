"""The text of a stop's datagram is safe in the log, on a terminal, in the audit file and on the page."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from icu_common.adapters.direct_stop.line import STOP_BYTES, open_stop_socket, received_stop, send_stop


@pytest.mark.parametrize(
    ("sent", "text"),
    [
        (b"stop requested", "stop requested"),
        (b"\x1b[2J\x1b]0;owned\x07", "\\x1b[2J\\x1b]0;owned\\x07"),
        (b"a\nERROR b\r\x00\x7f", "a\\x0aERROR b\\x0d\\x00\\x7f"),
        ("Fl\u00fcssig".encode(), "Fl\ufffd\ufffdssig"),
        (1000 * b"x", STOP_BYTES * "x"),
        (b"", ""),
    ],
)
def test_a_datagram_is_cut_and_what_a_terminal_would_obey_is_escaped(tmp_path: Path, sent: bytes, text: str) -> None:
    with open_stop_socket(tmp_path / "stop") as stops, socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.sendto(sent, bytes(tmp_path / "stop"))
        assert received_stop(stops) == text
        assert received_stop(stops) is None


def test_a_stop_without_a_guard_is_reported_as_not_received(tmp_path: Path) -> None:
    assert not send_stop(tmp_path / "stop", "stop requested")
