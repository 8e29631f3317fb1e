"""Tests of recording from the page: the answers are true, and no end comes too early for the program."""

from __future__ import annotations

import asyncio
import contextlib
import os
import queue
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.deadlines import wait_until
from unit.scope_ui_bridge import web_rig

from scope_ui_bridge.adapters.graph_port import GraphUnavailable
from scope_ui_bridge.adapters.recorder import Recorder

pytestmark = pytest.mark.slow

WITHIN_S = 20.0
# Like bag_record: slow to start (here until a program opens the fifo), then it reports it, and ends by SIGINT.
PROGRAM = """#!{python}
import pathlib, signal, sys
here = pathlib.Path(__file__).parent
(here / "gate").read_text()
signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
print("recording", flush=True)
signal.sigwait([signal.SIGINT])
pathlib.Path(sys.argv[2]).write_text("whole")
print(sys.argv[2] + ": 7 messages")
"""


def made(path: Path, script: str) -> Path:
    """Write a program."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(script)
    path.chmod(0o755)
    return path


@pytest.fixture
def program(tmp_path: Path) -> Path:
    os.mkfifo(tmp_path / "gate")
    return made(tmp_path / "record", PROGRAM.format(python=sys.executable))


def test_an_end_that_is_asked_before_the_program_listens_still_leaves_a_whole_bag(program: Path) -> None:
    answers: queue.Queue[tuple[str, bool, str]] = queue.Queue()
    recorder = Recorder(str(program.parent / "sessions"), program)
    recorder.start(lambda ok, text: answers.put(("start", ok, text)))
    with pytest.raises(GraphUnavailable, match="already recording to"):
        recorder.start(lambda ok, text: None)
    recorder.end(lambda ok, text: answers.put(("end", ok, text)))
    with pytest.raises(GraphUnavailable, match="bag_record already finishes"):
        recorder.end(lambda ok, text: None)
    assert answers.empty(), "it neither records nor has it ended"
    (program.parent / "gate").write_text("go")
    what, ok, text = answers.get(timeout=WITHIN_S)
    assert (what, ok) == ("start", True)
    bag = Path(text.removeprefix("recording to "))
    assert answers.get(timeout=WITHIN_S) == ("end", True, f"recorded to {bag}: 7 messages")
    assert bag.read_text() == "whole"
    with pytest.raises(GraphUnavailable, match="no recording is running"):
        recorder.end(lambda ok, text: None)
    recorder.close()


def test_nothing_is_computed_for_a_recording_that_the_page_does_not_show(tmp_path: Path) -> None:
    """Results from the images that a reader requests can be made from a recording's."""
    script = "import pathlib, sys; pathlib.Path(sys.argv[2] + '.said').write_text('\\n'.join(sys.argv))"
    record = made(tmp_path / "record", f"#!{sys.executable}\n{script}\n")
    answers: queue.Queue[str] = queue.Queue()
    recorder = Recorder(str(tmp_path / "sessions"), record)
    recorder.start(lambda ok, text: answers.put(text))
    assert answers.get(timeout=WITHIN_S) == "bag_record ended with 0"
    (said,) = (tmp_path / "sessions").glob("*.said")
    arguments = said.read_text().splitlines()
    left_out = arguments[arguments.index("--exclude") + 1]
    eyes = [f"{bed}/stereo/{side}" for bed in ("", "/bed_1") for side in ("left", "right")]
    computed = ["/stereo/disparity", "/bed_1/stereo/dense_points", "/stereo/points2", "/panel/points"]
    computed += [f"{eye}/{name}" for eye in eyes for name in ("corners_image", "edges")]
    shown = ["/panel/pose", "/panel/controls", "/gantry/trajectory", "/stylus/tip", "/bed_1/joint_states"]
    shown += [f"{eye}/{name}" for eye in eyes for name in ("image_raw", "camera_info", "corners", "edge_lines")]
    assert [name for name in computed if not re.search(left_out, name)] == []
    assert [name for name in shown if re.search(left_out, name)] == []


