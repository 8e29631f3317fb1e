"""Files that make the project portable agree with the code: package.xml, setup.py, workflow, containers, launch
files."""

from __future__ import annotations

import ast
import importlib.util
import os
import pkgutil
import re
import runpy
import shutil
import subprocess
import sys
import types
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import setuptools
import yaml
from catkin_pkg.package import parse_package
from support.parameter_files import file_values, parameters

from icu_bringup.adapters.graph_ledger import path_of_graph
from icu_bringup.core.startup.graph_description import GraphDescriptionError, load_graph
from icu_bringup.export.adapters.reading import LIBRARIES
from icu_common.adapters.steps.step_ledger import LEDGER_VARIABLE

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[3]
PACKAGES = sorted(p.parent for p in ROOT.glob("src/*/package.xml"))
each_package = pytest.mark.parametrize("package", PACKAGES, ids=lambda p: p.name)

SYSTEM_KEYS = {
    "python3-aiohttp": "aiohttp",
    "python3-numba": "numba",
    "python3-numpy": "numpy",
    "python3-opencv": "cv2",
    "python3-serial": "serial",
    "python3-psutil": "psutil",
    "python3-yaml": "yaml",
}
"""Keys of rosdep (rosdistro/rosdep/python.yaml) and their modules; rosbags has none, numba none for Ubuntu."""
BY_NAME = {
    "aiohttp": "aiohttp",
    "numba": "numba",
    "numpy": "numpy",
    "opencv-python-headless": "cv2",
    "pyserial": "serial",
    "psutil": "psutil",
    "PyYAML": "yaml",
}
"""Names for pip and their modules."""
OF_ROS = {
    "ament_index_python", "builtin_interfaces", "diagnostic_msgs", "geometry_msgs", "launch", "launch_ros",
    "lifecycle_msgs", "rcl_interfaces", "rclpy", "rosgraph_msgs", "sensor_msgs", "std_msgs", "std_srvs", "stereo_msgs",
    "trajectory_msgs", "visualization_msgs",
}  # fmt: skip
"""Packages of Jazzy's ros-base."""
BY_PIP = {"rosbags", "apsw", "segno"}


def imports(package: Path) -> set[str]:
    found = set()
    for path in [*package.glob(f"{package.name}/**/*.py"), *package.glob("launch/*.py")]:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                found.add(node.module.partition(".")[0])
    return found - set(sys.stdlib_module_names) - {package.name}


@each_package
def test_package_xml_is_complete_for_bloom_and_names_what_is_imported(package: Path) -> None:
    warnings: list[str] = []
    description = parse_package(str(package), warnings=warnings)
    description.validate(warnings=warnings)
    assert warnings == []
    assert description.get_build_type() == "ament_python" and description.licenses == ["Apache-2.0"]
    assert description.maintainers and description.version, "what bloom needs"
    assert not [url.url for url in description.urls if ".example" in url.url], "an address that leads nowhere"
    named = {d.name for d in description.exec_depends}
    assert named <= OF_ROS | set(SYSTEM_KEYS) | {p.name for p in PACKAGES}, "a key that rosdep does not resolve"
    modules = {SYSTEM_KEYS.get(name, name) for name in named}
    optional = {
        "scipy",
        "matplotlib",
        "skimage",
        "foxglove",
        "pyarrow",
        "rerun",
    }  # only for evaluation, and asked for by name when missing
    assert imports(package) - modules - BY_PIP - optional == set()
    assert (named & OF_ROS) - imports(package) == set(), "named and used by nothing"


