"""Refusals of bring_up before it starts anything."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.deadlines import wait_until

from icu_bringup.cli import bring_up, composed
from icu_common.adapters.configuration_folder import configuration_folder

pytestmark = pytest.mark.slow

CONFIG = Path(__file__).parents[4] / "config"
DEADLINE_S = 60.0


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--set", "recognition.rate_hz"], "error: --set recognition.rate_hz: PROGRAM.PARAMETER=VALUE is needed"),
        (["--set", "recognition=5"], "error: --set recognition=5: PROGRAM.PARAMETER=VALUE is needed"),
        (["--set", "recognition.rate_hz="], "error: --set recognition.rate_hz: a value is needed"),
        (["--set", "recognition.layout=[1"], "error: --set recognition: 'layout=[1': the value cannot be read"),
        (["--set", "mock_grbl.link=/tmp/b"], "error: --set mock_grbl.link=/tmp/b: mock_grbl is no node"),
        (["--set", "nobody.rate_hz=5"], "error: no program nobody; there are "),
        (["--only", "nobody"], "error: no program nobody; there are "),
        (
            ["--only", "camera", "--without", "camera"],
            "error: nothing is left to start: --only camera, --without camera",
        ),
        (["--profile", "replay", "--prepare"], "error: --prepare moves the machine; profile replay has none"),
        *((["--namespace", name], f"error: namespace {name}: ") for name in ("a b", "1bed", "a-b", "b\u00e4d", "a//b")),
        (["--namespace", "../../elsewhere"], "error: namespace ../../elsewhere: names of letters, digits and _"),
    ],
)
def test_what_names_no_setting_or_program_is_refused(
    given: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = ["--config", str(CONFIG), "--state", str(tmp_path / "state"), "--run-dir", str(tmp_path / "run")]
    monkeypatch.setattr("sys.argv", ["bring_up", *folders, *given])
    monkeypatch.setattr("signal.signal", lambda *_: None)  # the test keeps its own
    assert bring_up.main() == 2
    captured = capsys.readouterr()
    assert captured.err.startswith(said) and "started" not in captured.out


@pytest.mark.parametrize(
    "given",
    [
        ["--profile", "hardware"],
        ["--profile", "lab_2"],
        ["--set", "serial_driver.port=/dev/ttyACM0"],
        ["--without", "mock_grbl"],
        ["--only", "serial_driver"],
    ],
)
def test_no_machine_but_the_one_in_software_is_moved_without_anybody_at_the_page(
    given: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    config = shutil.copytree(CONFIG, tmp_path / "config")
    graph = (config / "graph.yaml").read_text()
    (config / "graph.yaml").write_text(
        graph.replace("  replay:\n    about", "  lab_2: {extends: hardware}\n  replay:\n    about", 1)
    )
    for side in ("left", "right"):
        shutil.copy(config / "cameras" / f"bench_{side}.yaml", config / "cameras" / f"{side}.yaml")
    folders = ["--config", str(config), "--state", str(tmp_path / "state"), "--run-dir", str(tmp_path / "run")]
    monkeypatch.setattr("sys.argv", ["bring_up", *folders, "--prepare", *given])
    monkeypatch.setattr("signal.signal", lambda *_: None)
    monkeypatch.setattr(bring_up.BringUp, "_run_programs", lambda *_: pytest.fail("started"))
    assert bring_up.main() == 2
    assert capsys.readouterr().err.startswith("error: --prepare moves the machine by itself")


def test_a_namespace_that_is_none_makes_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It names one below the state's folder, which is made for this user alone."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr("sys.argv", ["bring_up", "--config", str(CONFIG), "--namespace", "../../elsewhere"])
    monkeypatch.setattr("signal.signal", lambda *_: None)
    assert bring_up.main() == 2 and list(tmp_path.iterdir()) == []


def test_files_that_are_added_to_the_sources_configuration_are_found_without_a_new_build(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``colcon build --symlink-install`` links file by file; files added next to them, or taught, would not be
    there."""
    source, built = tmp_path / "config", tmp_path / "install" / "icu_bringup" / "share" / "icu_bringup" / "config"
    for folder in (source, built):
        folder.mkdir(parents=True)
    (source / "graph.yaml").write_text("programs: {}")
    (built / "graph.yaml").symlink_to(source / "graph.yaml")
    monkeypatch.delenv("ICU_CONFIG", raising=False)
    monkeypatch.setattr("sys.argv", [str(tmp_path / "install" / "icu_bringup" / "lib" / "icu_bringup" / "bring_up")])
    assert configuration_folder() == source.resolve()
    (built / "graph.yaml").unlink()
    (built / "graph.yaml").write_text("programs: {}")  # as without --symlink-install
    assert configuration_folder() == built.resolve()


