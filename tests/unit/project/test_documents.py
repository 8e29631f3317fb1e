"""The documents: their links, the paths that code names, their size, and the examples of file formats in them."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from icu_common.core.goals.sequence import parse_file
from icu_common.core.panel.panel_layout import load_layout

ROOT = Path(__file__).resolve().parents[3]
DOCUMENTS = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md")),
    *sorted(ROOT.glob("docs/**/*.md")),
    *sorted(ROOT.glob("src/*/README.md")),
]
CODE = ("src", "tests", "benchmarks", "scripts", "config", "Makefile", "CONTRIBUTING.md", "CHANGELOG.md")
SUFFIXES = (".py", ".yaml", ".sh", ".js", ".md", ".html", "")
PURPOSES = ("tutorials", "how-to", "reference", "explanation")


def without_code(text: str) -> str:
    return re.sub(r"```.*?```|`[^`\n]*`", "", text, flags=re.DOTALL)


def anchors(path: Path) -> set[str]:
    """Return the anchors of a document's headings, as GitHub and GitLab make them."""
    headings = re.findall(r"^#+ (.+)$", re.sub(r"```.*?```", "", path.read_text(), flags=re.DOTALL), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_to_files_and_headings(path: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", without_code(path.read_text())):
        if target.startswith(("http://", "https://")):
            continue
        name, _, anchor = target.partition("#")
        leads_to = (path.parent / name).resolve() if name else path
        assert leads_to.exists(), f"{target} in {path.relative_to(ROOT)}"
        if anchor:
            assert anchor in anchors(leads_to), f"{target}: headings {sorted(anchors(leads_to))}"


def named_documents() -> Iterator[tuple[str, str]]:
    """Iterate over the paths below docs/ that files outside of it name, with the file's name."""
    for top in CODE:
        files = [ROOT / top] if (ROOT / top).is_file() else sorted((ROOT / top).rglob("*"))
        for file in files:
            if file.is_file() and file.suffix in SUFFIXES and "__pycache__" not in file.parts:
                text = file.read_text(encoding="utf-8", errors="replace").replace("\\", "")  # of regular expressions
                for name in re.findall(r"(?<![\w/])docs/[\w/.-]*\w", text):
                    yield name, str(file.relative_to(ROOT))


def test_files_outside_of_docs_name_documents_that_are_there() -> None:
    found = list(named_documents())
    assert len(found) > 40
    missing = sorted({(name, file) for name, file in found if not (ROOT / name).exists()})
    assert not missing, missing


def test_readme_is_short_and_names_the_two_commands() -> None:
    lines = (ROOT / "README.md").read_text().splitlines()
    assert len(lines) <= 120
    targets = re.findall(r"^make (\w+)", "\n".join(lines), re.MULTILINE)
    assert targets == ["demo", "test"]
    assert set(targets) <= set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.MULTILINE))


def test_figures_of_the_comparison_are_those_of_their_sources() -> None:
    section = (ROOT / "README.md").read_text().partition("## Comparison")[2].partition("\n## ")[0]
    rows = [line.strip("| ").split(" | ") for line in section.splitlines() if line.startswith("| ")][1:]
    assert len(rows) > 4
    for figure, ours, others, source in rows:
        documents = [name.partition("#")[0] for name in re.findall(r"\]\((docs/[^)]+)\)", source)]
        text = "\n".join((ROOT / name).read_text() for name in documents)
        for number in re.findall(r"\d+(?:\.\d+)?", f"{ours} {others}"):
            assert re.search(rf"(?<![\d.]){re.escape(number)}(?![\d.]*\d)", text), (figure, number, documents)


def test_index_lists_each_document_by_purpose_once() -> None:
    index = (ROOT / "docs" / "README.md").read_text()
    linked = re.findall(r"\]\(([\w/.-]+\.md)\)", index)
    there = {str(p.relative_to(ROOT / "docs")) for purpose in PURPOSES for p in (ROOT / "docs" / purpose).glob("*.md")}
    assert there <= set(linked)
    assert len(linked) == len(set(linked))
    decisions = (ROOT / "docs" / "decisions" / "README.md").read_text()
    assert all(f"]({p.name})" in decisions for p in (ROOT / "docs/decisions").glob("*.md") if p.name != "README.md")


def test_glossary_has_each_term_once() -> None:
    text = (ROOT / "docs" / "reference" / "glossary.md").read_text()
    sections = [re.findall(r"^\| ([^|]+) \|", part, re.MULTILINE)[1:] for part in text.split("\n## ")[1:]]
    terms = [term for section in sections for term in section]
    assert len(terms) > 60 and len(set(terms)) == len(terms)
    assert all(section == sorted(section, key=str.lower) for section in sections), "in alphabetical order"


def test_loop_of_the_readme_adds_every_folder_of_programs_to_path(tmp_path: Path) -> None:
    loops = {
        line.split("#")[0].strip()
        for path in DOCUMENTS
        for line in re.findall(r"^for folder in .*$", path.read_text(), re.MULTILINE)
    }
    assert len(loops) == 1, "the same line in all documents"
    for package in ("one", "two"):
        (tmp_path / "ros2_ws/install" / package / "lib" / package).mkdir(parents=True)
    done = subprocess.run(
        ["bash", "-euc", f'{loops.pop()}; echo "$PATH"'], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    folders = [f"{tmp_path}/ros2_ws/install/{package}/lib/{package}/" for package in ("two", "one")]
    assert done.stdout.split(":")[:2] == folders


def examples() -> dict[str, str]:
    """Return heading -> YAML example of the page on file formats."""
    page = (ROOT / "docs" / "reference" / "file-formats.md").read_text()
    return dict(re.findall(r"^## ([^\n]+)\n(?:(?!^## ).)*?```yaml\n(.*?)```", page, re.DOTALL | re.MULTILINE))


def test_example_of_a_layout_is_one(tmp_path: Path) -> None:
    (tmp_path / "pump_2.yaml").write_text(examples()["Layout of a panel"])
    layout = load_layout(tmp_path / "pump_2.yaml")
    assert [control.name for control in layout.controls] == ["START", "RATE"]
    knob = layout.control("RATE")
    assert knob.dimple is not None and knob.detent_deg == 15.0 and dict(knob.marks) == {"LOW": 90.0, "HIGH": -90.0}
    assert len(layout.markers) == 1 and len(layout.artwork) > 4


def test_example_of_a_sequence_is_one() -> None:
    text = examples()["Sequence"]
    sequence = parse_file(text)
    assert [step.gesture for step in sequence.steps] == ["press:RUN_STOP", "press:SAVE"]
    assert sequence.name == yaml.safe_load(text)["name"]