@each_package
def test_setup_py_says_the_same(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given: dict[str, Any] = {}
    monkeypatch.setattr(setuptools, "setup", lambda **keywords: given.update(keywords))
    monkeypatch.chdir(package)
    runpy.run_path("setup.py")
    description = parse_package(str(package))
    assert (given["name"], given["version"], given["license"]) == (package.name, description.version, "Apache-2.0")
    assert given["description"] == description.description
    for entry in given["entry_points"]["console_scripts"] if "entry_points" in given else ():
        module, _, function = entry.partition("=")[2].strip().partition(":")
        tree = ast.parse((package / (module.replace(".", "/") + ".py")).read_text())
        assert function in {n.name for n in tree.body if isinstance(n, ast.FunctionDef)}, entry
    assert f"\n## [{description.version}] - 20" in (ROOT / "CHANGELOG.md").read_text()
    if "libraries" in given.get("extras_require", {}):  # what pip brings where there is no rosdep
        keys = {d.name for d in description.exec_depends} & set(SYSTEM_KEYS)
        assert {BY_NAME[name] for name in given["extras_require"]["libraries"]} == {SYSTEM_KEYS[key] for key in keys}
    for _, files in given["data_files"]:
        assert all((package / file).is_file() for file in files), files


def test_the_extra_of_setup_py_installs_what_bag_export_names(monkeypatch: pytest.MonkeyPatch) -> None:
    given: dict[str, Any] = {}
    monkeypatch.setattr(setuptools, "setup", lambda **keywords: given.update(keywords))
    monkeypatch.chdir(ROOT / "src" / "icu_bringup")
    runpy.run_path("setup.py")
    assert given["extras_require"]["export"] == list(LIBRARIES.values())


@pytest.mark.parametrize("path", sorted(ROOT.glob("src/*/config/example.yaml")), ids=lambda path: path.parts[-3])
def test_a_packages_example_sets_what_its_nodes_have(path: Path) -> None:
    for pattern, values in file_values(path).items():
        known = parameters(pattern.rpartition("/")[2])
        assert {key: type(value) for key, value in values.items()} == {key: type(known[key]) for key in values}


def test_the_workflow_calls_what_exists() -> None:
    text = (ROOT / ".github" / "workflows" / "ci.yml").read_text()
    jobs = yaml.safe_load(text)["jobs"]
    assert jobs["jazzy"]["container"] == "ros:jazzy-ros-base"
    targets = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.M))
    assert set(re.findall(r"make (\w+)", text)) - {"python3"} <= targets
    for name in re.findall(r"tests/[\w/]+|scripts/[\w.]+", text):
        assert (ROOT / name).exists(), name
    for path in (
        ".pre-commit-config.yaml",
        "Dockerfile",
        ".devcontainer/devcontainer.json",
        "LICENSE",
        "CONTRIBUTING.md",
    ):
        assert (ROOT / path).stat().st_size > 200


def test_setting_up_refuses_a_folder_whose_programs_would_not_start(tmp_path: Path) -> None:
    """The first line of a script cannot name an interpreter in a folder with a blank; each program would be missing."""
    (tmp_path / "my röbot" / "scripts").mkdir(parents=True)
    script = shutil.copy(ROOT / "scripts" / "setup.sh", tmp_path / "my röbot" / "scripts")
    environment = {**os.environ, "PYTHON": "none"}
    done = subprocess.run(["bash", script], capture_output=True, text=True, timeout=20, check=False, env=environment)
    assert (done.returncode, done.stdout) == (1, "")
    assert f"error: {tmp_path / 'my röbot'} has a blank in its name" in done.stderr


def test_what_was_compiled_from_other_sources_is_not_used(tmp_path: Path) -> None:
    """Numba looks at the file of the function that it keeps, and not at those of the functions which that one calls."""
    setup = (ROOT / "scripts" / "setup.sh").read_text()
    compile_all = re.search(r"^compile\(\) \{.*?^\}", setup, re.DOTALL | re.MULTILINE)
    kept = tmp_path / "src" / "harris_perception" / "core" / "__pycache__"
    python = tmp_path / "venv" / "bin" / "python"
    kept.mkdir(parents=True)
    python.parent.mkdir(parents=True)
    for name in ("trace.nbi", "trace.1.nbc", "edges.pyc"):
        (kept / name).touch()
    python.write_text(f"#!/bin/sh\nls {kept} >> {tmp_path}/found\n")
    python.chmod(0o755)
    assert compile_all
    script = f"root={tmp_path} venv={tmp_path}/venv kernels=new terminal=yes\n{compile_all[0]}\ncompile"
    subprocess.run(["bash", "-euo", "pipefail", "-c", script], timeout=20, check=True)
    assert set((tmp_path / "found").read_text().split()) == {"edges.pyc"}
    assert (tmp_path / "venv" / ".compiled").read_text() == "new\n"