@pytest.mark.parametrize("package", ["icu_bringup", "icu_simulator"])
def test_a_program_of_any_package_finds_the_configuration_next_to_its_own_folder(
    package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """colcon installs each package into a folder of its own: ``bench_render`` is in the simulator's."""
    built = tmp_path / "install" / "icu_bringup" / "share" / "icu_bringup" / "config"
    built.mkdir(parents=True)
    (built / "graph.yaml").write_text("programs: {}")
    for name in ("ICU_CONFIG", "AMENT_PREFIX_PATH"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.argv", [str(tmp_path / "install" / package / "lib" / package / "program")])
    assert configuration_folder() == built.resolve()


def test_a_configuration_that_is_named_and_not_there_is_not_replaced_by_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else a machine would run with the limits of the installed one."""
    built = tmp_path / "share" / "icu_bringup" / "config"
    built.mkdir(parents=True)
    (built / "graph.yaml").write_text("programs: {}")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    monkeypatch.setenv("ICU_CONFIG", str(tmp_path / "mine"))
    with pytest.raises(FileNotFoundError, match=rf"no graph.yaml in {tmp_path}/mine, which ICU_CONFIG names"):
        configuration_folder()


PROGRAM = """\
#!/bin/sh
trap 'echo "$0 ends" >> "$LOG"; exit 0' INT
trap 'echo "$0 is terminated" >> "$LOG"; exit 0' TERM
: > "$0 hears"
while true; do echo "error: still here"; sleep 0.1; done
"""
TWO = """\
scope: dial
profiles: {bench: {about: two programs}}
programs:
  board: {package: p, executable: board, ros: false, ends_last: true}
  driver: {package: p, executable: driver, ros: false}
"""


@pytest.fixture
def two(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start bring_up with two programs, a board and a driver, in a namespace of its own."""
    for folder in ("config/scopes", "lib/p", "tmp"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "config" / "graph.yaml").write_text(TWO)
    (tmp_path / "config" / "scopes" / "dial.yaml").touch()
    for name in ("board", "driver"):
        (tmp_path / "lib" / "p" / name).write_text(PROGRAM)
        (tmp_path / "lib" / "p" / name).chmod(0o755)
    environment = {**os.environ, "AMENT_PREFIX_PATH": str(tmp_path), "TMPDIR": str(tmp_path / "tmp")}
    environment |= {"LOG": str(tmp_path / "log"), "ROS_DOMAIN_ID": "7"}
    command = [sys.executable, "-m", "icu_bringup.cli.bring_up", "--config", str(tmp_path / "config")]
    command += ["--state", str(tmp_path / "state"), "--namespace", f"of_{os.getpid()}"]

    started: list[subprocess.Popen[str]] = []

    def start(*arguments: str, stdout: int = subprocess.PIPE) -> subprocess.Popen[str]:
        given, pipe = [*command, *arguments], subprocess.PIPE
        started.append(subprocess.Popen(given, env=environment, stdout=stdout, stderr=pipe, text=True))
        return started[-1]

    yield start
    for process in started:
        with process:
            process.terminate()


def until_it_runs(process: subprocess.Popen[str], *programs: str) -> None:
    """Wait until each of the programs has printed something, and handles signals by then."""
    assert process.stdout is not None
    silent = set(programs or ("board", "driver"))
    while silent:
        line = process.stdout.readline()
        assert line, "bring-up has ended"
        silent -= {line.partition(" | ")[0].strip()}


@pytest.mark.parametrize("how", ["the terminal is closed", "nobody reads its output any more"])
def test_bring_up_ends_every_program_in_order_when(
    how: str, tmp_path: Path, two: Callable[..., subprocess.Popen[str]]
) -> None:
    """A driver lifts the stylus while the board still answers, however bring-up comes to its end."""
    with two() as process:
        until_it_runs(process)
        if how == "the terminal is closed":
            process.send_signal(signal.SIGHUP)
        assert process.stdout is not None
        process.stdout.close()
        assert process.wait(DEADLINE_S) == 0
    ended = (tmp_path / "log").read_text().splitlines()
    assert ended == [f"{tmp_path}/lib/p/{name} ends" for name in ("driver", "board")]
    assert list((tmp_path / "tmp").iterdir()) == []


def test_bring_up_says_why_it_ends_on_a_full_disk(two: Callable[..., subprocess.Popen[str]]) -> None:
    with Path("/dev/full").open("w") as full, two(stdout=full.fileno()) as process:
        assert process.stderr is not None
        assert process.stderr.read() == "error: standard output: No space left on device; ending every program\n"
        assert process.wait(DEADLINE_S) == 1


PREPARED = """\
scope: dial
profiles: {bench: {about: a machine and its page}}
programs:
  mock_grbl: {package: p, executable: mock_grbl, ros: false, arguments: [/tmp/a board]}
  serial_driver: {package: p, executable: driver, set: {port: /tmp/a board}}
  ui_bridge: {package: p, executable: ui_bridge, ros: false}
"""


def _with_preparation(folder: Path) -> None:
    """Add the programs of PREPARED, and a preparation that succeeds at once."""
    (folder / "config" / "graph.yaml").write_text(PREPARED)
    (folder / "lib" / "gantry_driver").mkdir()
    for name in ("p/mock_grbl", "p/ui_bridge", "gantry_driver/gantry_prepare"):
        shutil.copy(folder / "lib" / "p" / "driver", folder / "lib" / name)
    (folder / "lib" / "gantry_driver" / "gantry_prepare").write_text("#!/bin/sh\n")


def test_preparation_begins_while_a_program_waits_for_its_device(
    tmp_path: Path, two: Callable[..., subprocess.Popen[str]]
) -> None:
    _with_preparation(tmp_path)
    with (tmp_path / "config" / "graph.yaml").open("a") as graph:
        graph.write(f"  camera: {{package: p, executable: driver, waits_for: {tmp_path}/frames}}\n")
    with two("--prepare") as process:
        assert process.stdout is not None
        first = next(line for line in process.stdout if line.startswith(("Ready.", "started")))
        (tmp_path / "frames").touch()
        started = next(line for line in process.stdout if line.startswith("started"))
        process.terminate()
        process.stdout.read()
    assert first.startswith("Ready.") and started == "started 4 programs of the profile bench\n"


@pytest.mark.parametrize("without", [(), ("--without", "ui_bridge")])
def test_a_page_that_is_not_started_is_not_to_be_opened(
    without: tuple[str, ...], tmp_path: Path, two: Callable[..., subprocess.Popen[str]]
) -> None:
    _with_preparation(tmp_path)
    with two("--prepare", *without) as process:
        assert process.stdout is not None
        ready = next(line for line in process.stdout if line.startswith("Ready."))
        process.terminate()
        process.stdout.read()
    assert ready == ("Ready.\n" if without else "Ready. Open the operator page\n")


TALKATIVE = """\
#!/bin/sh
trap 'echo "$0 ends" >> "$LOG"; exit 0' INT
line=$(head -c 20000 /dev/zero | tr '\\0' x)
for _ in $(seq 30); do echo "error: $line"; done
echo "$0 has said all" >> "$LOG"
while true; do sleep 0.1; done
"""


def test_programs_go_on_and_end_while_the_terminal_takes_no_output(
    tmp_path: Path, two: Callable[..., subprocess.Popen[str]]
) -> None:
    """After Control-S no terminal read their output; a driver that waits for that reports its position to no
    program."""
    (tmp_path / "lib" / "p" / "driver").write_text(TALKATIVE)
    log = tmp_path / "log"
    board = tmp_path / "lib" / "p" / "board hears"
    with two() as process:  # whose output is not read before it has ended

        def written() -> bool:
            assert process.poll() is None
            return log.exists() and "driver has said all" in log.read_text() and board.exists()

        wait_until(written, "the driver has written all its output", DEADLINE_S)
        process.send_signal(signal.SIGINT)
        assert process.wait(DEADLINE_S) == 0
    ended = log.read_text().splitlines()[1:]
    assert ended == [f"{tmp_path}/lib/p/{name} ends" for name in ("driver", "board")]


def test_a_second_graph_under_the_same_names_is_refused(two: Callable[..., subprocess.Popen[str]]) -> None:
    """A demo next to a real machine would enable it, home it and send it goals: the topics are the same."""
    with two() as first:
        until_it_runs(first)
        for more in ([], ["--without", "board"]):
            output, error = two(*more).communicate(timeout=DEADLINE_S)
            assert "started" not in output and "a graph of these names runs already in ROS domain 7:" in error
        for beside, programs in ((["--only", "driver"], ["driver"]), (["--namespace", f"beside_{os.getpid()}"], [])):
            with two(*beside) as other:
                until_it_runs(other, *programs)
                other.send_signal(signal.SIGINT)
                other.communicate(timeout=DEADLINE_S)
                assert other.returncode == 0
        first.send_signal(signal.SIGINT)
        first.communicate(timeout=DEADLINE_S)
    with two() as again:
        until_it_runs(again)
        again.send_signal(signal.SIGINT)
        again.communicate(timeout=DEADLINE_S)


def test_folders_below_the_home_may_be_named_as_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A shell leaves the ~ of ``--state=~/robot`` alone; page_admin and ros2 launch know it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "home" / "config").mkdir(parents=True)
    (tmp_path / "home" / "config" / "graph.yaml").write_text("profiles: 5")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    given = ["--config=~/config", "--state=~/robot", "--run-dir=~/run"]
    monkeypatch.setattr("sys.argv", ["bring_up", *given])
    monkeypatch.setattr("signal.signal", lambda *_: None)
    assert bring_up.main() == 2 and "graph.yaml: scope is missing" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["home"]
    assert sorted(path.name for path in (tmp_path / "home").iterdir()) == ["config", "robot", "run"]


def test_a_folder_for_the_state_that_is_there_keeps_its_rights(tmp_path: Path) -> None:
    shared, fresh = tmp_path / "shared", tmp_path / "fresh"
    shared.mkdir(mode=0o755)
    assert bring_up.state_folder(shared) == shared and shared.stat().st_mode & 0o777 == 0o755
    assert bring_up.state_folder(fresh) == fresh and fresh.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("text", [None, "hello", '{"corners": 1}', '["corners"]', "[5]"])
def test_composed_refuses_what_is_no_table(
    text: str | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if text is not None:
        (tmp_path / "table.json").write_text(text)
    assert composed.main([str(tmp_path / "table.json")]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"error: {tmp_path / 'table.json'}: ") and error.count("\n") == 1
