"""The audit file on the disk, and files of secrets."""

from __future__ import annotations

import json
import os
import resource
import stat
from pathlib import Path

import pytest

from scope_ui_bridge.adapters.secret_files import AuditFile, write_secret
from scope_ui_bridge.core.records import START, AuditError, verify


def lines(path: Path) -> list[str]:
    return path.read_text(encoding="utf-8").splitlines()


def test_records_are_chained_across_restarts(tmp_path: Path) -> None:
    path = tmp_path / "records" / "audit.jsonl"
    for number in range(2):
        audit = AuditFile(path)
        audit.append({"command": f"press:{number}", "who": "Operator 1"})
        audit.append({"command": "stop", "who": "É"})
        audit.close()
    assert verify(lines(path))[0] == 4
    assert [json.loads(line)["n"] for line in lines(path)] == [1, 2, 3, 4]
    assert json.loads(lines(path)[0])["previous"] == START
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_only_one_bridge_at_a_time_writes_an_audit_file(tmp_path: Path) -> None:
    """A second one, as of a replay in another ROS domain, would break the chain, and no bridge could start any more."""
    path = tmp_path / "audit.jsonl"
    first = AuditFile(path)
    first.append({"command": "press:1"})
    with pytest.raises(OSError, match="is written by another bridge"):
        AuditFile(path)
    first.append({"command": "press:2"})
    first.close()
    second = AuditFile(path)
    second.append({"command": "press:3"})
    second.close()
    assert verify(lines(path))[0] == 3


@pytest.mark.parametrize("damage", ["change", "remove", "swap", "cut"])
def test_damage_is_found_and_refused(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "audit.jsonl"
    audit = AuditFile(path)
    for number in range(4):
        audit.append({"command": f"press:{number}"})
    audit.close()
    text = lines(path)
    if damage == "change":
        text[1] = text[1].replace("press:1", "press:9")
    elif damage == "remove":
        del text[2]
    elif damage == "swap":
        text[1], text[2] = text[2], text[1]
    else:
        text[3] = text[3][:20]
    path.write_text("\n".join(text) + "\n", encoding="utf-8")
    with pytest.raises(AuditError, match=r"line [234]"):
        AuditFile(path)


def test_a_record_that_did_not_fit_on_the_disk_leaves_the_chain_whole(tmp_path: Path) -> None:
    path = tmp_path / "audit.jsonl"
    audit = AuditFile(path)
    audit.append({"command": "press:1"})
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    # Half of the next line fits, as on a disk that becomes full.
    resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 60, hard))
    try:
        for _ in range(2):
            with pytest.raises(OSError, match="File too large"):
                audit.append({"command": "press:2"})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    audit.append({"command": "press:3"})
    audit.close()
    assert verify(lines(path))[0] == 3
    assert [json.loads(line)["command"] for line in lines(path)] == ["press:1", "records lost", "press:3"]
    AuditFile(path).close()


def test_records_that_a_full_disk_loses_leave_a_line_with_their_number_and_times(tmp_path: Path) -> None:
    path = tmp_path / "audit.jsonl"
    audit = AuditFile(path)
    audit.append({"wall_s": 99.0, "command": "press:0"})
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 20, hard))
    try:
        for second in range(7):
            with pytest.raises(OSError, match="File too large"):
                audit.append({"wall_s": 100.0 + second, "command": f"press:{second}"})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    audit.append({"wall_s": 200.0, "command": "press:8"})
    audit.append({"wall_s": 201.0, "command": "press:9"})
    audit.close()
    found = [json.loads(line) for line in lines(path)]
    assert [entry["command"] for entry in found] == ["press:0", "records lost", "press:8", "press:9"]
    assert {key: found[1][key] for key in ("lost", "from_s", "until_s")} == {"lost": 7, "from_s": 100, "until_s": 106}
    assert verify(lines(path))[0] == 4


