"""Files of a release: one version, a changelog in the usual form, licences, declarations, and the same checks."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[4]
PACKAGES = sorted(path.parent for path in ROOT.glob("src/*/package.xml"))
VERSION = (ROOT / "VERSION").read_text().strip()
KINDS = ("Added", "Changed", "Deprecated", "Removed", "Fixed", "Security")
each_package = pytest.mark.parametrize("package", PACKAGES, ids=lambda p: p.name)


@each_package
def test_version_has_one_place(package: Path) -> None:
    """After a change of VERSION: python scripts/release/set_version.py."""
    assert f"<version>{VERSION}</version>" in (package / "package.xml").read_text()
    setup = (package / "setup.py").read_text()
    assert "version=VERSION," in setup and VERSION not in setup
    assert f"Version {VERSION}." in (ROOT / "README.md").read_text()


def test_changelog_has_the_form_of_keep_a_changelog() -> None:
    text = (ROOT / "CHANGELOG.md").read_text()
    headings = re.findall(r"^## (.+)$", text, re.MULTILINE)
    assert headings[0] == "[Unreleased]" and headings[1].startswith(f"[{VERSION}] - ")
    dated = [re.fullmatch(r"\[(\d+)\.(\d+)\.(\d+)\] - (\d{4}-\d\d-\d\d)", heading) for heading in headings[1:]]
    assert all(dated), headings
    numbers = [tuple(map(int, match.groups()[:3])) for match in dated if match]
    assert numbers == sorted(numbers, reverse=True)
    newest = text.partition(f"## [{VERSION}]")[2].partition("\n## ")[0]
    kinds = re.findall(r"^### (.+)$", newest, re.MULTILINE)
    assert kinds[:4] == ["Added", "Changed", "Fixed", "Security"], f"{KINDS}, then the details by subject"


@each_package
def test_package_has_licence_declaration_and_metadata(package: Path) -> None:
    assert (package / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()
    declaration = (package / "QUALITY_DECLARATION.md").read_text()
    assert "**quality level 4**" in declaration and "Missing for level 3" in declaration
    settings = (package / "setup.cfg").read_text()
    assert "license_files = LICENSE" in settings and "long_description = file: README.md" in settings


def test_every_file_has_a_licence() -> None:
    text = (ROOT / "REUSE.toml").read_text()  # Python 3.10 has no parser of TOML
    paths, licences = (
        re.findall(rf'^{key} = "(.+)"$', text, re.MULTILINE) for key in ("path", "SPDX-License-Identifier")
    )
    assert (paths[0], licences[0]) == ("**", "Apache-2.0") and len(paths) == len(licences)
    assert {path.stem for path in (ROOT / "LICENSES").iterdir()} == set(licences)
    assert all((ROOT / path).is_file() for path in paths[1:])
    assert (ROOT / "LICENSES" / "Apache-2.0.txt").read_bytes() == (ROOT / "LICENSE").read_bytes()


def test_pre_commit_runs_the_tools_of_make_check() -> None:
    check = re.search(r"^check:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert check
    wanted = set(re.findall(r"\$\(VENV\)/([\w-]+(?: (?:check|format))?)", check[1])) - {"python"}
    wanted |= set(re.findall(r"scripts/checks/\w+\.py", check[1]))
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"][0]["hooks"]
    entries = " ".join(hook["entry"] for hook in hooks)
    assert {name for name in wanted if name not in entries} == set()


def test_issue_forms_and_policies_are_there() -> None:
    for path in sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("[bf]*.yml")):
        form = yaml.safe_load(path.read_text())
        assert {"name", "description", "body"} <= form.keys()
    pull = (ROOT / ".github" / "PULL_REQUEST_TEMPLATE.md").read_text()
    assert "`area: Imperative summary`" in pull
    major, minor, _ = VERSION.split(".")
    assert f"| {major}.{minor}.x | yes |" in (ROOT / "SECURITY.md").read_text()
    assert "SECURITY.md" in (ROOT / "CODE_OF_CONDUCT.md").read_text()
    assert "make release-check" in (ROOT / "CONTRIBUTING.md").read_text()
