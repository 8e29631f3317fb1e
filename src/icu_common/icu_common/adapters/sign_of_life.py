"""Tells bring-up that this program is ready, and from then on that its interpreter runs and its work goes on."""

from __future__ import annotations

import contextlib
import os
import threading
import time

from icu_common.core.supervision import LONGEST_CALLBACK_S, READY_VARIABLE, SIGN_OF_LIFE_S


class SignsOfLife:
    """Writes a byte to bring-up's pipe now and, by a thread, every second in which Python code can run here.

    Bring-up ends a program that gives none any more. Native code that never comes back either holds the interpreter's
    lock, so that no signal, timer or thread of the program could run, or it has released it, and the thread sees that
    there was no :meth:`turn` for longer than any callback lasts. Without bring-up nothing is done.

    Parameters
    ----------
    longest_turn_s
        No more signs are given while the last turn is longer ago.
    """

    def __init__(self, longest_turn_s: float = LONGEST_CALLBACK_S) -> None:
        self._longest_turn_s = longest_turn_s
        self.turn()
        with contextlib.suppress(OSError, ValueError):
            pipe = int(os.environ.pop(READY_VARIABLE, ""))
            os.set_inheritable(pipe, False)
            os.set_blocking(pipe, False)
            os.write(pipe, b"1")
            threading.Thread(target=self._go_on, args=(pipe,), name="life", daemon=True).start()

    def turn(self) -> None:
        """Note that the program serves its next callback."""
        self._turned_s = time.monotonic()

    def _go_on(self, pipe: int) -> None:
        with contextlib.suppress(OSError):  # bring-up has gone
            while True:
                time.sleep(SIGN_OF_LIFE_S)
                if time.monotonic() - self._turned_s > self._longest_turn_s:
                    continue
                with contextlib.suppress(BlockingIOError):  # it stands still
                    os.write(pipe, b"1")
