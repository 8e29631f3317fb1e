"""Check the subjects of commits: ``area: Imperative summary``, at most 72 characters.

Checked are the commits since the last tag ``v*``, or else since the base that ``commit_base.txt`` records. Merges are
left out, and so is everything before: its commits stay as they are. A checkout without the base (a shallow clone) is
checked by the date of the base. Without git, or outside of a repository, there is nothing to check.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BASE_FILE = Path(__file__).with_name("commit_base.txt")
LONGEST = 72
FORM = re.compile(r"[a-z0-9][\w.,/ -]*: [A-Z0-9`\"][^\n]*[^.\s]")
"""An area in small letters, a colon, and a summary that begins with a capital and ends without a full stop."""
_NOT_IMPERATIVE = re.compile(r"[A-Z][a-z]+(?:ed|ing|[^s]s)\b")
_IMPERATIVE = frozenset(["Alias", "Bring", "Embed", "Exceed", "Feed", "Focus", "Need", "Proceed", "Seed", "Speed"])


def fault(subject: str) -> str:
    """Return what is wrong with a subject; empty if nothing is.

    Examples
    --------
    >>> fault("driver: Stop before the wire is closed")
    ''
    >>> fault("driver: stopped")
    'expected area: Imperative summary'
    """
    if len(subject) > LONGEST:
        return f"{len(subject)} characters, limit {LONGEST}"
    if not FORM.fullmatch(subject):
        return "expected area: Imperative summary"
    first = subject.partition(": ")[2].split()[0]
    if _NOT_IMPERATIVE.fullmatch(first) and first not in _IMPERATIVE:
        return f"{first!r} is no imperative"
    return ""


def git(*arguments: str, root: Path = ROOT) -> str | None:
    """Return the output of git; None if git is missing or fails."""
    try:
        done = subprocess.run(["git", *arguments], cwd=root, capture_output=True, text=True, timeout=60, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def subjects(root: Path = ROOT, recorded: str | None = None) -> list[tuple[str, str]] | None:
    """Return hash and subject of the commits to check; None outside of a repository of this project.

    ``recorded`` is the text of the base file: hash and ISO date.
    """
    top = git("rev-parse", "--show-toplevel", root=root)
    if top is None or Path(top).resolve() != root.resolve() or git("rev-parse", "HEAD", root=root) is None:
        return None
    base, date = (BASE_FILE.read_text(encoding="ascii") if recorded is None else recorded).split()[:2]
    tag = git("describe", "--tags", "--match", "v*", "--abbrev=0", root=root)
    chosen = tag or (base if git("merge-base", "--is-ancestor", base, "HEAD", root=root) is not None else None)
    limits = [f"{chosen}..HEAD"] if chosen else ["HEAD", f"--since={date}"]
    log = git("log", "--no-merges", "--format=%h %s", *limits, root=root)
    return [(line.partition(" ")[0], line.partition(" ")[2]) for line in (log or "").splitlines()]


def main() -> int:
    """Print each faulty subject; 1 if there is one."""
    checked = subjects()
    if checked is None:
        print("commit subjects: no git repository, nothing to check")
        return 0
    faults = [(commit, subject, fault(subject)) for commit, subject in checked]
    wrong = [(commit, subject, text) for commit, subject, text in faults if text]
    for commit, subject, text in wrong:
        print(f"commit {commit} {subject!r}: {text}", file=sys.stderr)
    if wrong:
        print(
            "see CONTRIBUTING.md; git commit --amend, or git rebase --interactive, changes a subject", file=sys.stderr
        )
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
