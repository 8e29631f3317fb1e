"""Checks English and spelling of documents, docstrings and comments: ``python -m prose.check [FILE ...]``."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from prose.rules import GERMAN, Rules, load

ROOT = Path(__file__).resolve().parents[2]


def misspelt(paths: Sequence[Path], ignored: Sequence[str]) -> str:
    """Return what codespell finds in files: file:line: word ==> correction."""
    command = [sys.executable, "-m", "codespell_lib", "--config", "/dev/null", "--ignore-words-list", ",".join(ignored)]
    result = subprocess.run([*command, *map(str, paths)], capture_output=True, text=True, check=False)
    if result.returncode not in (0, 65):
        raise RuntimeError(f"codespell ended with {result.returncode}: {result.stderr.strip()}")
    return result.stdout.replace(f"{ROOT}/", "").strip()


def files(rules: Rules) -> list[Path]:
    """Return all files that are checked."""
    return [path for kind in rules.kinds for path in kind.paths(ROOT)]


def english(paths: Sequence[Path]) -> list[Path]:
    """Return the files whose spelling is checked: codespell has no German dictionary."""
    return [path for path in paths if path.name != GERMAN]


def main(arguments: Sequence[str]) -> int:
    """Print each finding; return 1 if there is any, else 0."""
    rules = load()
    paths = [Path(name).resolve() for name in arguments] or files(rules)
    findings = [finding for path in paths for finding in rules.of_file(path, ROOT)]
    for finding in findings:
        print(finding)
    spelling = misspelt(english(paths), rules.spelling)
    if spelling:
        print(spelling)
    if findings or spelling:
        misspelt_words = len(spelling.splitlines())
        print(f"prose: {len(findings)} findings, {misspelt_words} misspelt words; rules: tests/prose/rules.toml")
    return 1 if findings or spelling else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