def test_a_recording_is_scheduled_as_ordinary_programs_are(tmp_path: Path) -> None:
    """It compresses pictures for as long as it runs, and would hold up all others if it came first."""
    # It is started with its parent's scheduling, which changes at once, but not before it may run.
    script = f"""import os, time
end = time.monotonic() + {WITHIN_S / 2}
while os.sched_getscheduler(0) != os.SCHED_OTHER and time.monotonic() < end:
    time.sleep(0.01)
os.write(2, str(os.sched_getscheduler(0)).encode())"""
    record = made(tmp_path / "record", f"#!{sys.executable}\n{script}\n")
    code = f"""import os, pathlib, queue, sys
from icu_common.adapters.real_time import BRIDGE, ask_for_real_time
from scope_ui_bridge.adapters.recorder import Recorder
said = queue.Queue()
refusal = ask_for_real_time(BRIDGE)
Recorder({str(tmp_path / "sessions")!r}, pathlib.Path({str(record)!r})).start(lambda ok, text: said.put(text))
print(refusal or os.sched_getscheduler(0) == os.SCHED_RR, said.get(timeout={WITHIN_S}))"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, input="", timeout=2 * WITHIN_S)
    assert done.stderr == str(int(os.SCHED_OTHER)), done
    assert re.match("True bag_record ended with 0|real-time scheduling is not allowed", done.stdout), done


# The first one ends at once; its child keeps its output open until a program opens the fifo.
LEFT_BEHIND = """#!{python}
import os, pathlib, sys
here = pathlib.Path(__file__).parent
if not (here / "ran").exists():
    (here / "ran").touch()
    if os.fork() == 0:
        (here / "gate").read_text()
    os._exit(1)
