"""Processes of the graph: output, restart with a limit, an end that leaves nothing behind."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from support.deadlines import wait_until
from unit.icu_bringup.process_rig import PYTHON, Clock, Watch, alive, clock, interruptible, state_of

from icu_bringup.adapters import processes, watched_program

pytestmark = pytest.mark.slow

__all__ = ["clock", "interruptible"]  # fixtures
STUBBORN = "import signal, sys; [signal.signal(s, signal.SIG_IGN) for s in (2, 15)]; print('up'); signal.pause()"


def test_output_is_passed_on_in_whole_lines() -> None:
    watch = Watch()
    watch.group.start("a", [*PYTHON, "import sys; sys.stdout.write('on'); sys.stdout.flush(); print('e'); input()"])
    watch.until(lambda: ("a", "one") in watch.output)
    watch.group.stop()


def test_a_fallen_program_is_restarted_and_then_given_up(clock: Clock) -> None:
    watch = Watch(restarts=1)
    watch.group.start("a", [*PYTHON, "import sys; sys.exit(3)"])
    watch.until(lambda: watch.events)
    watch.until(lambda: watch.group.gave_up)
    assert [text.split(",")[0] for _, text in watch.events] == ["ended with exit code 3", "ended with exit code 3"]
    assert watch.group.gave_up == ["a"]
    watch.group.stop()


def test_a_program_that_ran_for_long_is_restarted_at_once() -> None:
    watch = Watch(window_s=1e-6)
    watch.group.start("a", [*PYTHON, "import sys; sys.exit(3)"])
    watch.until(lambda: watch.events)
    assert watch.events[0] == ("a", "ended with exit code 3, restarted at once")
    watch.group.stop()


# Ends once, then hangs once before it is ready and ignores signals, then works.
HANGS_ONCE = """
import os, pathlib, signal, sys
count = pathlib.Path(sys.argv[1])
number = len(count.read_text()) if count.exists() else 0
count.write_text("x" * (number + 1))
if number == 1:
    [signal.signal(s, signal.SIG_IGN) for s in (2, 15)]
    print("hangs")
    signal.pause()
os.write(int(os.environ["ICU_READY_FD"]), b"1")
print("ready")
sys.exit(3) if number == 0 else signal.pause()
"""


def test_a_restarted_program_that_does_not_get_ready_is_aborted_and_started_again(tmp_path: Path, clock: Clock) -> None:
    watch = Watch(ready_s=2.0)
    watch.group.start("a", [*PYTHON, HANGS_ONCE, str(tmp_path / "count")], tells_ready=True)
    watch.until(lambda: watch.events)
    watch.until(lambda: ("a", "hangs") in watch.output)
    clock.now += 2.1
    watch.until(lambda: len(watch.events) == 3)
    clock.now += 1.0
    watch.until(lambda: watch.output.count(("a", "ready")) == 2)
    assert [text for _, text in watch.events] == [
        "ended with exit code 3, restarted at once",
        "is not ready 2 s after its restart: aborted",
        "ended with signal SIGABRT, restarted in 0.5 s",
    ]
    watch.until_ready()  # received, and not waited for any more
    watch.group.stop()


# Gives signs of life, and none any more after an order; the second process continues.
FALLS_SILENT = """
import os, pathlib, signal, sys, time
first = not pathlib.Path(sys.argv[1]).exists()
pathlib.Path(sys.argv[1]).touch()
fd = int(os.environ["ICU_READY_FD"])
silent = []
signal.signal(signal.SIGUSR1, lambda *_: silent.append(1))
print("up", flush=True)
while not (first and silent):
    os.write(fd, b"1")
    time.sleep(0.1)  # the interval of the signs of life
print("silent", flush=True)
while True:
    signal.pause()
