"""Messages of the graph's programs to the operator's page, collected from their source as templates.

A template is a text with ``{}`` for each value. Texts that only a log, a terminal or a refused start shows are left
out.
"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path

SRC = Path(__file__).resolve().parents[1] / "src"
FOLDERS = {"core", "nodes", "adapters", "pairing"}
PACKAGES = ("gantry_driver", "harris_perception", "icu_common", "scope_ui_bridge")

ONLY_ELSEWHERE = {
    "command line programs": (
        *("gcode_check", "gcode_words", "progress", "monitor", "check_mode", "board", "board_detection"),
        *("wrist_camera", "wrist_motion", "ball_measurement"),
        *("stereo_evaluation", "dense_stereo", "repeatability", "capture", "text_bounds"),
        *("stereo_folders", "picture_files", "stereo_calibration", "boundary_files", "boundary_evaluation"),
        *("program_end", "option_bounds", "topic_names", "preparation"),
    ),
    "programs that do not start, or the log": (
        *("config", "machine_config", "controller_config", "parameters", "runtime", "camera_model", "frame_link"),
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
    r"setting|re\.compile|Note|(Assertion|Runtime|Config|Calibration)Error|.*get_logger\(\)\..*|_?LOG\..*"
)


def german_phrases() -> dict[str, str]:
    """Return the page's German for what the graph says, by its templates."""
    page = SRC / "scope_ui_bridge" / "scope_ui_bridge" / "page"
    lines = re.findall(r"^  (\[.*\]),$", (page / "language" / "phrases_de.js").read_text(), re.MULTILINE)
    pairs = [json.loads(line) for line in lines]
    assert len(pairs) == len(dict(pairs)) > 300, "no phrase stands twice"
    return dict(pairs)


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


if __name__ == "__main__":
    for template, file in templates().items():
        print(f"{file}: {template!r}")
