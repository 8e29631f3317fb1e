"""Programs of config/graph.yaml, with the modules and parameters that setup.py and the code give them."""

from __future__ import annotations

import ast
import functools
import importlib
from pathlib import Path
from typing import Any

from icu_bringup.core.startup.graph_description import Program, load_graph

ROOT = Path(__file__).resolve().parents[3]


@functools.cache
def programs(profile: str) -> list[Program]:
    return load_graph(ROOT / "config", profile, run=Path("/run"), state=Path("/state"))


def entry_points(package: str) -> dict[str, str]:
    """Return executable -> module, read from the package's setup.py; of a program that is a node too, the node's."""
    tree = ast.parse((ROOT / "src" / package / "setup.py").read_text())
    texts = [n.value for n in ast.walk(tree) if isinstance(n, ast.Constant) and isinstance(n.value, str)]
    pairs = [t.split("=", 1) for t in texts if ":main" in t]
    found = {name.strip(): place.partition(":")[0].strip() for name, place in pairs}
    if f"stereo = {package}.cli.stereo:stereo" in texts:
        found["stereo"] = f"{package}.nodes.stereo_node"  # 'stereo evaluate' is a program, 'stereo' the node
    return found


def config_class(program: Program) -> Any:
    """Return the dataclass that the node's parameters come from: the second argument of LiveParameters."""
    module = importlib.import_module(entry_points(program.package)[program.executable])
    assert module.__file__ is not None
    for call in ast.walk(ast.parse(Path(module.__file__).read_text())):
        if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "LiveParameters":
            return getattr(module, ast.unparse(call.args[1]))
    raise AssertionError(f"{module.__name__} has no LiveParameters")
