"""Reports that a busy computer delivers late, while the board moves on."""

from __future__ import annotations

import pytest
from unit.gantry_driver.protocol_board import Board, Rig


class LateBoard(Board):
    """A board that moves on while the computer delivers none of its bytes, in either direction, for a time."""

    def __init__(self) -> None:
        super().__init__()
        self.late_until = -1.0
        self._to_driver, self._to_board = bytearray(), bytearray()

    def write(self, data: bytes) -> None:
        if self.now < self.late_until:
            self._to_board += data
        else:
            super().write(data)

    def step(self, now: float) -> None:
        super().step(now)
        if now < self.late_until:
            self._to_driver += self.out
            self.out.clear()
        elif self._to_driver or self._to_board:
            self.out[:0] = self._to_driver
            data, self._to_board = bytes(self._to_board), bytearray()
            self._to_driver.clear()
            super().write(data)


@pytest.mark.parametrize("late_s", [0.1, 0.2, 0.4, 0.6])
@pytest.mark.parametrize("begin_s", [0.4, 0.42, 0.44, 0.46])
def test_late_report_on_the_path_does_not_stop_the_motion(begin_s: float, late_s: float) -> None:
    board = LateBoard()
    rig = Rig(board=board).homed()
    rig.go((0.35, 0.2, 0.0))
    rig.run_for(begin_s)
    board.late_until = rig.now + late_s
    rig.until(lambda: rig.outcomes()[-1] in ("reached", "aborted"))
    assert rig.results[-1].outcome.value == "reached", rig.results[-1]