def test_the_environment_of_a_folder_that_was_moved_is_made_anew(tmp_path: Path) -> None:
    """Its scripts name the place where they were made: pip and mypy would not start, or be those of the original."""
    setup = (ROOT / "scripts" / "setup.sh").read_text()
    block = re.search(r"^# The virtual environment.*?(?=^# On Jazzy)", setup, re.DOTALL | re.MULTILINE)
    python = tmp_path / "python"
    python.write_text(
        '#!/bin/sh\nmkdir -p "$3/bin"\nfor name in python pip; do\n'
        '  printf \'#!/bin/sh\\necho 3.11\\n\' > "$3/bin/$name"\n  chmod +x "$3/bin/$name"\ndone\n'
    )
    python.chmod(0o755)

    def set_up(folder: Path) -> bool:
        assert block
        names = f"root={folder} venv={folder}/.venv python={python} version=3.11 jazzy=no"
        helpers = 'fail() { exit 1; }\nstep() { echo "$1"; }\nwait_for() { "$@"; }\nneeded_mb=0'
        script = f"{helpers}\n{names}\n{block[0]}"
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", script],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=20,
            check=True,
        )
        return "[1/4]" in done.stdout

    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir()
    assert [set_up(first), set_up(first)] == [True, False]
    first.rename(second)
    assert [set_up(second), set_up(second)] == [True, False]
    first.symlink_to(second)
    assert not set_up(first), "by another name it is the same folder"


class Recorded:
    """Stands for an action or substitution of `launch`, which is not among the wheels: keeps what it was given."""

    def __init__(self, *values: Any, **keywords: Any) -> None:
        self.values, self.keywords = values, keywords

    def perform(self, context: dict[str, str]) -> str:
        return context[self.values[0]]


def launch_modules(share: Path) -> dict[str, types.ModuleType]:
    kinds = {
        "launch": ["LaunchDescription", "LaunchContext"],
        "launch.actions": ["DeclareLaunchArgument", "ExecuteProcess", "IncludeLaunchDescription", "OpaqueFunction"],
        "launch.substitutions": ["LaunchConfiguration"],
        "launch.launch_description_sources": ["PythonLaunchDescriptionSource"],
        "launch_ros": [],
        "launch_ros.actions": ["Node"],
        "launch_ros.substitutions": ["ExecutableInPackage"],
        "ament_index_python": [],
        "ament_index_python.packages": [],
    }
    modules = {name: types.ModuleType(name) for name in kinds}
    for name, classes in kinds.items():
        for kind in classes:
            setattr(modules[name], kind, type(kind, (Recorded,), {}))
    modules["ament_index_python.packages"].get_package_share_directory = lambda name: str(share)  # type: ignore[attr-defined]
    return modules


@pytest.mark.parametrize("profile", ["bench", "test", "hardware", "replay"])
def test_who_starts_the_graph_depends_on_the_packages_of_its_programs(profile: str, tmp_path: Path) -> None:
    """Else ``colcon build --packages-up-to icu_bringup``, or its package alone, gives a graph that cannot start."""
    programs = load_graph(ROOT / "config", profile, run=tmp_path / "run", state=tmp_path)
    named = {d.name for d in parse_package(str(ROOT / "src/icu_bringup")).exec_depends}
    assert {program.package for program in programs} - {"icu_bringup"} <= named