"""


def test_a_program_that_gives_no_sign_of_life_any_more_is_aborted_and_started_again(
    tmp_path: Path, clock: Clock
) -> None:
    watch = Watch(silent_s=2.0)
    watch.group.start("a", [*PYTHON, FALLS_SILENT, str(tmp_path / "been")], tells_ready=True)
    watch.until_ready()
    first = watch.group.running()["a"]
    os.kill(first, signal.SIGUSR1)
    watch.until(lambda: ("a", "silent") in watch.output)
    for _ in range(3):
        assert not watch.events
        clock.now += 1.0
        watch.group.watch(0.0)
    watch.until(lambda: len(watch.events) == 2)
    watch.until(lambda: watch.output.count(("a", "up")) == 2)
    assert [text for _, text in watch.events] == [
        "hangs: no sign of life for 2 s: aborted",
        "ended with signal SIGABRT, restarted at once",
    ]
    assert not alive(first)
    watch.until_ready()
    for _ in range(3):
        clock.now += 1.0
        watch.until_it_shows_life()
    assert len(watch.events) == 2, "one that gives signs is left alone"
    watch.group.stop()


LAST_WORDS = """
import signal, sys
def say(*_):
    sys.stdout.write("".join(f"{n:07d}\\n" for n in range(30000)))
    sys.exit()
signal.signal(signal.SIGINT, say)
print("up", flush=True)
while True:
    signal.pause()
"""


def test_all_that_a_program_says_before_it_ends_is_passed_on() -> None:
    watch = Watch()
    watch.group.start("a", [*PYTHON, LAST_WORDS])
    watch.until(lambda: watch.output)
    stdout = watch.group._programs[0].process.stdout  # type: ignore[union-attr]
    assert watch.group.stop() == []
    assert watch.output == [("a", "up"), *(("a", f"{n:07d}") for n in range(30000))]
    assert stdout is not None and stdout.closed


# Is ready, and hangs in code that holds the interpreter's lock.
TELLS_WHERE = """
import ctypes, faulthandler, os
faulthandler.enable()
def the_place():
    print("up", flush=True)
    ctypes.PyDLL(None).sleep(60)
os.write(int(os.environ["ICU_READY_FD"]), b"1")
the_place()
"""
# The same, and does not end when it is aborted, as one that cannot.
CANNOT_END = """
import os, signal
signal.signal(signal.SIGABRT, signal.SIG_IGN)
os.write(int(os.environ["ICU_READY_FD"]), b"1")
while True:
    signal.pause()
"""


def test_a_program_that_hangs_tells_where(clock: Clock) -> None:
    watch = Watch(silent_s=1.5)
    watch.group.start("a", [*PYTHON, TELLS_WHERE], tells_ready=True)
    watch.until(lambda: ("a", "up") in watch.output)
    watch.until_ready()
    for _ in range(2):
        clock.now += 1.0
        watch.group.watch(0.0)
    watch.until(lambda: len(watch.events) == 2)
    watch.until(lambda: any("in the_place" in line for _, line in watch.output))
    assert ("a", "Fatal Python error: Aborted") in watch.output
    watch.group.stop()


def test_a_program_that_hangs_and_cannot_be_aborted_is_killed(clock: Clock) -> None:
    watch = Watch(silent_s=1.5)
    watch.group.start("a", [*PYTHON, CANNOT_END], tells_ready=True)
    watch.until_ready()
    first = watch.group.running()["a"]
    for _ in range(6):
        clock.now += 1.0
        watch.group.watch(0.0)
    assert [text for _, text in watch.events] == ["hangs: no sign of life for 1.5 s: aborted"]
    assert alive(first) and watch.group.hanging == {first}
    clock.now += 2.0
    watch.until(lambda: len(watch.events) == 2)
    assert not watch.group.hanging
    assert watch.events[-1] == ("a", "ended with signal SIGKILL, restarted at once")
    watch.group.stop()


def test_a_program_that_waits_for_the_processor_is_late_and_hangs_only_after_longer(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(watched_program, "_waits_for_core", lambda pid: {"7": 0.1 * clock.now, "8": 0.8 * clock.now})
    watch = Watch(silent_s=2.0)
    watch.group.start("a", [*PYTHON, CANNOT_END], tells_ready=True)
    watch.until_ready()
    for _ in range(8):
        clock.now += 1.0
        watch.group.watch(0.0)
    late = ("a", "is late: no sign of life for 2 s, it waits for the processor")
    assert watch.events == [late] and not watch.group.hanging
    clock.now += 1.0
    watch.group.watch(0.0)
    assert watch.events == [late, ("a", "hangs: no sign of life for 8 s: aborted")]
    watch.group.stop()


def test_the_time_that_threads_wait_for_the_processor_is_read() -> None:
    with subprocess.Popen([*PYTHON, "input()"], stdin=subprocess.PIPE) as process:
        assert str(process.pid) in watched_program._waits_for_core(process.pid)
        process.kill()
    assert watched_program._waits_for_core(process.pid) == {}


def with_a_stopped_program(folder: Path) -> tuple[Watch, int]:
    """Return a watch of a program that a person has stopped, and the program's number."""
    watch = Watch(silent_s=2.0)
    watch.group.start("a", [*PYTHON, FALLS_SILENT, str(folder / "been")], tells_ready=True)
    watch.until_ready()
    pid = watch.group.running()["a"]
    os.kill(pid, signal.SIGSTOP)
    watch.until(lambda: state_of(pid) == "T")
    watch.group.watch(0.0)  # the last sign
    return watch, pid


