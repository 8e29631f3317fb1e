"""Images over a Unix socket arrive whole, a slow reader misses some, and a lost server is detected."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

from icu_common.adapters.frame_link import FrameClient, FrameServer
from icu_common.adapters.unix_listener import listen_at

DEADLINE_S = 30.0
RNG = np.random.default_rng(7)
PAIR = [RNG.integers(0, 255, (480, 640, 3), dtype=np.uint8) for _ in range(2)]


def drain(server: FrameServer) -> None:
    for _ in range(10_000):
        if server.flush():
            return
        server.wait_writable(0.05)
    pytest.fail("the reader took nothing")


def test_pair_arrives_with_its_stamp(tmp_path: Path) -> None:
    server = FrameServer(tmp_path / "s")
    client = FrameClient(tmp_path / "s")
    assert server.reader_count() == 1
    server.send(PAIR, 123_456_789_012)
    sender = threading.Thread(target=drain, args=(server,))
    sender.start()
    pictures, stamps_ns, cameras = client.read(DEADLINE_S)
    sender.join(DEADLINE_S)
    assert stamps_ns == (123_456_789_012,) * 2 and cameras == (0, 1)
    np.testing.assert_array_equal(pictures, PAIR)
    with pytest.raises(TimeoutError):
        client.read(0.01)
    server.close()
    with pytest.raises(ConnectionError, match="gone"):
        client.read(0.5)
    client.close()
    with pytest.raises(OSError):
        FrameClient(tmp_path / "s")


def test_each_image_has_its_own_stamp_and_camera(tmp_path: Path) -> None:
    """Two cameras that run freely expose at times of their own, and each may lose an image of its own."""
    server = FrameServer(tmp_path / "s")
    client = FrameClient(tmp_path / "s")
    small = [picture[:48, :64].copy() for picture in PAIR]
    assert server.reader_count() == 1
    server.send(small, (1_000_000_000, 1_021_000_000))
    server.flush()
    pictures, stamps_ns, cameras = client.read(DEADLINE_S)
    assert stamps_ns == (1_000_000_000, 1_021_000_000) and cameras == (0, 1)
    np.testing.assert_array_equal(pictures, small)
    server.send(small[1:], (7,), (1,))
    pictures, stamps_ns, cameras = client.read(DEADLINE_S)
    assert stamps_ns == (7,) and cameras == (1,)
    np.testing.assert_array_equal(pictures, small[1:])
    client.close()
    server.close()


def test_what_does_not_fit_together_is_not_sent(tmp_path: Path) -> None:
    server = FrameServer(tmp_path / "s")
    with pytest.raises(ValueError, match="2 images, 1 stamps, 2 cameras"):
        server.send(PAIR, (1,))
    with pytest.raises(ValueError, match="unequal shapes"):
        server.send([PAIR[0], PAIR[1][:1]], 1)
    server.close()


def test_slow_reader_misses_frames_but_never_gets_a_torn_one(tmp_path: Path) -> None:
    server = FrameServer(tmp_path / "s")
    client = FrameClient(tmp_path / "s")
    big = [np.full((1080, 1920, 3), value, np.uint8) for value in (1, 2)]
    for stamp in range(20):
        server.send(big, stamp)  # never blocks, although no program reads
    sender = threading.Thread(target=drain, args=(server,))
    sender.start()
    pictures, stamps_ns, _ = client.read(DEADLINE_S)
    assert stamps_ns == (0, 0) and (pictures[0] == 1).all() and (pictures[1] == 2).all()
    sender.join(DEADLINE_S)
    server.close()
    client.close()


def test_a_picture_that_is_held_up_half_way_is_read_on(tmp_path: Path) -> None:
    """The bench may be held up for longer than a reader waits, on an overloaded computer."""
    server = FrameServer(tmp_path / "s")
    client = FrameClient(tmp_path / "s")
    big = [np.full((1600, 2000, 3), value, np.uint8) for value in (1, 2)]  # more than the socket takes
    server.send(big, 5)
    for _ in range(2):
        with pytest.raises(TimeoutError):
            client.read(0.05)
    sender = threading.Thread(target=drain, args=(server,))
    sender.start()
    pictures, stamps_ns, _ = client.read(DEADLINE_S)
    sender.join(DEADLINE_S)
    assert stamps_ns == (5, 5) and (pictures[0] == 1).all() and (pictures[1] == 2).all()
    server.close()
    client.close()


def test_a_reader_that_goes_does_not_hurt_the_server(tmp_path: Path) -> None:
    server = FrameServer(tmp_path / "s")
    client = FrameClient(tmp_path / "s")
    server.send(PAIR, 1)
    client.close()
    server.send(PAIR, 2)
    server.send(PAIR, 3)
    assert server.reader_count() == 0
    server.close()


def test_a_file_that_is_no_socket_is_left_alone(tmp_path: Path) -> None:
    kept = tmp_path / "notes.txt"
    kept.write_text("mine")
    with pytest.raises(FileExistsError, match=r"notes\.txt exists and is not a socket"):
        FrameServer(kept)
    assert kept.read_text() == "mine"


def test_a_socket_that_a_killed_program_left_is_replaced(tmp_path: Path) -> None:
    listen_at(tmp_path / "s").close()
    server = FrameServer(tmp_path / "s")
    client = FrameClient(tmp_path / "s")
    assert server.reader_count() == 1
    client.close()
    server.close()


def test_a_path_that_is_too_long_for_a_socket_is_said_with_the_bound(tmp_path: Path) -> None:
    path = tmp_path / ("x" * 108)
    with pytest.raises(OSError, match=rf"{path}: a socket's path may have 107 bytes"):
        listen_at(path)


def test_a_place_that_takes_no_socket_is_named() -> None:
    with pytest.raises(OSError, match=r"^/proc/socket: No such file or directory$"):
        listen_at(Path("/proc/socket"))
