"""Plain English and spelling of all texts, and the check itself: each rule, each kind of text, what it prints."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from prose.check import ROOT, english, files, main, misspelt
from prose.rules import Kind, Rule, Rules, load, read

RULES = load()


def findings(path: Path, text: str, rules: Rules = RULES) -> list[str]:
    path.write_text(text)
    return [str(finding) for finding in rules.of_file(path, path.parent)]


def test_all_texts_follow_the_rules() -> None:
    wrong = [str(finding) for finding in RULES.of_tree(ROOT)]
    assert not wrong, "\n".join(wrong)


def test_all_texts_are_spelt_as_codespell_knows_them() -> None:
    assert misspelt(english(files(RULES)), RULES.spelling) == ""


@pytest.mark.parametrize("rule", RULES.rules, ids=lambda rule: rule.name)
def test_a_rule_finds_its_bad_sentence_and_passes_its_good_one(rule: Rule, tmp_path: Path) -> None:
    if rule.files != "*":
        bad = findings(tmp_path / rule.files, f"# Title\n\ngood = {rule.good}\n\nbad = {rule.bad}\n")
        assert [line.split(": ")[:2] for line in bad] == [[f"{rule.files}:5", rule.name]]
        assert findings(tmp_path / "other.md", rule.bad) == []
        return
    bad = findings(tmp_path / "bad.md", f"# Title\n\nThe first line is good.\n\n{rule.bad}\n")
    assert [line for line in bad if f": {rule.name}: write {rule.instead}" in line], bad
    assert all(line.startswith("bad.md:5: ") and line.endswith(rule.bad) for line in bad), bad
    assert findings(tmp_path / "good.md", rule.good) == []


@pytest.mark.parametrize(
    ("sentence", "rule"),
    [
        ("A poll so often that the port is busy is rejected.", "so much"),
        ("PyYAML takes 3 s for 3000 open brackets.", "take for"),
        ("No outlier stands out, and NaN stands for an unknown value.", "stand"),
        ("A nurse hears the click.", "hear"),
        ("A move in work coordinates is a rapid one.", "at work"),
        ("It lists arcs, each of which is visible.", "of which"),
    ],
)
def test_an_exception_covers_its_text_only(sentence: str, rule: str, tmp_path: Path) -> None:
    assert findings(tmp_path / "text.md", sentence) == []
    bad = next(known.bad for known in RULES.rules if known.name == rule)
    found = findings(tmp_path / "text.md", f"{sentence[:-1]}, and {bad}")
    assert any(f": {rule}: " in line for line in found), found


def test_a_sentence_of_35_words_passes_and_one_of_36_does_not(tmp_path: Path) -> None:
    short = Rules(RULES.rules, RULES.kinds, RULES.words, 100.0, RULES.spelling)
    assert findings(tmp_path / "text.md", "word " * 34 + "end.", short) == []
    (found,) = findings(tmp_path / "text.md", "word " * 35 + "end.", short)
    assert found.startswith("text.md:1: 36 words: write at most 35 words a sentence\n")


def test_a_document_has_at_most_20_words_a_sentence_on_average(tmp_path: Path) -> None:
    sentence = "word " * 20 + "end. "
    assert findings(tmp_path / "text.md", sentence + "A short one.") == []
    (found,) = findings(tmp_path / "text.md", sentence * 3)
    assert found.startswith("text.md:1: mean of 21.0 words: ")


def test_docstrings_comments_and_texts_below_constants_are_read_and_code_is_not(tmp_path: Path) -> None:
    source = '''"""Started anew."""

LIMIT_S = 1.0
"""Seconds, anew."""


def anew(text: str = "anew") -> str:
    """Return ``anew``.

    Parameters
    ----------
    text
        Text, anew.
    """
    # A comment that is begun anew
    # goes on in the next line.
    return text  # anew
'''
    found = findings(tmp_path / "module.py", source)
    assert [line.split(": ")[0] for line in found] == [f"module.py:{n}" for n in (1, 4, 13, 15, 17)], found
    assert found[3].endswith("A comment that is begun anew goes on in the next line.")


def test_tables_and_lists_are_read_and_code_blocks_are_not(tmp_path: Path) -> None:
    text = "| a | b |\n|---|---|\n| anew | c |\n\n- one\n- begun anew\n\n```\nanew\n```\n\n`anew`\n"
    assert [line.split(": ")[0] for line in findings(tmp_path / "text.md", text)] == ["text.md:3", "text.md:6"]


def test_fluent_catalogues_are_read_with_their_variants_and_without_their_values(tmp_path: Path) -> None:
    message = "# Begun anew.\na = Begun { FIXED($anew, digits: 1) } anew.\n\n"
    variants = "b = { $count ->\n    [one] One step anew.\n   *[other] { $count } steps.\n}\nc = Sent.\n"
    path = _written(tmp_path / "en.ftl", message + variants)
    assert [(s.line, s.text) for s in read(path)] == [
        (2, "Begun VALUE anew."),
        (4, "One step anew."),
        (4, "VALUE steps."),
        (8, "Sent."),
    ]


def _written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_a_passive_of_a_message_needs_its_actor(tmp_path: Path) -> None:
    passed = "a = The stop was sent by the driver.\nb = The stylus is still extended.\n"
    assert findings(tmp_path / "en.ftl", passed) == []
    (found,) = findings(tmp_path / "en.ftl", f"{passed}c = The machine was not stopped.\n")
    assert found.startswith("en.ftl:3: passive message: ")
    german = "a = Der Befehl wurde vom Treiber abgelehnt.\nb = Er wurde durch STOP beendet.\n"
    assert findings(tmp_path / "de.ftl", german) == []
    (found,) = findings(tmp_path / "de.ftl", f"{german}c = Die Maschine wurde angehalten.\n")
    assert found.startswith("de.ftl:3: German passive message: ")


def test_catalogues_and_scripts_of_the_page_are_read(tmp_path: Path) -> None:
    assert findings(tmp_path / "en.json", '{\n  "a": "Stop",\n  "b": {"c": "The page is loaded anew."}\n}\n') == [
        "en.json:3: anew: write again, a new ..., or a verb with re-\n    The page is loaded anew."
    ]
    script = 'export const EN = {\n  key: "The page is loaded anew.",\n};\n// Read anew.\nconst anew = 1;\n'
    assert [line.split(": ")[0] for line in findings(tmp_path / "en.js", script)] == ["en.js:2", "en.js:4"]


def test_sentences_end_at_points_before_small_letters_but_not_after_abbreviations(tmp_path: Path) -> None:
    (tmp_path / "text.md").write_text("It ends. rclpy starts, e.g. here. A ratio: 5 of 6.")
    assert [s.text for s in read(tmp_path / "text.md")] == [
        "It ends.",
        "rclpy starts, e.g. here.",
        "A ratio:",
        "5 of 6.",
    ]


def test_an_exception_without_a_reason_is_an_error(tmp_path: Path) -> None:
    rules = (Path(sys.modules["prose.rules"].__file__ or "").with_name("rules.toml")).read_text()
    assert 'why = "people hear"' in rules
    (tmp_path / "rules.toml").write_text(rules.replace('why = "people hear"', 'why = ""'))
    with pytest.raises(ValueError, match="no reason"):
        load(tmp_path / "rules.toml")


def test_german_texts_are_exempt_from_the_rules_for_english(tmp_path: Path) -> None:
    german = next(kind for kind in RULES.kinds if kind.name == "German messages")
    assert [path.name for path in german.paths(ROOT)] == ["de.ftl"]
    assert findings(tmp_path / "de.ftl", "a = The page is loaded anew.\n") == []
    assert english([tmp_path / "en.ftl", tmp_path / "de.ftl"]) == [tmp_path / "en.ftl"]


def test_both_catalogues_in_english_and_the_scripts_of_the_page_are_read() -> None:
    paths = {str(path.relative_to(ROOT)) for path in files(RULES)}
    page = "src/scope_ui_bridge/scope_ui_bridge/page"
    wanted = {"src/icu_common/icu_common/messages/en.ftl", f"{page}/language/en.ftl", f"{page}/reports/banner.js"}
    assert wanted <= paths
    assert not [path for path in paths if "/vendor/" in path]


def test_a_misspelt_word_is_named_with_its_line_and_ignored_words_are_not(tmp_path: Path) -> None:
    wrong = "receives".replace("cei", "cie")
    (tmp_path / "text.md").write_text(f"Right.\n\nIt {wrong} keep-alives.\n")
    assert misspelt([tmp_path / "text.md"], ["keep-alives"]) == f"{tmp_path}/text.md:3: {wrong} ==> receives"


def test_the_command_prints_findings_and_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = ROOT / "tests" / "prose" / "rules.py"
    assert main([str(path)]) == 0
    assert capsys.readouterr().out == ""
    result = subprocess.run(
        [sys.executable, "-m", "prose.check", str(tmp_path / "missing.md")],
        cwd=ROOT / "tests",
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 1
    assert "missing.md" in result.stderr


def test_files_of_a_kind_are_those_of_its_patterns_without_the_ones_left_out(tmp_path: Path) -> None:
    for name in ("a.md", "b_de.md", "c.txt"):
        (tmp_path / name).write_text("")
    assert [p.name for p in Kind("texts", ("*",), ("*_de.*",)).paths(tmp_path)] == ["a.md"]


def test_headings_and_tables_do_not_count_in_the_mean(tmp_path: Path) -> None:
    running = "word " * 20 + "end. "
    (found,) = findings(tmp_path / "text.md", f"# Title\n\n| a | b |\n|---|---|\n| c | d |\n\n{running}\n")
    assert ": mean of 21.0 words: " in found