@pytest.mark.parametrize("profile", ["bench", "test", "hardware", "replay"])
@pytest.mark.parametrize(("namespace", "real_time"), [("", "false"), ("bed_1", "false"), ("", "true")])
def test_ros2_launch_starts_the_graph_that_bring_up_starts(
    profile: str, namespace: str, real_time: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The launch file runs with recording substitutes; it would start the programs of bring-up's table."""
    for name, module in launch_modules(ROOT).items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setenv("ROS_DOMAIN_ID", f"of {tmp_path.name} {os.getpid()}")  # names are held by this process
    launch = runpy.run_path(str(ROOT / "src/icu_bringup/launch/graph.launch.py"))
    declared = {
        a.values[0]
        for a in launch["generate_launch_description"]().values[0]
        if type(a).__name__ == "DeclareLaunchArgument"
    }
    context = {"profile": profile, "config": str(ROOT / "config"), "state": str(tmp_path), "namespace": namespace}
    context |= {"scope": "", "room": "", "package": "", "run": str(tmp_path / "run"), "real_time": real_time}
    assert declared == set(context)
    started = launch["start"](context)
    stepped = real_time == "false" and profile in ("bench", "test")
    ledger = {LEDGER_VARIABLE: str(path_of_graph(namespace))} if stepped else {}
    programs = load_graph(
        ROOT / "config",
        profile,
        run=tmp_path / "run",
        state=tmp_path,
        robot_namespace=namespace,
        simulated_time=stepped,
    )
    assert Path(ledger[LEDGER_VARIABLE]).is_file() if stepped else not path_of_graph(namespace).exists()
    for action, program in zip(started, programs, strict=True):
        given = action.keywords
        assert given["additional_env"] == ledger, program.name
        if not program.is_node:
            assert given["cmd"][0].keywords == {"package": program.package, "executable": program.executable}
            assert given["cmd"][1:] == list(program.arguments)
            continue
        assert (given["package"], given["executable"]) == (program.package, program.executable)
        assert (given["name"], given["namespace"]) == (program.name, program.namespace)
        assert given["parameters"] == [*map(str, program.parameter_files), dict(program.parameters)]
        assert given["remappings"] == list(program.remappings)


@pytest.mark.parametrize("namespace", ["", "bed_1"])
def test_ros2_launch_keeps_each_robots_files_where_bring_up_does(
    namespace: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two robots on one host: the calibration of one is wrong for the other. New cameras' files need no new build."""
    (tmp_path / "config").mkdir()
    (tmp_path / "config" / "graph.yaml").symlink_to(ROOT / "config" / "graph.yaml")  # as colcon does, file by file
    for name, module in launch_modules(tmp_path).items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("ROS_DOMAIN_ID", f"of {tmp_path.name} {os.getpid()}")  # names are held by this process
    launch = runpy.run_path(str(ROOT / "src/icu_bringup/launch/graph.launch.py"))
    context = {
        a.values[0]: a.keywords["default_value"]
        for a in launch["generate_launch_description"]().values[0]
        if type(a).__name__ == "DeclareLaunchArgument"
    }
    started = launch["start"](context | {"profile": "hardware", "namespace": namespace, "run": str(tmp_path / "run")})
    given = {action.keywords["name"]: action.keywords["parameters"][-1] for action in started}
    folder = tmp_path / "state" / "icu_gantry" / namespace
    assert given["hand_eye"]["calibration_file"] == str(folder / "hand_eye.yaml")
    assert given["camera"]["left_calibration"] == str(ROOT / "config" / "cameras" / "left.yaml")
    assert given["ui_bridge"]["passwords_file"] == str(folder / "passwords")
    assert folder.stat().st_mode & 0o777 == 0o700


def test_ros2_launch_refuses_a_second_graph_and_a_namespace_that_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The orders of the second would reach the first one's machine; of a bring_up in another process as well."""
    for name, module in launch_modules(ROOT).items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setenv("ROS_DOMAIN_ID", f"of {tmp_path.name} {os.getpid()}")  # names are held by this process
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    start = runpy.run_path(str(ROOT / "src/icu_bringup/launch/graph.launch.py"))["start"]
    given = {
        "profile": "hardware",
        "config": str(ROOT / "config"),
        "state": "",
        "namespace": "",
        "scope": "",
        "room": "",
    }
    given |= {"package": "", "run": str(tmp_path / "run"), "real_time": "false"}
    with pytest.raises(GraphDescriptionError, match=r"namespace \.\./bed; expected names of letters"):
        start(given | {"namespace": "../bed"})
    assert list(tmp_path.iterdir()) == []
    assert start(given | {"package": "gantry_driver"}), "a part may come to a graph"
    assert start(given)
    with pytest.raises(GraphDescriptionError, match=f"runs already in ROS domain of {tmp_path.name}"):
        start(given)
    bring_up = [sys.executable, "-m", "icu_bringup.cli.bring_up", "--config", str(ROOT / "config")]
    second = subprocess.run(bring_up, capture_output=True, text=True, timeout=60, check=False)
    assert second.returncode == 2 and "a graph of these names runs already" in second.stderr
    assert start(given | {"package": "gantry_driver"}) and start(given | {"namespace": "bed_2"})


@pytest.mark.parametrize("path", sorted((ROOT / "benchmarks").rglob("*.py")), ids=lambda p: p.stem)
def test_benchmarks_find_what_they_import_of_the_project(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tests do not run them, and some imports wait inside functions."""
    folders = ROOT / "benchmarks", ROOT / "tests"
    own = {p.stem for folder in folders for p in folder.iterdir()} | {p.name for p in PACKAGES}
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] in own:
            module = importlib.import_module(str(node.module))
            for alias in node.names:
                assert hasattr(module, alias.name) or importlib.util.find_spec(f"{node.module}.{alias.name}"), (
                    alias.name
                )


def test_the_example_of_a_single_package_runs_without_ros(tmp_path: Path) -> None:
    """With the path that the page names, in an interpreter in which nothing of ROS can be imported."""
    readme = (ROOT / "docs" / "how-to" / "single-packages.md").read_text()
    example = re.search(r"```python\n(.*?)```", readme, re.DOTALL)
    path = re.search(r"`PYTHONPATH=(\S+)`", readme)
    assert example and path
    cv2.imwrite(str(tmp_path / "picture.jpg"), np.kron(np.eye(4, dtype=np.uint8) * 255, np.ones((16, 16), np.uint8)))
    without = f"import sys\nsys.modules.update(dict.fromkeys({sorted(OF_ROS)!r}))\n"
    done = subprocess.run(
        [sys.executable, "-c", without + example[1]],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(str(ROOT / part) for part in path[1].split(":"))},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0 and done.stdout.startswith("[["), done.stderr


@pytest.mark.parametrize(
    "path",
    [ROOT / "README.md", *sorted(ROOT.glob("docs/**/*.md")), *sorted(ROOT.glob("src/*/README.md"))],
    ids=lambda p: str(p.relative_to(ROOT)),
)
def test_documents_name_modules_that_are_there(path: Path) -> None:
    packages = "|".join(package.name for package in PACKAGES)
    for name in re.findall(rf"\b(?:{packages})(?:\.\w+)+", path.read_text()):
        assert pkgutil.resolve_name(name), name


CORES = [ROOT / "src" / name / name / "core" for name in ("harris_perception", "gantry_driver")]
ROOMS = [room for core in CORES for room in (core, *sorted(path.parent for path in core.glob("*/__init__.py")))]


@pytest.mark.parametrize("room", ROOMS, ids=lambda p: "/".join(p.parts[-3:]))
def test_each_room_names_what_it_holds_in_its_map(room: Path) -> None:
    named = re.findall(r"``(\w+)``", ast.get_docstring(ast.parse((room / "__init__.py").read_text())) or "")
    held = [path.stem for path in room.glob("*.py") if path.stem != "__init__"]
    held += [path.parent.name for path in room.glob("*/__init__.py")]
    assert sorted(held) and set(held) == set(named)
    assert len(held) < 15, "a room has at most 15 files, its map included"
