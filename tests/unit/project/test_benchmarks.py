"""Benchmarks run by hand and seldom: does each still start? Most of their measurements take too long to run here.

Of all, the imports and the options are tried (names and arguments that are gone are mypy's to find). Those that time
functions measure once, small and without photographs, and the latency's starts its processes for a few pictures.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.long

FOLDER = Path(__file__).parents[3] / "benchmarks"
FILES = (*FOLDER.rglob("bench_*.py"), FOLDER / "robot/soak.py")
NAMES = sorted(".".join(path.relative_to(FOLDER).with_suffix("").parts) for path in FILES)
SMALL = ((160, 120),)


def benchmark(name: str, monkeypatch: pytest.MonkeyPatch, *arguments: str) -> Any:
    """Return a benchmark's module, imported as where it is started."""
    monkeypatch.setattr(sys, "path", [str(FOLDER), *sys.path])
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    return importlib.import_module(name)


@pytest.mark.parametrize("name", NAMES)
def test_it_is_imported_and_tells_its_options(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module = benchmark(name, monkeypatch, "--help")
    with pytest.raises(SystemExit) as ended:
        module.main()
    assert ended.value.code == 0
    assert module.__doc__.split()[:5] == capsys.readouterr().out.partition("\n\n")[2].split()[:5]


@pytest.mark.parametrize(
    ("name", "arguments", "results"),
    [
        ("perception.bench_edges", [], "edges"),
        ("perception.bench_harris", ["--default-malloc"], "harris_default_malloc"),
        ("perception.bench_stereo", [], "stereo"),
    ],
)
def test_it_measures(
    name: str, arguments: list[str], results: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    module = benchmark(name, monkeypatch, *arguments)
    rows = importlib.import_module("rows")
    measure = rows.interleaved_ms
    monkeypatch.setattr(module, "interleaved_ms", lambda calls, **_: measure(calls, repeats=1, warm=0))
    monkeypatch.setattr(module, "SIZES", SMALL, raising=False)
    monkeypatch.setattr(rows, "OUT", tmp_path)
    monkeypatch.delenv("ICU_TEST_DATA", raising=False)
    assert module.main() == 0
    written = json.loads((tmp_path / f"{results}.json").read_text())
    assert len(written) >= 4 and all(row["what"] and row["ours"] == row["ours"] for row in written)


def test_the_latencys_processes_find_each_other(tmp_path: Path) -> None:
    """Node and peer are started with options of their own; all of them are the benchmark's file again."""
    imports = "import sys, pathlib, rows, perception.bench_graph_latency as latency"
    code = f"{imports}; rows.OUT = pathlib.Path(sys.argv.pop()); latency.main()"
    path = os.pathsep.join([str(FOLDER), *(p for p in sys.path if p)])
    done = subprocess.run(
        [sys.executable, "-c", code, "--seconds", "1", str(tmp_path)],
        env={**os.environ, "PYTHONPATH": path, "ROS_LOG_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=110,
    )
    assert done.returncode == 0, done.stderr
    written = json.loads((tmp_path / "graph_latency.json").read_text())
    assert written[0]["ours"] > 0 and written[0]["peer"] > 0, written
