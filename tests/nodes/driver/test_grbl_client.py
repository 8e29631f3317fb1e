"""The client of a GRBL board without ROS, on a mock board; truth from the board."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from nodes.grbl_board import GrblBoard

from gantry_driver import GrblClient, GrblError
from gantry_driver.core.configuration.machine_config import DriverConfig
from icu_common.core.goals.results import Outcome

PATIENT = DriverConfig(heartbeat_timeout_s=2.0, status_timeout_s=10.0, hold_timeout_s=10.0)


@pytest.fixture
def board(tmp_path: Path) -> Iterator[GrblBoard]:
    board = GrblBoard(tmp_path, "--start=-350,-210,-2")
    yield board
    board.close()


def moves(board: GrblBoard) -> list[str]:
    return [line["text"] for line in board.lines() if "G53" in line["text"]]


def test_client_homes_and_runs_programs_one_after_another(board: GrblBoard) -> None:
    texts: list[str] = []
    with GrblClient(str(board.port), PATIENT, on_text=texts.append) as client:
        client.home()
        assert client.state == "idle" and client.position_m == pytest.approx((0.0, 0.0, 0.0), abs=1e-4)
        for x_mm, y_mm in ((-349, -209), (-339, -199)):
            assert client.run([f"G53 G1 X{x_mm} Y{y_mm} F9000"]).outcome is Outcome.REACHED
            assert client.position_m == pytest.approx(((x_mm + 359) / 1000, (y_mm + 219) / 1000, 0.0), abs=1e-4)
            assert board.mpos()[:2] == pytest.approx((x_mm, y_mm), abs=0.02)
    assert moves(board) == ["F9000X-349Y-209G53G1", "F9000X-339Y-199G53G1"]
    assert [text for text in texts if text in ("homing", "moving")] == ["homing", "moving", "moving"]


def test_program_that_leaves_the_travel_is_rejected_before_it_moves(board: GrblBoard) -> None:
    with GrblClient(str(board.port), PATIENT) as client:
        client.home()
        with pytest.raises(GrblError, match=r"Y = 7\.000 mm \(machine\) is outside -219 to 0 mm"):
            client.run(["G53 G1 X-349 Y-209 F9000", "G53 G1 X-100 Y7"])
        assert client.state == "idle"
    assert moves(board) == []


def test_program_is_rejected_on_a_machine_that_is_not_homed(board: GrblBoard) -> None:
    with GrblClient(str(board.port), PATIENT) as client:
        client.connect()
        with pytest.raises(GrblError, match="the board is unhomed; expected 'idle'"):
            client.run(["G53 G1 X-349 Y-209 F9000"])
    assert moves(board) == []


def test_missing_port_is_reported(tmp_path: Path) -> None:
    with (
        GrblClient(str(tmp_path / "none"), PATIENT) as client,
        pytest.raises(GrblError, match="No such file or directory"),
    ):
        client.home()


def test_block_that_fails_leaves_the_stylus_up_and_the_port_free(board: GrblBoard) -> None:
    with pytest.raises(RuntimeError, match="of the caller"), GrblClient(str(board.port), PATIENT) as client:
        client.home()
        raise RuntimeError("of the caller")
    with GrblClient(str(board.port), PATIENT) as again:
        assert again.settings()[130] == "360.000", "the first client has released the port"
    assert board.mpos()[2] == pytest.approx(-1.0, abs=0.02)
