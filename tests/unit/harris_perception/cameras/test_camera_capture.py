"""The capture thread: images pass, failures are reported, pauses grow and the source is opened again."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest

from harris_perception.adapters.camera_sources import Frames, SourceEnded, SourceError
from harris_perception.adapters.capture import Capture

DEADLINE_S = 30.0


class ScriptedSource:
    """Plays a list of stamps and exceptions, then is silent until the capture stops."""

    def __init__(self, script: list[Any], stop: threading.Event) -> None:
        self.script, self.stop, self.closed = script, stop, False

    def read(self, timeout_s: float) -> Frames:
        if not self.script:
            self.stop.wait(timeout_s)
            raise TimeoutError
        step = self.script.pop(0)
        if isinstance(step, Exception):
            raise step
        return Frames(pictures=(np.zeros((2, 2, 3), np.uint8),), stamps_ns=(step,))

    def close(self) -> None:
        self.closed = True


def started(
    open_source: Callable[[threading.Event], Any], **options: Any
) -> tuple[Capture, queue.Queue[int], queue.Queue[str]]:
    stamps: queue.Queue[int] = queue.Queue()
    failures: queue.Queue[str] = queue.Queue()
    capture = Capture(
        open_source,
        lambda frames: stamps.put(frames.stamps_ns[0]),
        on_failure=failures.put,
        # Silence that no test asks for is no failure, however long the computer is busy with something else.
        **{"retry_min_s": 0.01, "retry_max_s": 0.04, "read_timeout_s": 3600.0, **options},
    )
    capture.start()
    return capture, stamps, failures


def test_pictures_pass_and_a_broken_source_is_opened_again() -> None:
    sources: list[ScriptedSource] = []
    scripts = [[1, 2, SourceError("caf\udce9.png is gone")], [TimeoutError(), 3]]

    def open_source(stop: threading.Event) -> ScriptedSource:
        sources.append(ScriptedSource(scripts.pop(0), stop))
        return sources[-1]

    capture, stamps, failures = started(open_source)
    assert [stamps.get(timeout=DEADLINE_S) for _ in range(3)] == [1, 2, 3]
    # Neither the log nor a message takes half a character, as Python has it for a byte of a name that is no UTF-8.
    assert failures.get(timeout=DEADLINE_S) == r"caf\udce9.png is gone; trying again in 0.0 s"
    assert capture.status.state == "running" and capture.status.pictures == 3 and capture.status.failures == 1
    assert capture.stop(DEADLINE_S)
    assert [source.closed for source in sources] == [True, True]


def test_pauses_double_up_to_the_longest_and_start_anew_after_a_picture() -> None:
    attempts = 0

    def open_source(stop: threading.Event) -> ScriptedSource:
        nonlocal attempts
        attempts += 1
        if attempts == 5:
            return ScriptedSource([1, SourceError("unplugged")], stop)
        raise SourceError("not there")

    capture, _, failures = started(open_source, retry_min_s=0.1, retry_max_s=0.3)
    said = [failures.get(timeout=DEADLINE_S) for _ in range(6)]
    assert capture.stop(DEADLINE_S)
    assert [float(text.split()[-2]) for text in said] == [0.1, 0.2, 0.3, 0.3, 0.1, 0.2]


def test_a_silent_source_is_opened_again() -> None:
    scripts: list[list[Any]] = [[1], [2]]
    capture, stamps, failures = started(lambda stop: ScriptedSource(scripts.pop(0), stop), read_timeout_s=0.1)
    assert [stamps.get(timeout=DEADLINE_S) for _ in range(2)] == [1, 2]
    assert failures.get(timeout=DEADLINE_S).startswith("no picture for 0.1 s")
    assert capture.stop(DEADLINE_S)


def test_an_error_of_another_kind_is_told_and_the_source_opened_again() -> None:
    scripts: list[Any] = [[1, cv2.error("pixels <= CV_IO_MAX_IMAGE_PIXELS")], RuntimeError("no home directory"), [2]]
    sources: list[ScriptedSource] = []

    def open_source(stop: threading.Event) -> ScriptedSource:
        script = scripts.pop(0)
        if isinstance(script, Exception):
            raise script
        sources.append(ScriptedSource(script, stop))
        return sources[-1]

    capture, stamps, failures = started(open_source)
    assert [stamps.get(timeout=DEADLINE_S) for _ in range(2)] == [1, 2]
    said = [failures.get(timeout=DEADLINE_S) for _ in range(2)]
    assert "CV_IO_MAX_IMAGE_PIXELS" in said[0] and "no home directory" in said[1]
    assert capture.status.state == "running" and capture.status.failures == 2 and sources[0].closed
    assert capture.stop(DEADLINE_S)


def test_the_end_of_a_recording_is_no_failure() -> None:
    capture, stamps, failures = started(lambda stop: ScriptedSource([1, SourceEnded("over")], stop))
    assert stamps.get(timeout=DEADLINE_S) == 1
    capture._thread.join(DEADLINE_S)
    assert capture.status.state == "ended" and capture.status.reason == "over" and failures.empty()
    assert capture.stop(DEADLINE_S)


@pytest.mark.parametrize("script", [[], [1], [SourceError("broken")]])
def test_stop_is_prompt_whatever_the_source_does(script: list[Any]) -> None:
    capture, _, _ = started(lambda stop: ScriptedSource(list(script), stop), retry_min_s=30.0, retry_max_s=30.0)
    assert capture.stop(DEADLINE_S)
    assert not capture._thread.is_alive()
