"""Rules of rules.toml, and the sentences that break them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    import tomli as tomllib

from prose.sentences import Sentence, of_fluent, of_json, of_markdown, of_python, of_script

RULES = Path(__file__).with_name("rules.toml")
READERS = {".md": of_markdown, ".py": of_python, ".js": of_script, ".json": of_json, ".ftl": of_fluent}
GERMAN = "de.ftl"
"""Name of a catalogue that only its own rules read."""


@dataclass(frozen=True, slots=True)
class Rule:
    """A pattern of bad English, its remedy, and the texts in which it is right."""

    name: str
    pattern: re.Pattern[str]
    instead: str
    bad: str
    good: str
    exceptions: tuple[re.Pattern[str], ...]
    files: str = "*"
    """Names of the files that it is for."""

    def reads(self, path: Path) -> bool:
        """Return whether the rule is for a file."""
        return fnmatch(path.name, self.files) and (path.name == GERMAN) == (self.files == GERMAN)

    def hits(self, text: str) -> bool:
        """Return whether a sentence breaks the rule, without the texts that are excepted."""
        for exception in self.exceptions:
            text = exception.sub("EXCEPTION", text)
        return self.pattern.search(text) is not None


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of text: the files in which it is."""

    name: str
    files: tuple[str, ...]
    left_out: tuple[str, ...]

    def paths(self, root: Path) -> list[Path]:
        """Return the files below a folder, sorted."""
        found = {path for pattern in self.files for path in root.glob(pattern) if "__pycache__" not in path.parts}
        return sorted(
            path
            for path in found
            if path.suffix in READERS and not any(fnmatch(path.name, name) for name in self.left_out)
        )


@dataclass(frozen=True, slots=True)
class Finding:
    """A sentence or a document that breaks a rule."""

    path: Path
    line: int
    text: str
    rule: str
    instead: str

    def __str__(self) -> str:
        """Return file:line, the rule with its remedy, and the sentence."""
        return f"{self.path}:{self.line}: {self.rule}: write {self.instead}\n    {self.text}"


@dataclass(frozen=True, slots=True)
class Rules:
    """All rules: patterns, limits, and the kinds of text to read."""

    rules: tuple[Rule, ...]
    kinds: tuple[Kind, ...]
    words: int
    mean: float
    spelling: tuple[str, ...]
    """Words that codespell does not know."""

    def of_sentence(self, sentence: Sentence, root: Path) -> Iterator[Finding]:
        """Return what is wrong with a sentence."""
        path = sentence.path.relative_to(root)
        for rule in self.rules:
            if rule.reads(path) and rule.hits(sentence.text):
                yield Finding(path, sentence.line, sentence.text, rule.name, rule.instead)
        if sentence.words > self.words:
            remedy = f"at most {self.words} words a sentence"
            yield Finding(path, sentence.line, sentence.text, f"{sentence.words} words", remedy)

    def of_file(self, path: Path, root: Path) -> Iterator[Finding]:
        """Return what is wrong in a file, sentence by sentence, and with its mean."""
        sentences = list(read(path))
        for sentence in sentences:
            yield from self.of_sentence(sentence, root)
        if path.suffix == ".md" and (words := mean(sentences)) > self.mean:
            remedy = f"shorter sentences: at most {self.mean:g} words on average"
            yield Finding(
                path.relative_to(root), 1, f"{len(sentences)} sentences", f"mean of {words:.1f} words", remedy
            )

    def of_tree(self, root: Path) -> Iterator[Finding]:
        """Return what is wrong in all texts below the project's folder."""
        for kind in self.kinds:
            for path in kind.paths(root):
                yield from self.of_file(path, root)


def read(path: Path) -> Iterator[Sentence]:
    """Return the sentences of a file by its kind."""
    return READERS[path.suffix](path)


def mean(sentences: Iterable[Sentence]) -> float:
    """Return the mean number of words in running text; 0 without sentences."""
    counts = [sentence.words for sentence in sentences if sentence.running]
    return sum(counts) / len(counts) if counts else 0.0


def load(path: Path = RULES) -> Rules:
    """Return the rules of a file; a rule or exception without its reason is a KeyError."""
    data: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    return Rules(
        rules=tuple(
            Rule(
                name=rule["name"],
                pattern=re.compile(rule["pattern"], re.IGNORECASE),
                instead=rule["instead"],
                bad=rule["bad"],
                good=rule["good"],
                exceptions=tuple(re.compile(_reasoned(e, "text"), re.IGNORECASE) for e in rule.get("except", [])),
                files=rule.get("files", "*"),
            )
            for rule in data["rule"]
        ),
        kinds=tuple(
            Kind(kind["name"], tuple(kind["files"]), tuple(_reasoned(e, "file") for e in kind.get("except", [])))
            for kind in data["kind"]
        ),
        words=data["limits"]["words"],
        mean=data["limits"]["mean"],
        spelling=tuple(word for entry in data["spelling"] if _reasoned(entry, "words") for word in entry["words"]),
    )


def _reasoned(exception: dict[str, Any], key: str) -> Any:
    if not exception.get("why"):
        raise ValueError(f"{RULES.name}: an exception has no reason (why): {exception}")
    return exception[key]