def test_a_program_that_a_person_has_stopped_is_not_taken_for_one_that_hangs(tmp_path: Path, clock: Clock) -> None:
    watch, pid = with_a_stopped_program(tmp_path)
    for _ in range(3):
        clock.now += 1.0
        watch.group.watch(0.0)
    os.kill(pid, signal.SIGCONT)
    clock.now += 1.0
    watch.until_it_shows_life()
    assert not watch.events
    watch.group.stop()


def test_time_for_which_a_person_has_stopped_a_program_does_not_count_as_silence(tmp_path: Path, clock: Clock) -> None:
    """Let go on, it may need a moment for its next sign: on a busy computer, or after what it has missed."""
    watch, pid = with_a_stopped_program(tmp_path)
    for _ in range(2):
        clock.now += 0.9
        watch.group.watch(0.0)
    os.kill(pid, signal.SIGUSR1)
    os.kill(pid, signal.SIGCONT)
    watch.until(lambda: ("a", "silent") in watch.output)
    for events in (0, 0, 1):
        clock.now += 0.9
        watch.group.watch(0.0)
        assert len(watch.events) == events
    watch.group.stop()


def test_a_program_that_a_signal_has_stopped_for_long_is_started_again(tmp_path: Path, clock: Clock) -> None:
    """Its last state would stay on its latched topics, as if it were true."""
    watch, pid = with_a_stopped_program(tmp_path)
    for _ in range(14):
        clock.now += 1.1
        watch.group.watch(0.0)
    assert not watch.events
    for _ in range(3):
        clock.now += 1.1
        watch.group.watch(0.0)
    assert watch.events[0] == ("a", "has been stopped by a signal for 15 s: aborted")
    clock.now += 5.0
    watch.until(lambda: len(watch.events) == 2)
    assert watch.events[1] == ("a", "ended with signal SIGKILL, restarted at once")
    clock.now += 1.0
    watch.until(lambda: watch.group.running().get("a", pid) != pid)
    watch.group.stop()


def test_silence_while_bring_up_itself_stood_still_does_not_count(tmp_path: Path, clock: Clock) -> None:
    watch = Watch(silent_s=2.5)
    watch.group.start("a", [*PYTHON, FALLS_SILENT, str(tmp_path / "been")], tells_ready=True)
    watch.until_ready()
    os.kill(watch.group.running()["a"], signal.SIGUSR1)
    watch.until(lambda: ("a", "silent") in watch.output)
    watch.group.watch(0.0)
    for events in (0, 0, 1):  # of each pause one second counts
        clock.now += 60.0
        watch.group.watch(0.0)
        assert len(watch.events) == events
    watch.group.stop()


