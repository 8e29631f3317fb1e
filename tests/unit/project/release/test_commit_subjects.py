"""The check of commit subjects: the form, and what is checked in full, shallow and missing repositories."""

from __future__ import annotations

import runpy
import subprocess
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[4]
CHECK: dict[str, Any] = runpy.run_path(str(ROOT / "scripts" / "checks" / "commit_subjects.py"))
UNKNOWN = "0" * 40


@pytest.mark.parametrize(
    "subject",
    [
        "driver: Stop before the wire is closed",
        "controller, hand-eye: Expect the scatter of webcams",
        "docs: Process `make figures` in CI",
        "camera: Focus on the panel",
        "tests: 3 runs are enough",
    ],
)
def test_good_subjects_pass(subject: str) -> None:
    assert CHECK["fault"](subject) == ""


@pytest.mark.parametrize(
    ("subject", "text"),
    [
        ("WIP 3", "expected area: Imperative summary"),
        ("driver: stop", "expected area: Imperative summary"),
        ("Driver: Stop", "expected area: Imperative summary"),
        ("driver: Stop the wire.", "expected area: Imperative summary"),
        ("driver: Stopped the wire", "'Stopped' is no imperative"),
        ("driver: Stops the wire", "'Stops' is no imperative"),
        ("driver: Stopping the wire", "'Stopping' is no imperative"),
        ("driver: " + "Stop " * 14, "78 characters, limit 72"),
    ],
)
def test_other_subjects_have_a_reason(subject: str, text: str) -> None:
    assert CHECK["fault"](subject) == text


def git(folder: Path, *arguments: str) -> str:
    """Run git in a folder without the user's settings."""
    options = ["-c", "user.name=A", "-c", "user.email=a@example.org", "-c", "init.defaultBranch=main"]
    command = ["git", *options, *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=60, check=True).stdout.strip()


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    folder = tmp_path / "project"
    folder.mkdir()
    git(folder, "init", "-q")
    for subject in ("old and wrong", "base: Begin", "driver: Add a stop", "bad one"):
        git(folder, "commit", "-q", "--allow-empty", "-m", subject)
    return folder


def checked(folder: Path, recorded: str) -> list[str] | None:
    found = CHECK["subjects"](folder, recorded)
    return None if found is None else [subject for _, subject in found]


def test_commits_after_the_base_are_checked(repository: Path) -> None:
    base = git(repository, "rev-parse", "HEAD~2")
    assert checked(repository, f"{base} 2001-01-01T00:00:00+00:00") == ["bad one", "driver: Add a stop"]


def test_commits_after_the_last_release_are_checked(repository: Path) -> None:
    git(repository, "tag", "v1.0.0", "HEAD~1")
    base = git(repository, "rev-parse", "HEAD~2")
    assert checked(repository, f"{base} 2001-01-01T00:00:00+00:00") == ["bad one"]


def test_a_checkout_without_the_base_is_checked_by_its_date(repository: Path, tmp_path: Path) -> None:
    git(tmp_path, "clone", "-q", "--depth", "2", f"file://{repository}", "shallow")
    shallow = tmp_path / "shallow"
    assert checked(shallow, f"{UNKNOWN} 2001-01-01T00:00:00+00:00") == ["bad one", "driver: Add a stop"]
    assert checked(shallow, f"{UNKNOWN} 2090-01-01T00:00:00+00:00") == []


def test_without_a_repository_nothing_is_checked(repository: Path, tmp_path: Path) -> None:
    recorded = f"{UNKNOWN} 2001-01-01T00:00:00+00:00"
    (tmp_path / "copy").mkdir()
    assert checked(tmp_path / "copy", recorded) is None
    (repository / "export").mkdir()
    assert checked(repository / "export", recorded) is None, "a copy inside of another project's repository"


def test_make_check_and_contributing_have_the_check() -> None:
    assert "scripts/checks/commit_subjects.py" in (ROOT / "Makefile").read_text()
    assert "`area: Imperative summary`" in (ROOT / "CONTRIBUTING.md").read_text()
    commit, date = (ROOT / "scripts/checks/commit_base.txt").read_text().split()
    assert len(commit) == 40 and date.startswith("20")
