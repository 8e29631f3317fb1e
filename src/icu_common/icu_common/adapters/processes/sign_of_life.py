"""Report to bring-up that this program is ready, and from then on that its interpreter and its callbacks run."""

from __future__ import annotations

import contextlib
import os
import select
import threading
import time

from icu_common.core.processes.supervision import LONGEST_CALLBACK_S, READY_VARIABLE, SIGN_OF_LIFE_S


class SignsOfLife:
    """Writes a byte to bring-up's pipe at once and then, in a thread, each second while Python code can run.

    Bring-up ends a program whose signs stop. Native code that never returns may hold the interpreter's lock; then no
    thread of the program can run. If it has released the lock, the thread detects that there was no :meth:`turn` for
    longer than the longest callback. Without bring-up the object does nothing.

    Parameters
    ----------
    longest_turn_s
        Maximum seconds since the last turn; no signs are sent beyond it.
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
        """Record that the program serves its next callback."""
        self._turned_s = time.monotonic()

    def _go_on(self, pipe: int) -> None:
        with contextlib.suppress(OSError):  # bring-up has ended
            end_of_bring_up = select.poll()
            end_of_bring_up.register(pipe, 0)
            while not end_of_bring_up.poll(1000.0 * SIGN_OF_LIFE_S):
                if time.monotonic() - self._turned_s > self._longest_turn_s:
                    continue
                with contextlib.suppress(BlockingIOError):  # bring-up does not read
                    os.write(pipe, b"1")