# Prints its arguments; killed the first time, ignores signals the second time.
CRASHES_ONCE = """
import os, pathlib, signal, sys
count = pathlib.Path(sys.argv[1])
number = len(count.read_text()) if count.exists() else 0
count.write_text("x" * (number + 1))
print("after a crash:", os.environ.get("ICU_AFTER_CRASH", "no"), flush=True)
if number == 0:
    os.kill(os.getpid(), signal.SIGKILL)
sys.exit(75) if number == 1 else signal.pause()
"""


def test_a_program_is_told_that_its_predecessor_crashed_and_ends_as_deaf_once_at_most(
    tmp_path: Path, clock: Clock
) -> None:
    watch = Watch()
    watch.group.start("a", [*PYTHON, CRASHES_ONCE, str(tmp_path / "count")], tells_ready=True)
    for restarts, delay_s in ((1, 0.0), (2, 0.5)):
        watch.until(lambda restarts=restarts: len(watch.events) == restarts)
        clock.now += delay_s
    watch.until(lambda: len(watch.output) == 3)
    assert [line for _, line in watch.output] == ["after a crash: no", "after a crash: 1", "after a crash: no"]
    assert [text for _, text in watch.events] == [
        "ended with signal SIGKILL, restarted at once",
        "does not hear the others, restarted in 0.5 s",
    ]
    watch.group.stop()


def test_a_wrong_configuration_is_not_restarted() -> None:
    watch = Watch()
    watch.group.start("a", [*PYTHON, "import sys; sys.exit(2)"])
    watch.until(lambda: watch.group.gave_up)
    assert "mend its configuration" in watch.events[0][1]
    watch.group.stop()


def test_stop_ends_all_and_kills_the_stubborn(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = Watch()
    watch.group.start("stubborn", [*PYTHON, STUBBORN])
    watch.group.start("polite", [*PYTHON, "import signal; print('up'); signal.pause()"])
    watch.until(lambda: len(watch.output) == 2)
    pids = watch.group.running()
    gone_s: list[float] = []

    def monotonic() -> float:
        """Return the time since the polite one went, which may take as long as it needs."""
        if not gone_s and not alive(pids["polite"]):
            gone_s.append(time.monotonic())
        return time.monotonic() - gone_s[0] if gone_s else 0.0

    monkeypatch.setattr(processes, "time", SimpleNamespace(monotonic=monotonic))
    assert watch.group.stop(within_s=1.0) == ["stubborn"]
    # A killed process ends when the kernel next runs it.
    wait_until(lambda: not any(alive(pid) for pid in pids.values()), "both programs have ended")


def test_a_program_that_misses_the_interrupt_while_it_starts_is_ended_at_once() -> None:
    """While Python imports or something compiles, a KeyboardInterrupt can end in a callback that swallows it."""
    watch = Watch()
    starting = "import signal; signal.signal(2, lambda *_: None); print('importing')\nwhile True: signal.pause()"
    watch.group.start("a", [*PYTHON, starting], tells_ready=True)
    watch.until(lambda: watch.output)
    begun = time.monotonic()
    assert watch.group.stop() == []
    assert time.monotonic() - begun < 7.0, "an interrupt alone has 14 s"


def test_what_ends_last_lives_until_the_others_are_gone(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    slow = f"""
import pathlib, select, signal
def leave(number, frame):
    select.select([], [], [], 0.5)
    pathlib.Path({str(mark)!r}).write_text('held')
    raise SystemExit
signal.signal(2, leave)
print('up')
signal.pause()
"""
    board = f"""
import pathlib, signal
def leave(number, frame):
    print('board saw', pathlib.Path({str(mark)!r}).exists())
    raise SystemExit
signal.signal(2, leave)
print('up')
signal.pause()
"""
    watch = Watch()
    watch.group.start("board", [*PYTHON, board], ends_last=True)
    watch.group.start("driver", [*PYTHON, slow])
    watch.until(lambda: len(watch.output) == 2)
    ended: dict[str, float] = {}
    assert watch.group.stop(on_ended=ended.__setitem__) == []
    assert ("board", "board saw True") in watch.output
    assert list(ended) == ["driver", "board"] and ended["driver"] >= 0.5