os.execv(here / "second", sys.argv)
"""


def test_one_that_failed_and_is_noticed_late_hides_no_recording_that_runs(tmp_path: Path) -> None:
    """A person in view of the cameras must be able to know it, and the user who started it must be able to end it."""
    os.mkfifo(tmp_path / "gate")
    made(tmp_path / "second", PROGRAM.format(python=sys.executable).replace('(here / "gate").read_text()', ""))
    program = made(tmp_path / "record", LEFT_BEHIND.format(python=sys.executable))
    answers: queue.Queue[tuple[str, bool]] = queue.Queue()
    recorder = Recorder(str(tmp_path / "sessions"), program)
    recorder.start(lambda ok, text: answers.put(("first", ok)), "Anna")

    def answered() -> bool:
        with contextlib.suppress(GraphUnavailable):  # while the first one's program runs
            recorder.start(lambda ok, text: answers.put(("second", ok)), "Bert")
        return not answers.empty()

    wait_until(answered, "the second recording starts", WITHIN_S)
    assert answers.get() == ("second", True)
    (tmp_path / "gate").write_text("go")
    assert answers.get(timeout=WITHIN_S) == ("first", False)
    assert recorder.recording is not None and recorder.recording[0] == "Bert"
    recorder.end(lambda ok, text: answers.put(("end", ok)))
    assert answers.get(timeout=WITHIN_S) == ("end", True)
    recorder.close()


@pytest.mark.parametrize("one_prefix", [False, True])
def test_the_recorder_is_found_beside_the_bridge(
    one_prefix: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    install = tmp_path / "install"
    prefixes = [install if one_prefix else install / package for package in ("scope_ui_bridge", "icu_bringup")]
    bridge = prefixes[0] / "lib" / "scope_ui_bridge" / "ui_bridge"
    bridge.parent.mkdir(parents=True)
    monkeypatch.setattr(sys, "argv", [str(bridge)])
    recorder = Recorder(str(tmp_path / "sessions"))
    with pytest.raises(GraphUnavailable, match="this program's folder has no bag_record"):
        recorder.start(lambda ok, text: None)
    made(prefixes[1] / "lib" / "icu_bringup" / "bag_record", "#!/bin/sh\necho recording\n")
    answers: queue.Queue[bool] = queue.Queue()
    recorder.start(lambda ok, text: answers.put(ok))
    assert answers.get(timeout=WITHIN_S)
    recorder.close()


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ("", "bag_record ended with 2"),
        (
            "a warning\nerror: the disk is full: 3 MB are free\n",
            "bag_record ended with 2; the disk is full: 3 MB are free",
        ),
    ],
)
def test_why_nothing_can_be_recorded_is_told(
    said: str, why: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    program = made(tmp_path / "record", f"#!/bin/sh\nprintf '{said}' >&2\nexit 2\n")
    answers: queue.Queue[tuple[bool, str]] = queue.Queue()
    recorder = Recorder(str(tmp_path / "sessions"), program)
    recorder.start(lambda ok, text: answers.put((ok, text)))
    assert answers.get(timeout=WITHIN_S) == (False, why)
    recorder.close()
    assert capfd.readouterr().err == said, "the log has it, too"


def test_a_recording_with_losses_is_a_bag_with_the_number_of_them(tmp_path: Path) -> None:
    end = 'echo "$2: 7 messages, 0.1 MB, 2 dropped"\nexit 3\n'
    program = made(tmp_path / "record", f"#!/bin/sh\necho recording\n{end}")
    answers: queue.Queue[tuple[bool, str]] = queue.Queue()
    recorder = Recorder(str(tmp_path / "sessions"), program, ended=lambda ok, text: answers.put((ok, text)))
    recorder.start(lambda ok, text: answers.put((ok, text)))
    bag = answers.get(timeout=WITHIN_S)[1].removeprefix("recording to ")
    assert answers.get(timeout=WITHIN_S) == (True, f"recorded to {bag}: 7 messages, 0.1 MB, 2 dropped")
    recorder.close()


def test_a_recording_that_ends_by_itself_is_told(tmp_path: Path) -> None:
    end = "echo 'session: 7 messages'\necho 'error: the recording has ended: the disk is full' >&2\nexit 1\n"
    program = made(tmp_path / "record", f"#!/bin/sh\necho recording\n{end}")
    answers: queue.Queue[tuple[str, bool, str]] = queue.Queue()
    recorder = Recorder(
        str(tmp_path / "sessions"), program, ended=lambda ok, text: answers.put(("ended by itself", ok, text))
    )
    recorder.start(lambda ok, text: answers.put(("start", ok, text)))
    assert answers.get(timeout=WITHIN_S)[:2] == ("start", True)
    why = "bag_record ended with 1; session: 7 messages; the recording has ended: the disk is full"
    assert answers.get(timeout=WITHIN_S) == ("ended by itself", False, why)
    recorder.close()


def test_every_page_sees_that_a_recording_has_ended_by_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = "#!/bin/sh\necho recording\necho 'error: the disk is full' >&2\nexit 1\n"
    made(tmp_path / "install" / "lib" / "icu_bringup" / "bag_record", script)
    monkeypatch.setattr(sys, "argv", [str(tmp_path / "install" / "lib" / "scope_ui_bridge" / "ui_bridge")])

    async def scenario(rig: web_rig.Rig) -> None:
        async with web_rig.page(rig, take=True) as operator, web_rig.page(rig) as other:
            await operator.send(type="call", service="record")
            for page in (operator, other):
                ended = await page.until(lambda m: m["type"] == "log" and m["entry"]["who"] == "bag_record")
                assert ended["entry"]["status"] == "failed"
                assert ended["entry"]["reason"]["text"] == "bag_record ended with 1; the disk is full"

    with web_rig.Rig(record_folder=str(tmp_path / "sessions")) as rig:
        asyncio.run(scenario(rig))


def test_every_page_is_told_who_records_and_for_how_long(program: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def scenario(rig: web_rig.Rig) -> None:
        monkeypatch.setattr(rig.server.recorder, "_program", program)
        async with web_rig.page(rig, take=True) as operator, web_rig.page(rig) as watcher:
            assert watcher.hello["recordings"] == []
            begin_s = time.monotonic()
            await operator.send(type="call", service="record")
            assert rig.server.recorder.recording is None
            (program.parent / "gate").write_text("go")
            for page in (operator, watcher):
                (told,) = (await page.until(lambda m: m["type"] == "recordings"))["recordings"]
                assert (told["who"], told["program"], told["at_least"]) == ("Operator 1", "", False)
                assert 0 <= told["for_s"] < time.monotonic() - begin_s + 1
            await watcher.until(lambda m: m["type"] == "recordings" and m["recordings"][0]["for_s"] > told["for_s"])
            async with web_rig.page(rig) as late:
                assert late.hello["recordings"][0]["who"] == "Operator 1"
            await operator.send(type="call", service="end_record")
            for page in (operator, watcher):
                await page.until(lambda m: m["type"] == "recordings" and not m["recordings"])

    with web_rig.Rig(record_folder=str(program.parent / "sessions")) as rig:
        asyncio.run(scenario(rig))


def test_a_recording_that_does_not_end_with_the_bridge_is_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    program = made(tmp_path / "record", "#!/bin/sh\ntrap '' INT\necho recording\nexec tail -f /dev/null\n")
    began: queue.Queue[bool] = queue.Queue()
    recorder = Recorder(str(tmp_path / "sessions"), program, end_s=0.1)
    recorder.start(lambda ok, text: began.put(ok))
    assert began.get(timeout=WITHIN_S)
    recorder.close()
    assert "was cut off; save it with: bag_info" in caplog.text


def test_recordings_that_begin_in_the_same_second_go_to_folders_of_their_own(tmp_path: Path) -> None:
    program = made(tmp_path / "record", "#!/bin/sh\necho recording\n")
    recorder = Recorder(str(tmp_path / "sessions"), program)
    answers: queue.Queue[str] = queue.Queue()
    folders = set()
    for _ in range(5):
        recorder.start(lambda ok, text: answers.put(text))
        folders.add(answers.get(timeout=WITHIN_S))
        recorder.close()
    assert len(folders) == 5
