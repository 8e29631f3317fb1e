"""mkdocs.yml: the navigation lists every document once, and every package has API pages.

`make docs` builds the site strictly; these tests need no site generator.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[4]
SETTINGS = (ROOT / "mkdocs.yml").read_text()


def test_navigation_lists_every_document_once() -> None:
    listed = Counter(re.findall(r"[\w/.-]+\.md\b", SETTINGS.partition("\nnav:\n")[2]))
    there = {path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")}
    assert there - listed.keys() == set(), "add them to nav in mkdocs.yml"
    assert listed.keys() - there == set(), "nav names pages that are not there"
    assert [name for name, count in listed.items() if count > 1] == []


def test_api_pages_are_made_of_every_package() -> None:
    paths = re.search(r"paths: \[([^\]]+)\]", SETTINGS)
    assert paths
    assert sorted(paths[1].split(", ")) == sorted(f"src/{p.parent.name}" for p in ROOT.glob("src/*/package.xml"))


def test_site_is_strict_and_loads_nothing_from_the_network() -> None:
    called = re.search(r"mkdocs build (.*)", (ROOT / "Makefile").read_text())
    assert called and "--strict" in called[1] and "quiet" not in called[1], "a quiet build counts no warnings"
    assert "font: false" in SETTINGS and "- offline" in SETTINGS
    validation = re.search(r"^validation:\n((?: .*\n)+)", SETTINGS, re.MULTILINE)
    assert validation and validation[1].count("warn") == 7 and "ignore" not in validation[1]
    assert not re.findall(r"https?://", SETTINGS)


def test_demo_does_not_install_the_generator() -> None:
    for name in ("requirements.txt", "requirements-python.txt", "requirements-dev.txt"):
        assert "mkdocs" not in (ROOT / name).read_text()
    setup = (ROOT / "scripts" / "setup.sh").read_text()
    assert re.findall(r"^.*requirements-docs.*$", setup, re.MULTILINE) == [
        '  docs) wait_for install requirements-docs.txt "generator of the documents\' site" ;;'
    ]
