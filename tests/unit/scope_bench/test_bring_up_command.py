"""What bring_up refuses before it starts anything."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from scope_bench.cli import bring_up

CONFIG = Path(__file__).parents[3] / "config"


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
        (["--profile", "replay", "--prepare"], "error: --prepare moves the machine; profile replay has none"),
        *(
            (["--namespace", name], f"error: --namespace {name}: ")
            for name in ("a b", "1bed", "a-b", "b\u00e4d", "a//b")
        ),
        (["--namespace", "../../elsewhere"], "error: --namespace ../../elsewhere: names of letters, digits and _"),
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


def test_a_namespace_that_is_none_makes_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It names one below the state's folder, which is made for this user alone."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr("sys.argv", ["bring_up", "--config", str(CONFIG), "--namespace", "../../elsewhere"])
    monkeypatch.setattr("signal.signal", lambda *_: None)
    assert bring_up.main() == 2 and list(tmp_path.iterdir()) == []


def test_files_that_are_added_to_the_sources_configuration_are_found_without_a_new_build(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``colcon build --symlink-install`` links file by file; what is put beside them, or taught, would not be there."""
    source, built = tmp_path / "config", tmp_path / "install" / "scope_bench" / "share" / "scope_bench" / "config"
    for folder in (source, built):
        folder.mkdir(parents=True)
    (source / "graph.yaml").write_text("programs: {}")
    (built / "graph.yaml").symlink_to(source / "graph.yaml")
    monkeypatch.delenv("ICU_CONFIG", raising=False)
    monkeypatch.setattr("sys.argv", [str(tmp_path / "install" / "scope_bench" / "lib" / "scope_bench" / "bring_up")])
    assert bring_up.configuration_folder() == source.resolve()
    (built / "graph.yaml").unlink()
    (built / "graph.yaml").write_text("programs: {}")  # as without --symlink-install
    assert bring_up.configuration_folder() == built.resolve()


PROGRAM = """\
#!/bin/sh
trap 'echo "$0 ends" >> "$LOG"; exit 0' INT
trap 'echo "$0 is terminated" >> "$LOG"; exit 0' TERM
while true; do echo "error: still here"; sleep 0.1; done
"""
TWO = """\
scope: dial
profiles: {bench: {about: two programs}}
programs:
  board: {package: p, executable: board, ros: false, ends_last: true}
  driver: {package: p, executable: driver, ros: false}
"""


@pytest.mark.parametrize("how", ["the terminal is closed", "nobody reads its output any more"])
def test_bring_up_ends_every_program_in_order_when(how: str, tmp_path: Path) -> None:
    """A driver lifts the stylus while the board still answers, however bring-up comes to its end."""
    for folder in ("config/scopes", "lib/p", "tmp"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "config" / "graph.yaml").write_text(TWO)
    (tmp_path / "config" / "scopes" / "dial.yaml").touch()
    for name in ("board", "driver"):
        (tmp_path / "lib" / "p" / name).write_text(PROGRAM)
        (tmp_path / "lib" / "p" / name).chmod(0o755)
    environment = {**os.environ, "AMENT_PREFIX_PATH": str(tmp_path), "TMPDIR": str(tmp_path / "tmp")}
    command = [sys.executable, "-m", "scope_bench.cli.bring_up", "--config", str(tmp_path / "config")]
    with subprocess.Popen(
        [*command, "--state", str(tmp_path / "state")],
        env=environment | {"LOG": str(tmp_path / "log")},
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        while "driver | error: still here" not in process.stdout.readline():
            assert process.poll() is None
        if how == "the terminal is closed":
            process.send_signal(signal.SIGHUP)
        process.stdout.close()
        assert process.wait(20.0) == 0
    ended = (tmp_path / "log").read_text().splitlines()
    assert ended == [f"{tmp_path}/lib/p/{name} ends" for name in ("driver", "board")]
    assert list((tmp_path / "tmp").iterdir()) == []
