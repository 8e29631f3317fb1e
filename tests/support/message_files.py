"""The message files of all languages, the messages that the programs make, and the texts left without a code.

A left text is collected from the source as a template, with ``{}`` for each value. A text that only a log, a terminal
or a refused start shows is left out.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from fluent.syntax import FluentParser
from fluent.syntax import ast as ftl
from fluent.syntax.visitor import Visitor

SRC = Path(__file__).resolve().parents[2] / "src"
PAGE = SRC / "scope_ui_bridge" / "scope_ui_bridge" / "page"
GRAPH = SRC / "icu_common" / "icu_common" / "messages" / "en.ftl"
"""English sentences of the graph's programs."""
MAKER = "Message"
"""Name of the class of messages."""


class _Values(Visitor):
    def __init__(self) -> None:
        self.found: set[str] = set()
        self.references: set[str] = set()

    def visit_VariableReference(self, node: ftl.VariableReference) -> None:
        """Collect the name of a value."""
        self.found.add(node.id.name)

    def visit_MessageReference(self, node: ftl.MessageReference) -> None:
        """Collect the key of a sentence that this one refers to."""
        self.references.add(node.id.name)


def messages(*files: Path) -> dict[str, ftl.Message]:
    """Return the messages of files by key; no key occurs twice, and no line is unreadable."""
    found: dict[str, ftl.Message] = {}
    for file in files:
        for entry in FluentParser().parse(file.read_text(encoding="utf-8")).body:
            assert not isinstance(entry, ftl.Junk), f"{file.name}: {entry.content!r}"
            if isinstance(entry, ftl.Message):
                assert entry.id.name not in found, f"{file.name}: {entry.id.name} stands twice"
                assert entry.value is not None and not entry.attributes
                found[entry.id.name] = entry
    return found


def values(key: str, known: dict[str, ftl.Message]) -> set[str]:
    """Return the names of the values in a sentence, also in the sentences that it refers to."""
    visitor = _Values()
    visitor.visit(known[key])
    return visitor.found.union(*(values(reference, known) for reference in visitor.references))


def language(name: str) -> dict[str, ftl.Message]:
    """Return the messages of a language."""
    return messages(PAGE / "language" / f"{name}.ftl", *((GRAPH,) if name == "en" else ()))


def languages() -> list[str]:
    """Return the names of the languages."""
    return sorted(file.stem for file in (PAGE / "language").glob("*.ftl"))


@dataclass(frozen=True)
class Made:
    """A message that a module makes; ``more`` if it has values beyond those named there."""

    code: str
    values: frozenset[str]
    more: bool
    where: str


def made() -> Iterator[Made]:
    """Yield the messages with a constant code that the modules of ``src`` make."""
    for path in sorted(SRC.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == MAKER and node.args:
                code = node.args[0]
                for choice in (code.body, code.orelse) if isinstance(code, ast.IfExp) else (code,):
                    if isinstance(choice, ast.Constant):
                        names = frozenset(keyword.arg for keyword in node.keywords if keyword.arg)
                        more = any(keyword.arg is None for keyword in node.keywords)
                        yield Made(str(choice.value), names, more, f"{path.relative_to(SRC)}:{node.lineno}")


def constants() -> set[str]:
    """Return the constant texts in ``src``."""
    trees = (ast.parse(path.read_text()) for path in SRC.rglob("*.py"))
    nodes = (node for tree in trees for node in ast.walk(tree))
    return {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}


FOLDERS = {"core", "nodes", "adapters", "pairing"}
PACKAGES = ("gantry_driver", "harris_perception", "icu_common", "scope_ui_bridge")

ONLY_ELSEWHERE = {
    "command line programs": (
        *("gcode_check", "gcode_words", "progress", "monitor", "check_mode", "board", "board_detection"),
        *("wrist_camera", "wrist_motion", "ball_measurement"),
        *("stereo_evaluation", "dense_stereo", "repeatability", "capture", "text_bounds"),
        *("stereo_folders", "picture_files", "stereo_calibration", "boundary_files", "boundary_evaluation"),
        *("marker_sheet", "print_page"),
        *("program_end", "option_bounds", "topic_names", "preparation", "message", "catalogue"),
    ),
    "programs that do not start, or the log": (
        *(
            "config",
            "configuration_folder",
            "machine_config",
            "controller_config",
            "parameters",
            "runtime",
            "camera_model",
            "frame_link",
        ),
        *(
            "camera_sources",
            "v4l2_source",
            "camera_controls",
            "camera_info",
            "camera_node",
            "corners_node",
            "stereo_node",
            "dense_stereo_node",
            "stylus_node",
        ),
        *("recognition_node", "recognition_config", "geometry", "stroke_font", "real_time", "compiled"),
        *("harris", "edges", "edge_kernels", "harris_kernels", "harris_laplace", "edge_tracing", "deriche", "matching"),
        *("stereo_matching", "stylus", "ball_view", "ball_fit", "plane_fit", "planar_pose", "reprojection"),
        *("rectifier", "value_range"),
        *("pair_rotation", "pair_watch", "layout", "pair", "layout_message", "pair_message", "panel_check"),
        *("structure", "lanes", "edge_alignment", "overlay", "foxglove_sidecar", "passwords", "secret_files", "audit"),
        "bridge_files",
        "grbl_client",
        *(
            "turned_away",
            "front_door",
            "listener",
            "websockets",
            "executables",
            "compiling",
            "transport_profile",
            "unix_listener",
            "trajectory_bytes",
            "step_layout",
            "jpeg_encoder",
            "hearing",
            "step_ledger",
            "images",
            "on_demand",
            "port_record",
            "line",
            "heartbeats",
            "nodes.messages",
        ),
    ),
}
_UNSAID = re.compile(  # calls whose texts go to a log only, or to no reader
    r"setting|re\.compile|LogNote|(Assertion|Runtime|Config|Calibration)Error|Message|Text|.*get_logger\(\)\..*|_?LOG\..*"
)


def templates() -> dict[str, str]:
    """Return the templates, each with a file that has it."""
    left_out = {name for names in ONLY_ELSEWHERE.values() for name in names}
    found: dict[str, str] = {}
    for package in PACKAGES:
        for path in sorted((SRC / package / package).rglob("*.py")):
            named = {path.stem, ".".join(path.parts[-3:-1])}
            if FOLDERS & set(path.parts) and not named & left_out:
                for text in _texts(ast.parse(path.read_text())):
                    found.setdefault(text, str(path.relative_to(SRC)))
    return found


def _texts(tree: ast.Module) -> Iterator[str]:
    unsaid: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            unsaid.add(id(node.value))  # a docstring
        elif isinstance(node, ast.Call) and _UNSAID.fullmatch(ast.unparse(node.func)):
            unsaid |= {id(part) for part in ast.walk(node)}
        elif isinstance(node, ast.JoinedStr):
            unsaid |= {id(part) for value in node.values for part in ast.walk(value) if _is_part(part, value)}
    for node in ast.walk(tree):
        text = "" if id(node) in unsaid else _template(node)
        words = re.findall(r"[A-Za-z]{2,}", text.replace("{}", ""))
        if words and " " in text.strip() and "\n" not in text:
            yield text.strip()


def _is_part(part: ast.AST, value: ast.expr) -> bool:
    """Whether this belongs to an f-string's own text or format; what is computed inside the braces may be said."""
    if isinstance(value, ast.FormattedValue):
        return value.format_spec is not None and any(part is inner for inner in ast.walk(value.format_spec))
    return True


def _template(node: ast.AST) -> str:
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values)
    return ""
