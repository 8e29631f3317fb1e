"""Thread that reads a camera source; after a failure it reports, waits and reopens the source."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from harris_perception.adapters.camera_sources import CameraSource, Frames, SourceEnded, SourceError

_TURN_S = 0.2


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureStatus:
    """State of the capture thread: ``state`` is opening, running, waiting (before reopening) or ended."""

    state: str
    reason: str = ""
    pictures: int = 0
    failures: int = 0


class Capture:
    """Reads a source in its own thread and passes every set of images to ``on_frames`` in that thread.

    Parameters
    ----------
    open_source
        Opens the source; called again after every failure. Its argument is the event that is set when the capture
        stops.
    on_frames
        Receives the images.
    on_failure
        Receives a sentence for the log after every failure.
    read_timeout_s
        Time without an image after which a source has failed.
    retry_min_s, retry_max_s
        First and longest pause before reopening; the pause doubles until images arrive.
    clock
        Clock, in seconds, that measures the time without an image. A simulated camera sends nothing while simulated
        time is stopped.
    """

    def __init__(
        self,
        open_source: Callable[[threading.Event], CameraSource],
        on_frames: Callable[[Frames], None],
        *,
        on_failure: Callable[[str], None],
        read_timeout_s: float = 2.0,
        retry_min_s: float = 0.5,
        retry_max_s: float = 5.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._clock = clock
        self._open_source, self._on_frames, self._on_failure = open_source, on_frames, on_failure
        self._read_timeout_s, self._retry_min_s, self._retry_max_s = read_timeout_s, retry_min_s, retry_max_s
        self._stop = threading.Event()
        self._status = CaptureStatus(state="opening")
        self._thread = threading.Thread(target=self._run, name="capture", daemon=True)

    def set_waits(self, *, read_timeout_s: float, retry_min_s: float, retry_max_s: float) -> None:
        """Change the waiting times; a pause that has already begun does not change."""
        self._read_timeout_s, self._retry_min_s, self._retry_max_s = read_timeout_s, retry_min_s, retry_max_s

    @property
    def status(self) -> CaptureStatus:
        """The latest status; replaced as a whole."""
        return self._status

    def start(self) -> None:
        self._thread.start()

    def stop(self, within_s: float = 3.0) -> bool:
        """Stop the thread and return whether it has ended (a device driver may block it longer)."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join(within_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        pause_s = self._retry_min_s
        while not self._stop.is_set():
            before = self._status.pictures
            try:
                self._read_until_failure()
            except SourceEnded as end:
                self._set("ended", str(end))
                return
            except Exception as error:
                # An uncaught error would end the thread silently, and the node would report "running" forever. OpenCV
                # has error types of its own, and a path may make the standard library raise any type.
                why = str(error) if isinstance(error, SourceError) else f"error while reading: {error!r}"
                why = why.encode(errors="backslashreplace").decode()  # file names need not be UTF-8, messages must be
                if self._status.pictures > before:
                    pause_s = self._retry_min_s
                pause_s = min(max(pause_s, self._retry_min_s), self._retry_max_s)
                self._set("waiting", why, failed=1)
                self._on_failure(f"{why}; trying again in {pause_s:.1f} s")
                self._stop.wait(pause_s)
                pause_s = 2 * pause_s

    def _read_until_failure(self) -> None:
        self._set("opening", self._status.reason)
        source = self._open_source(self._stop)
        last_s = self._clock()
        try:
            while not self._stop.is_set():
                try:
                    frames = source.read(min(_TURN_S, self._read_timeout_s))
                except TimeoutError:
                    if self._clock() - last_s > self._read_timeout_s:
                        raise SourceError(f"no picture for {self._read_timeout_s:.1f} s") from None
                    continue
                last_s = self._clock()
                if not self._stop.is_set():
                    self._set("running", taken=1)
                    self._on_frames(frames)
        finally:
            source.close()

    def _set(self, state: str, reason: str = "", *, taken: int = 0, failed: int = 0) -> None:
        old = self._status
        self._status = CaptureStatus(
            state=state, reason=reason, pictures=old.pictures + taken, failures=old.failures + failed
        )
