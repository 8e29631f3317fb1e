"""Rescues: what bring-up starts when a signal has ended a program."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from unit.icu_bringup.process_rig import PYTHON, Clock, Watch, alive, clock, interruptible

pytestmark = pytest.mark.slow

__all__ = ["clock", "interruptible"]  # fixtures


def rescued(watch: Watch, tmp_path: Path, rescue: str, program: str = "signal.pause()") -> None:
    """Start a program with a rescue that notes its start in a file."""
    note = f"import os, signal, sys; open({str(tmp_path / 'rescues')!r}, 'a').write(f'{{os.getpid()}} ')"
    watch.group.start(
        "driver", [*PYTHON, f"import signal; print('up'); {program}"], rescue=[*PYTHON, f"{note}; {rescue}"]
    )


def rescues(tmp_path: Path) -> list[int]:
    path = tmp_path / "rescues"
    return [int(word) for word in path.read_text().split()] if path.exists() else []


def test_the_rescue_of_a_program_starts_when_a_signal_has_ended_it(tmp_path: Path) -> None:
    watch = Watch()
    rescued(watch, tmp_path, "sys.exit(0)")
    watch.until(lambda: watch.output)
    assert rescues(tmp_path) == []
    os.kill(watch.group.running()["driver"], signal.SIGKILL)
    watch.until(lambda: rescues(tmp_path) and watch.output.count(("driver", "up")) == 2)
    watch.until(lambda: list(watch.group.running()) == ["driver"])
    assert watch.events == [("driver", "ended with signal SIGKILL, restarted at once")]
    watch.group.stop()
    assert len(rescues(tmp_path)) == 1


def test_a_rescue_is_scheduled_before_busy_programs_from_its_first_instruction(tmp_path: Path) -> None:
    code = "from icu_common.adapters.real_time import *; print(ask_for_real_time(DRIVER))"
    if refusal := subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.strip():
        pytest.skip(refusal)
    watch = Watch()
    rescued(watch, tmp_path, "print(os.sched_getscheduler(0) == os.SCHED_RR)")
    watch.until(lambda: watch.output)
    os.kill(watch.group.running()["driver"], signal.SIGKILL)
    watch.until(lambda: ("rescue of driver", "True") in watch.output)
    watch.group.stop()


@pytest.mark.parametrize("code", [0, 3])
def test_a_program_that_ends_by_itself_needs_no_rescue(tmp_path: Path, code: int) -> None:
    watch = Watch(restarts=0)
    rescued(watch, tmp_path, "sys.exit(0)", f"raise SystemExit({code})")
    watch.until(lambda: watch.events)
    assert watch.group.gave_up == ["driver"] and rescues(tmp_path) == []
    watch.group.stop()


def test_one_rescue_runs_at_a_time_and_one_that_is_killed_starts_again_at_once(tmp_path: Path) -> None:
    watch = Watch()
    rescued(watch, tmp_path, "signal.pause()")
    watch.until(lambda: watch.output)
    for count in (2, 3):
        os.kill(watch.group.running()["driver"], signal.SIGKILL)
        watch.until(lambda count=count: watch.output.count(("driver", "up")) == count)  # type: ignore[misc]
    watch.until(lambda: len(rescues(tmp_path)) == 1)
    os.kill(rescues(tmp_path)[0], signal.SIGKILL)
    watch.until(lambda: len(rescues(tmp_path)) == 2)
    assert watch.group.ready_count() == 1, "a rescue is none of the graph's programs"
    watch.group.stop()
    assert not any(alive(pid) for pid in rescues(tmp_path))


def test_a_rescue_that_waits_for_its_restart_starts_with_the_next_end_of_its_program(
    tmp_path: Path, clock: Clock
) -> None:
    watch = Watch()
    rescued(watch, tmp_path, "signal.pause()")
    watch.until(lambda: watch.output)
    os.kill(watch.group.running()["driver"], signal.SIGKILL)
    for count in (1, 2):  # the second end within the window is followed by a pause
        watch.until(lambda count=count: len(rescues(tmp_path)) == count)  # type: ignore[misc]
        os.kill(rescues(tmp_path)[-1], signal.SIGKILL)
        watch.until(lambda count=count: len([e for e in watch.events if e[0] != "driver"]) == count)  # type: ignore[misc]
    assert watch.events[-1] == ("rescue of driver", "ended with signal SIGKILL, restarted in 0.5 s")
    watch.until(lambda: watch.output.count(("driver", "up")) == 2)
    os.kill(watch.group.running()["driver"], signal.SIGKILL)
    watch.until(lambda: len(rescues(tmp_path)) == 3)
    watch.group.stop()


def test_a_rescue_that_is_killed_too_often_waits_for_the_next_end_of_its_program(tmp_path: Path, clock: Clock) -> None:
    watch = Watch(restarts=1)
    rescued(watch, tmp_path, "os.kill(os.getpid(), 9)")
    watch.until(lambda: watch.output)
    os.kill(watch.group.running()["driver"], signal.SIGKILL)
    watch.until(lambda: any("given up" in text for _, text in watch.events))
    assert watch.group.gave_up == [], "the program goes on"
    watch.group.stop()


def test_a_rescue_that_cannot_be_started_is_reported_and_its_program_restarted(tmp_path: Path) -> None:
    watch = Watch()
    watch.group.start("driver", [*PYTHON, "import signal; print('up'); signal.pause()"], rescue=[str(tmp_path / "no")])
    watch.until(lambda: watch.output)
    os.kill(watch.group.running()["driver"], signal.SIGKILL)
    watch.until(lambda: watch.output.count(("driver", "up")) == 2)
    assert watch.events[0][0] == "rescue of driver" and watch.events[0][1].startswith("cannot be started: ")
    watch.group.stop()


def test_a_rescue_ends_after_its_program_and_before_what_ends_last(tmp_path: Path) -> None:
    tell = "signal.signal(2, lambda *_: (print('ends', flush=True), sys.exit(0)))"
    watch = Watch()
    watch.group.start("board", [*PYTHON, f"import signal, sys; {tell}; print('up'); signal.pause()"], ends_last=True)
    rescued(
        watch, tmp_path, f"{tell}; print('up'); signal.pause()", f"import sys; {tell}; print('set'); signal.pause()"
    )
    watch.until(lambda: ("board", "up") in watch.output and ("driver", "set") in watch.output)
    os.kill(watch.group.running()["driver"], signal.SIGKILL)
    watch.until(lambda: ("rescue of driver", "up") in watch.output and watch.output.count(("driver", "set")) == 2)
    watch.group.stop()
    assert [name for name, line in watch.output if line == "ends"] == ["driver", "rescue of driver", "board"]
