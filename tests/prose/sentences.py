"""Sentences that a person reads, with file and line: Markdown, docstrings and comments, catalogues and scripts."""

from __future__ import annotations

import ast
import io
import json
import re
import tokenize
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from markdown_it import MarkdownIt
from markdown_it.token import Token

_CODE = re.compile(r"``[^`]+``|`[^`]+`|:\w+:`[^`]+`")
_LINK = re.compile(r"https?://\S+")
_SPLIT = re.compile(r"(?<=[.!?])[\"')\]]*\s+(?=\S)|(?<=[:;])\s+(?=[\"'(\[]*[A-Z0-9`<])")
_ABBREVIATION = re.compile(r"\b(?:e\.g|i\.e|etc|cf|vs|no|fig|eq|approx|resp|et al|Dr|St)\.$", re.IGNORECASE)
_SECTION = re.compile(r"^[A-Z][A-Za-z ]+\n-{3,}$", re.MULTILINE)
"""Heading of a numpydoc section."""
_MESSAGE = re.compile(r"^[a-zA-Z][\w-]* *= *(.*(?:\n(?:[ }].*)?)*)", re.MULTILINE)
"""A message of a Fluent file, with its lines of variants."""
_PLACEABLE = re.compile(r"\{[^{}]*\}")
_VARIANTS = re.compile(r"\{ *\$\w+ *->\n|^ *\*?\[\w+\] (.*)|^\}", re.MULTILINE)
_SCRIPT = re.compile(r'"((?:[^"\\\n]|\\.)*)"|^\s*//(.*)$|/\*\*?((?:.|\n)*?)\*/', re.MULTILINE)
"""Strings and comments of a script."""
_WORD = re.compile(r"[A-Za-zÀ-ÿ][\w'’-]*")


@dataclass(frozen=True, slots=True)
class Sentence:
    """A sentence of a text, without code and links.

    Attributes
    ----------
    path, line
        File, and line on which its paragraph begins.
    text
        Words; CODE and LINK replace code and addresses.
    running
        Whether it is part of a paragraph or list, and not a heading or a cell of a table.
    """

    path: Path
    line: int
    text: str
    running: bool = True

    @property
    def words(self) -> int:
        """Number of words; code counts as one word."""
        return len(_WORD.findall(self.text))


def of_markdown(path: Path) -> Iterator[Sentence]:
    """Return the sentences of paragraphs, lists and tables of a document; code blocks are left out."""
    line = 1
    opened = ""
    for token in MarkdownIt("commonmark").enable("table").parse(path.read_text()):
        if token.map:
            line = token.map[0] + 1
        if token.type == "inline":
            running = opened == "paragraph_open"
            for sentence in _sentences(path, line, _plain(token.children or [])):
                yield replace(sentence, running=running)
        opened = token.type


def of_python(path: Path) -> Iterator[Sentence]:
    """Return the sentences of the docstrings and comments of a module."""
    source = path.read_text()
    for line, text in _docstrings(ast.parse(source)):
        yield from _of_docstring(path, line, text)
    for line, text in _comments(source):
        yield from _sentences(path, line, text)


def of_script(path: Path) -> Iterator[Sentence]:
    """Return the sentences among the strings and the comments of a script of the page."""
    source = path.read_text()
    for match in _SCRIPT.finditer(source):
        text = match[1] if " " in (match[1] or "") else match[2] or match[3] or ""
        yield from _sentences(path, source.count("\n", 0, match.start()) + 1, text)


def of_json(path: Path) -> Iterator[Sentence]:
    """Return the sentences among the values of a message catalogue."""
    source = path.read_text()
    for text in _values(json.loads(source)):
        before, found, _ = source.partition(json.dumps(text, ensure_ascii=False))
        yield from _sentences(path, before.count("\n") + 1 if found else 1, text)


def of_fluent(path: Path) -> Iterator[Sentence]:
    """Return the sentences of a Fluent catalogue; VALUE replaces a placeable, and variants are read in their order."""
    source = path.read_text()
    for match in _MESSAGE.finditer(source):
        text = _PLACEABLE.sub("VALUE", _VARIANTS.sub(r"\1", match[1]))
        yield from _sentences(path, source.count("\n", 0, match.start()) + 1, text)


def _values(data: object) -> Iterator[str]:
    if isinstance(data, str):
        yield data
    elif isinstance(data, dict | list):
        for value in data.values() if isinstance(data, dict) else data:
            yield from _values(value)


def _plain(tokens: Iterable[Token]) -> str:
    parts = []
    for token in tokens:
        if token.type in ("softbreak", "hardbreak"):
            parts.append(" ")
        elif token.type == "code_inline":
            parts.append("CODE")
        elif token.type == "text":
            parts.append(token.content)
    return "".join(parts)


def _docstrings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Return docstrings, and the texts below constants and fields."""
    for node in ast.walk(tree):
        for statement in body if isinstance(body := getattr(node, "body", None), list) else []:
            if (
                isinstance(statement, ast.Expr)
                and isinstance(statement.value, ast.Constant)
                and isinstance(statement.value.value, str)
            ):
                yield statement.lineno, statement.value.value


def _of_docstring(path: Path, line: int, text: str) -> Iterator[Sentence]:
    """Split a numpydoc text: each paragraph and each entry of a section is read by itself."""
    block: list[str] = []
    begin = line
    for number, raw in enumerate([*text.splitlines(), ""]):
        stripped = raw.strip()
        entry = re.fullmatch(r"[\w*, .]+( : .+)?", stripped) and not stripped.endswith(".") and len(stripped) < 60
        if not stripped or set(stripped) == {"-"} or stripped.startswith((">>>", "...", "- ", "* ")) or entry:
            yield from _sentences(path, begin, " ".join(block))
            block, begin = [stripped[2:]] if stripped.startswith(("- ", "* ")) else [], line + number
        else:
            begin = begin if block else line + number
            block.append(stripped)


def _comments(source: str) -> Iterator[tuple[int, str]]:
    """Return comments: a block of lines as one text, those after code each by itself."""
    block: list[str] = []
    begin = last = 0
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type != tokenize.COMMENT or token.string.startswith(("#!", "# noqa", "# type:")):
            continue
        text = re.sub(r"#+ ?-*|# (noqa|type:).*", "", token.string, count=1).strip(" -")
        after_code = bool(token.line[: token.start[1]].strip())
        if token.start[0] != last + 1 or not block or after_code:
            if block:
                yield begin, " ".join(block)
            block, begin = [], token.start[0]
        block.append(text)
        last = -1 if after_code else token.start[0]
    if block:
        yield begin, " ".join(block)


def _sentences(path: Path, line: int, text: str) -> Iterator[Sentence]:
    text = _LINK.sub("LINK", _CODE.sub("CODE", re.sub(r"\s+", " ", text))).strip()
    joined = ""
    for part in _SPLIT.split(text):
        joined = f"{joined} {part}" if joined else part
        if not _ABBREVIATION.search(joined):
            if _WORD.search(joined):
                yield Sentence(path, line, joined)
            joined = ""
    if joined and _WORD.search(joined):
        yield Sentence(path, line, joined)
