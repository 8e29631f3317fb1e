"""Images of the bench to their readers: the frame socket, and the faults of a camera that is frozen or unplugged."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from icu_common.adapters.frame_link import FRAMES, FrameServer
from icu_common.adapters.steps.step_ledger import StepLedger
from icu_simulator.imaging.stream import CameraImage

SEND_S = 0.03
"""Maximum seconds to wait until readers have taken a pair; the rest of it follows later."""
CAMERA_STATES = ("ok", "frozen", "unplugged")


class ImageOutput:
    """The frame socket.

    Parameters
    ----------
    path
        Path of the socket; None without one.
    ledger
        Ledger that counts the images of a stepped bench; None for real time.

    Attributes
    ----------
    state
        State of the cameras, one of ``CAMERA_STATES``.
    readers
        Number of readers at the last exposure.
    sent
        Number of sent pairs.
    """

    def __init__(self, path: Path | None, ledger: StepLedger | None) -> None:
        self._path, self._ledger = path, ledger
        self._server: FrameServer | None = None
        self.state = "ok"
        self.readers = self.sent = 0

    def open(self) -> None:
        """Create the socket, if it does not exist.

        Raises
        ------
        OSError
            If it cannot be created.
        """
        if self._path is not None and self._server is None:
            self._server = FrameServer(self._path)

    def close(self) -> None:
        """Close the socket; may be called twice."""
        if self._server is not None:
            self._server.close()
            self._server = None

    def set_state(self, state: str) -> None:
        """Make the cameras run, freeze or disappear."""
        if state not in CAMERA_STATES:
            raise ValueError(f"state {state!r} is none of {', '.join(CAMERA_STATES)}")
        self.state = state
        if state == "unplugged":
            self.close()
        else:
            self.open()

    def is_wanted(self) -> bool:
        """Count the readers; return whether images are to be sent."""
        self.readers = self._server.reader_count() if self._server is not None else 0
        return self.readers > 0 and self.state == "ok"

    def send(self, images: Sequence[CameraImage], stamps_ns: Sequence[int]) -> None:
        """Send the images of one exposure with their stamps."""
        server = self._server
        if server is None:
            return
        if self._ledger is not None:
            self._ledger.expect(FRAMES, min(self.readers, self._ledger.subscriptions(FRAMES)))
        server.send([image.picture for image in images], list(stamps_ns), [image.camera for image in images])
        deadline = time.monotonic() + SEND_S
        while not server.flush() and (left := deadline - time.monotonic()) > 0:
            server.wait_writable(left)
        self.sent += 1

    def flush(self) -> bool:
        """Continue to send; return whether everything is sent."""
        return self._server is None or self._server.flush()
