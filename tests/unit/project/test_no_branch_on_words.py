"""No branch looks at the words of a message: programs decide by codes, and English is only for people.

The test walks the syntax trees of all modules in ``src``. It reports a text of a message (a reason, a cause, an error's
text, a state with its reason) that is searched, split, or compared with a constant. It also reports a constant sentence
that is compared with or searched in anything. Two messages may be compared with each other: a node does so to publish a
state only when it changes.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
SRC = ROOT / "src"
PAGE = SRC / "scope_ui_bridge" / "scope_ui_bridge" / "page"
MESSAGE_NAMES = (
    "advice|answer_text|cause|causes|clause|complaint|conflict|detail|detail_text|effect|hindrance|told|message|obstacle|"
    "reason|reasons|refusal|remark|refusal_text|said|shown|state_text|status_text|warning|why|words"
)
MESSAGE = re.compile(rf"_*({MESSAGE_NAMES})|\w+_(reason|message|cause|refusal)")
"""Names of variables, attributes and functions whose value is a message for people."""
STATES = re.compile(r"_*(driver|controller|calibration|sequencer|state|latest)(_state|_text)?")
"""Names of published states: one word that is a code, then a reason for people, which no program may look into."""
SEARCHES = {
    *("count", "endswith", "find", "index", "partition", "removeprefix", "removesuffix", "replace", "rfind", "rindex"),
    *("rpartition", "rsplit", "split", "splitlines", "startswith"),
}
SENTENCE = re.compile(r"[A-Za-z']{2,}[,:;]? [A-Za-z']{2,}")
PATTERNS = {"match", "search", "fullmatch", "findall", "finditer", "sub", "subn"}


FORMATS = {
    "gantry_driver/adapters/guard/client.py": (5, "keys of a JSON object"),
    "gantry_driver/adapters/guard/server.py": (2, "keys of a JSON object"),
    "gantry_driver/core/machine/machine.py": (1, "a message of the board, which has no code"),
    "gantry_driver/mock/firmware/gcode.py": (1, "modal groups as G-code names them"),
    "harris_perception/cli/harris_evaluate.py": (1, "a column of a written table"),
    "harris_perception/core/recognition/panel_teaching.py": (1, "NAME:KIND of a command line"),
    "icu_common/core/reasons/state_text.py": (1, "the one place that separates a state from its reason"),
    "icu_common/nodes/runtime.py": (2, "rcl raises one type of error, without a code, for each of its causes"),
    "scope_ui_bridge/core/access/passwords.py": (1, "lines of the file of passwords"),
}
"""File -> number of lines whose text is written in a format, or by a program of others that has no codes, and why."""
TO_MEND = {
    "gantry_driver/cli/gantry_prepare.py": (
        1,
        "a latched state: its code comes later, once a second",
    ),
    "icu_common/core/processes/preparation.py": (1, "the same: progress in the latched text alone"),
}
"""File -> number of lines that still look at words, and at which; a line that is mended is taken off."""

_WORD = r"\b(?:message|reason|said|told|why|cause)\b"
_SEARCH = r"\.(?:includes|startsWith|endsWith|indexOf|match|search|split|replace|replaceAll)\("
ON_THE_PAGE = re.compile(
    rf"{_WORD}\)?{_SEARCH}|\.(?:test|exec)\([^()]*{_WORD}|{_WORD} (?:===|!==) (?:\"[^\"]|[A-Z_]{{3,}})"
)
"""A text of a message that a script of the page searches, divides, or compares with a constant."""


@dataclass
class Module:
    """One module: its tree, and its constants that contain sentences."""

    path: Path
    tree: ast.Module
    sentences: set[str] = field(default_factory=set)

    @property
    def name(self) -> str:
        return ".".join(self.path.relative_to(SRC).with_suffix("").parts[1:]).removesuffix(".__init__")


def texts_in(node: ast.expr) -> Iterator[str]:
    """Yield the constant texts of an expression: of a text, a template, a sum, and a tuple, list, set or mapping."""
    for part in ast.walk(node):
        if isinstance(part, ast.Constant) and isinstance(part.value, str):
            yield part.value


def is_sentence(node: ast.expr) -> bool:
    if isinstance(node, ast.Dict):  # a table is searched by its keys
        return any(is_sentence(key) for key in node.keys if key is not None)
    constant = (ast.Constant, ast.JoinedStr, ast.BinOp, ast.Tuple, ast.List, ast.Set)
    return isinstance(node, constant) and any(SENTENCE.search(text) for text in texts_in(node))


def modules() -> list[Module]:
    found = [Module(path, ast.parse(path.read_text())) for path in sorted(SRC.rglob("*.py"))]
    return resolved(found)


def resolved(found: list[Module]) -> list[Module]:
    """Return the modules with the names of their constant sentences, own and imported."""
    by_name = {module.name: module for module in found}
    for module in found:
        for node in module.tree.body:
            targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
            value = getattr(node, "value", None)
            if isinstance(node, (ast.Assign, ast.AnnAssign)) and value is not None and is_sentence(value):
                module.sentences |= {target.id for target in targets if isinstance(target, ast.Name)}
    own: Mapping[str, set[str]] = {module.name: set(module.sentences) for module in found}
    for module in found:
        for node in module.tree.body:
            if isinstance(node, ast.ImportFrom) and node.module in by_name:
                module.sentences |= {a.asname or a.name for a in node.names if a.name in own[node.module]}
    return found


def name_of(node: ast.expr) -> str:
    """Return the last name of an expression: of a variable, an attribute, or what a function or key returns."""
    match node:
        case ast.Name():
            return node.id
        case ast.Attribute():
            return node.attr
        case ast.Call(func=ast.Name(id="str" | "repr" | "plain"), args=[argument, *_]):
            return "message" if name_of(argument) in ("error", "exception") else name_of(argument)
        case ast.Call(func=ast.Attribute(attr="strip" | "lower" | "casefold" | "lstrip" | "rstrip", value=value)):
            return name_of(value)
        case ast.Call():
            return name_of(node.func)
        case ast.Subscript(slice=ast.Constant(value=str(key))):
            return key
        case ast.Subscript():
            return name_of(node.value)
        case ast.NamedExpr():
            return name_of(node.target)
    return ""


def is_message(node: ast.expr) -> bool:
    return MESSAGE.fullmatch(name_of(node)) is not None


def is_state(node: ast.expr) -> bool:
    return STATES.fullmatch(name_of(node)) is not None


def is_layout(arguments: list[ast.expr]) -> bool:
    """Whether a text is divided into lines or by spaces only, to show it."""
    return not arguments or [ast.unparse(part) for part in arguments] in (["'\\n'"], ["chr(10)"])


def is_clause(whole: ast.expr, arguments: list[ast.expr]) -> bool:
    """Whether a text is divided into a state and its reason, or into the clauses of a reason."""
    constant = arguments[0].value if arguments and isinstance(arguments[0], ast.Constant) else None
    named = name_of(whole) in ("text", "data", "reported")
    return named and isinstance(constant, str) and constant.strip() in (":", ";")


def branches_on_words(module: Module) -> Iterator[tuple[int, str]]:
    """Yield each line that looks at the words of a message, with what it looks at."""

    def sentence(node: ast.expr) -> bool:
        return is_sentence(node) or (isinstance(node, ast.Name) and node.id in module.sentences)

    def wrong(operator: ast.cmpop, left: ast.expr, right: ast.expr) -> bool:
        sides = (left, right)
        if isinstance(operator, (ast.In, ast.NotIn)):
            return any(sentence(side) or is_message(side) for side in sides) or is_state(right)
        if not isinstance(operator, (ast.Eq, ast.NotEq)):
            return False
        full = any(isinstance(s, ast.Constant) and isinstance(s.value, str) and s.value for s in sides)
        return any(sentence(side) or (full and is_message(side)) for side in sides)

    for node in ast.walk(module.tree):
        if isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
            if any(wrong(*pair) for pair in zip(node.ops, sides, sides[1:])):
                yield node.lineno, ast.unparse(node)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            whole = node.func.value
            if node.func.attr in SEARCHES and not is_layout(node.args):
                looked_at = is_message(whole) or is_state(whole) or is_clause(whole, node.args)
                if looked_at or any(sentence(argument) for argument in node.args):
                    yield node.lineno, ast.unparse(node)
            elif node.func.attr in PATTERNS and any(is_message(a) or is_state(a) for a in node.args):
                yield node.lineno, ast.unparse(node)
        elif isinstance(node, ast.Match) and is_message(node.subject):
            yield node.lineno, ast.unparse(node.subject)


def found_in(text: str) -> list[str]:
    return [line for _, line in branches_on_words(resolved([Module(SRC / "a" / "a.py", ast.parse(text))])[0])]


@pytest.mark.parametrize(
    "text",
    [
        "'too late' in reason",
        "result.reason.startswith('touched')",
        "reason == 'paused'",
        "self.driver.partition(':')[0]",
        "text.partition(': ')[2]",
        "self.held in driver",
        "str(error).partition(': ')[2]",
        "status.message.split('; ')",
        "re.match('stale', refusal)",
        "anything == 'stop requested'",
        "WANTED = 'stop requested'\nif anything == WANTED: pass",
        "WANTED = ('idle', f'waiting: no {what} yet')\nanything.startswith(WANTED)",
    ],
)
def test_a_line_that_looks_at_words_is_found(text: str) -> None:
    assert len(found_in(text)) == 1


@pytest.mark.parametrize(
    "text",
    [
        "reason != self.last_reason",
        "reason == ''",
        "state_name(text) == 'idle'",
        "code is Code.PAUSED",
        "' '.join(str(error).split())",
        "name in {'a': 'a sentence of words'}",
    ],
)
def test_a_line_that_looks_at_a_code_or_lays_a_text_out_is_not_found(text: str) -> None:
    assert found_in(text) == []


@pytest.mark.timeout(600)  # it parses all modules: 4 s of processor time
def test_no_branch_looks_at_the_words_of_a_message() -> None:
    found: dict[str, list[str]] = {}
    for module in modules():
        name = str(module.path.relative_to(SRC)).partition("/")[2]
        for line, text in branches_on_words(module):
            found.setdefault(name, []).append(f"{name}:{line}: {text}")
    allowed = {name: lines for name, (lines, _) in (FORMATS | TO_MEND).items()}
    wrong = {name for name in {*found, *allowed} if len(found.get(name, [])) != allowed.get(name, 0)}
    assert not wrong, "\n".join(
        line for name in sorted(wrong) for line in found.get(name, [f"{name}: mended, take it off the list"])
    )


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ('if (reason.includes("; drift: ")) return;', True),
        ("const known = DRIVER.find(([pattern]) => pattern.test(reason));", True),
        ("const [, done] = /^(\\d+)/.exec(state ? reason : '') ?? [];", True),
        ('if (cause === "stop requested") return;', True),
        ("const shown = values.reason !== REQUESTED ? values.reason : '';", True),
        ('button.disabled = why !== "";', False),
        ('if (refusal?.code === "not_ready") say(said(reason));', False),
    ],
)
def test_a_line_of_the_page_that_looks_at_words_is_found(line: str, found: bool) -> None:
    assert bool(ON_THE_PAGE.search(line)) is found


def test_no_script_of_the_page_looks_at_the_words_of_a_message() -> None:
    found = {}
    for script in sorted(PAGE.rglob("*.js")):
        if "vendor" not in script.parts:
            lines = [line.strip() for line in script.read_text().splitlines() if ON_THE_PAGE.search(line)]
            found[str(script.relative_to(PAGE))] = lines
    assert len(found) > 30 and {name: lines for name, lines in found.items() if lines} == {}
