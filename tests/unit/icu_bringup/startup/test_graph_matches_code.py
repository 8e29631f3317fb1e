"""config/graph.yaml and config/params against the code: executables, parameter keys, values."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from pathlib import Path
from typing import Any

import pytest
from rclpy.node import Node
from support.parameter_files import file_values
from unit.icu_bringup.graph_programs import ROOT, config_class, entry_points, programs

from icu_bringup.core.startup.graph_description import Program
from icu_common.core.configuration.config import from_mapping, settings_of, to_mapping

PROFILES = ("bench", "test", "carriage", "hardware", "replay")


CASES = [pytest.param(profile, p, id=f"{profile}-{p.name}") for profile in PROFILES for p in programs(profile)]


@pytest.mark.parametrize(("profile", "program"), CASES)
def test_executable_exists_and_every_value_is_accepted(profile: str, program: Program) -> None:
    assert program.executable in entry_points(program.package)
    if not program.is_node:
        return
    values: dict[str, Any] = {}
    for path in program.parameter_files:
        for node, entry in file_values(path).items():
            if node in ("/**", f"/**/{program.name}", program.name):
                values |= entry
    values |= program.parameters
    values.pop("use_sim_time", None)  # rclpy's own, known to every node
    from_mapping(config_class(program), values)


FROM_THE_GRAPH = {
    "bench": {"layout", "motion_socket", "frame_socket", "test_socket", "truth_log"},
    "ui_bridge": {"token_file", "passwords_file", "record_folder", "sequence_folder", "audit_file", "layout"},
}
"""Parameters that the parameter files leave out."""
NO_DEFAULTS = {
    "camera": {"source": "v4l2", "right_device": "2", "rate_hz": 30.0, "width": 1280, "height": 720},
    "dense_stereo": {"limits.min_depth_m": 0.4, "limits.max_depth_m": 1.2, "limits.binning": 2},
}
"""Parameters that the parameter files set otherwise than the code."""


@pytest.mark.parametrize("program", [p for p in programs("test") if p.is_node], ids=lambda p: p.name)
def test_parameter_file_names_every_setting_and_holds_the_defaults(program: Program) -> None:
    files = [path for path in program.parameter_files if path.parent.name == "params"]
    (named,) = (entry for path in files for entry in file_values(path).values())
    config = config_class(program)
    left_out = {item.name for item in settings_of(config)} - set(named)
    assert left_out == FROM_THE_GRAPH.get(program.name, set()) and left_out <= set(program.parameters)
    otherwise = NO_DEFAULTS.get(program.name, {})
    assert to_mapping(from_mapping(config, named)) == {**to_mapping(config()), **otherwise}


def test_cameras_on_the_carriage_of_hardware_are_set_up_in_its_file() -> None:
    """carriage.yaml says that its keys go into hardware.yaml there: every node that has some must read that file."""
    named = {node.removeprefix("/**/") for node in file_values(ROOT / "config" / "params" / "carriage.yaml")}
    readers = {
        p.name for p in programs("hardware") if ROOT / "config" / "params" / "hardware.yaml" in p.parameter_files
    }
    assert named - {"bench"} - readers == set()


def test_nothing_but_the_machine_itself_touches_its_calibration() -> None:
    """A calibration of the bench, or of a recording, in the file of the real machine would have replaced its own."""
    kept = {}
    for profile in (*PROFILES, "carriage_test"):
        (node,) = (p for p in programs(profile) if p.name == "hand_eye")
        kept[profile] = node.parameters["calibration_file"]
    assert kept["hardware"] == "/state/hand_eye.yaml"
    assert kept["bench"] == kept["test"] == "/state/hand_eye_bench.yaml"
    assert kept["carriage"] == kept["carriage_test"] == "/state/hand_eye_carriage.yaml"
    assert kept["replay"] == ""


def test_a_recording_leaves_no_panels_among_the_layouts() -> None:
    (node,) = (p for p in programs("replay") if p.name == "recognition")
    assert node.parameters["teach_folder"] == ""


def test_every_parameter_file_is_used() -> None:
    used = {path for profile in PROFILES for p in programs(profile) for path in p.parameter_files}
    assert {path for path in used if path.parent.name == "params"} == set((ROOT / "config" / "params").glob("*.yaml"))


@pytest.mark.parametrize("program", [p for p in programs("test") if p.is_node], ids=lambda p: p.name)
def test_no_node_overwrites_an_attribute_of_rclpy(program: Program) -> None:
    """A node that sets ``self._parameters`` breaks its own parameter services; rclpy keeps its own under that name."""
    module = importlib.import_module(entry_points(program.package)[program.executable])
    assert module.__file__ is not None
    own = {name for name in vars(Node) if not name.startswith("__")} | set(rclpy_attributes())
    for node in ast.walk(ast.parse(Path(module.__file__).read_text())):
        targets = node.targets if isinstance(node, ast.Assign) else []
        names = {t.attr for t in targets if isinstance(t, ast.Attribute) and ast.unparse(t.value) == "self"}
        assert names & own == set()


def rclpy_attributes() -> list[str]:
    """Return the names that Node's constructor sets on itself."""
    source = inspect.getsource(Node.__init__)
    return re.findall(r"self\.(\w+)(?::[^=\n]+)? = ", source)


def texts_of(module_name: str) -> set[str]:
    """Return the strings in a node's module and in the modules of nodes that it uses; {side} is left and right."""
    module = importlib.import_module(module_name)
    assert module.__file__ is not None
    tree = ast.parse(Path(module.__file__).read_text())
    found = {n.value for n in ast.walk(tree) if isinstance(n, ast.Constant) and isinstance(n.value, str)}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            for side in ("left", "right"):
                found.add("".join(p.value if isinstance(p, ast.Constant) else side for p in node.values))
        elif isinstance(node, ast.ImportFrom) and re.match(r"(?!icu_common)\w+\.nodes\.", node.module or ""):
            found |= texts_of(str(node.module))
    return found


@pytest.mark.parametrize("program", [p for p in programs("test") if p.is_node], ids=lambda p: p.name)
def test_every_remapping_names_a_topic_of_the_node(program: Program) -> None:
    names = texts_of(entry_points(program.package)[program.executable])
    assert {source for source, _ in program.remappings} - names == set()


def test_every_remapping_leads_to_a_topic_that_somebody_publishes() -> None:
    """A target is the name of another node's topic: its namespace and one of the strings in its code."""
    nodes = [p for p in programs("test") if p.is_node]
    known = {
        f"{p.namespace.rstrip('/')}/{name}" for p in nodes for name in texts_of(entry_points(p.package)[p.executable])
    }
    targets = {target: p.name for p in nodes for _, target in p.remappings}
    from_people = {"/operator/heartbeat"}  # of the page, whose own name for it is remapped, and of the command line
    assert {t: name for t, name in targets.items() if t not in known | from_people} == {}