def test_what_was_lost_until_the_end_is_noted_at_the_end_or_in_the_log(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    for is_room in (True, False):
        path = tmp_path / f"audit_{is_room}.jsonl"
        audit = AuditFile(path)
        resource.setrlimit(resource.RLIMIT_FSIZE, (20, hard))
        try:
            with pytest.raises(OSError, match="File too large"):
                audit.append({"wall_s": 5.0, "command": "stop"})
            if not is_room:
                audit.close()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        audit.close()
        assert len(lines(path)) == is_room
    assert f"records lost and not noted in {path}: 1: " in caplog.text


def all_lines(path: Path) -> list[str]:
    """Return the lines of all files of a chain, the oldest first."""
    older = sorted(path.parent.glob(f"{path.name}.*"), key=lambda file: int(file.suffix[1:]))
    return [line for file in [*older, path] for line in lines(file)]


def test_a_full_audit_file_is_put_aside_whole_and_the_chain_goes_on(tmp_path: Path) -> None:
    path, wanted = tmp_path / "audit.jsonl", []
    for _ in range(3):  # runs of the bridge
        audit = AuditFile(path, 500)
        for _ in range(9):
            wanted.append(f"press:{len(wanted)}")
            audit.append({"command": wanted[-1], "who": "É"})
            assert path.stat().st_size < 500 + 200, "a line more than the bound at most"
        audit.close()
    older = sorted(path.parent.glob("audit.jsonl.*"), key=lambda file: int(file.suffix[1:]))
    assert [file.name for file in older] == [f"audit.jsonl.{number}" for number in range(1, len(older) + 1)]
    assert len(older) == 5
    for file in [*older, path]:
        assert file.read_bytes().endswith(b"\n"), "no line is split"
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert verify(all_lines(path))[0] == len(wanted)
    assert [json.loads(line)["command"] for line in all_lines(path)] == wanted, "none lost, in their order"


def test_who_has_put_an_audit_file_aside_still_owns_its_name(tmp_path: Path) -> None:
    path = tmp_path / "audit.jsonl"
    first = AuditFile(path, 100)
    for number in range(4):
        first.append({"command": f"press:{number}"})
        with pytest.raises(OSError, match="is written by another bridge"):
            AuditFile(path, 100)
    first.close()
    AuditFile(path, 100).close()


@pytest.mark.parametrize("when", ["before the new one", "before its first line"])
def test_a_power_cut_while_an_audit_file_is_put_aside_loses_and_repeats_nothing(tmp_path: Path, when: str) -> None:
    path = tmp_path / "audit.jsonl"
    audit = AuditFile(path)
    for number in range(2):
        audit.append({"command": f"press:{number}"})
    audit.close()
    path.with_name("audit.jsonl.1").hardlink_to(path)
    if when == "before its first line":
        path.unlink()
        path.touch()
    audit = AuditFile(path)
    audit.append({"command": "press:2"})
    audit.close()
    assert verify(all_lines(path))[0] == 3
    assert path.with_name("audit.jsonl.1").exists() == (when == "before its first line")


def test_where_a_full_audit_file_cannot_be_put_aside_it_grows_and_that_is_told_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "audit.jsonl"
    audit = AuditFile(path, 100)

    def link(*names: object) -> None:
        raise PermissionError(1, "no links here")

    with monkeypatch.context() as patched:
        patched.setattr(os, "link", link)
        for number in range(5):
            audit.append({"command": f"press:{number}"})
    assert [file.name for file in tmp_path.iterdir()] == ["audit.jsonl"]
    assert caplog.text.count("cannot be put aside, so it grows: [Errno 1] no links here") == 1
    audit.append({"command": "press:5"})
    audit.close()
    assert [len(lines(file)) for file in (path.with_name("audit.jsonl.1"), path)] == [5, 1]
    assert verify(all_lines(path))[0] == 6


def test_the_chain_goes_on_when_older_files_were_taken_to_an_archive(tmp_path: Path) -> None:
    path = tmp_path / "audit.jsonl"
    audit = AuditFile(path, 100)
    for number in range(4):
        audit.append({"command": f"press:{number}"})
    audit.close()
    for number in (1, 2):
        path.with_name(f"audit.jsonl.{number}").unlink()
    audit = AuditFile(path, 100)
    audit.append({"command": "press:4"})
    audit.close()
    assert [json.loads(line)["n"] for line in all_lines(path)] == [3, 4, 5]
    path.with_name("audit.jsonl.4").write_text("{}\n")
    path.write_text("")
    with pytest.raises(AuditError, match=r"the last line of .*audit.jsonl.4 is damaged"):
        AuditFile(path)


def test_the_token_file_is_for_its_owner_only_and_replaces_a_link(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.write_text("untouched")
    path = tmp_path / "state" / "token"
    path.parent.mkdir()
    path.symlink_to(elsewhere)
    write_secret(path, "abc")
    write_secret(path, "def")
    assert path.read_text() == "def\n"
    assert not path.is_symlink()
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert elsewhere.read_text() == "untouched"
