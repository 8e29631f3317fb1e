"""Tells bring-up that this program is ready, and from then on that its interpreter runs."""

from __future__ import annotations

import contextlib
import os
import threading
import time

from icu_common.core.supervision import READY_VARIABLE, SIGN_OF_LIFE_S


def give_signs_of_life() -> None:
    """Write a byte to bring-up's pipe now and, by a thread, every second in which Python code can run here.

    Bring-up ends a program that gives none any more: native code that never comes back holds the interpreter's lock,
    so that no signal, timer or thread of the program could. Without bring-up nothing is done.
    """
    with contextlib.suppress(OSError, ValueError):
        pipe = int(os.environ.pop(READY_VARIABLE, ""))
        os.set_inheritable(pipe, False)
        os.set_blocking(pipe, False)
        os.write(pipe, b"1")
        threading.Thread(target=_go_on, args=(pipe,), name="life", daemon=True).start()


def _go_on(pipe: int) -> None:
    with contextlib.suppress(OSError):  # bring-up has gone
        while True:
            time.sleep(SIGN_OF_LIFE_S)
            with contextlib.suppress(BlockingIOError):  # it stands still
                os.write(pipe, b"1")
