"""Which programs use the processor: measured for real, named as people know them, off any callback's thread."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path

import pytest

from icu_common.adapters.processes.processor_load import LoadMeter, measure_processor_load
from icu_common.core.processes.processor_load import ProcessorLoad, ProgramLoad, is_of_robot, program_name, sorted_loads

WITHIN_S = 20.0


def test_a_program_that_computes_is_found_with_its_share_and_its_script(tmp_path: Path) -> None:
    script = tmp_path / "lib" / "icu_simulator" / "busy_bench"
    script.parent.mkdir(parents=True)
    script.write_text("print('up', flush=True)\nwhile True: pass\n")
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None and process.stdout.readline() == b"up\n"
            load = measure_processor_load()
        finally:
            process.kill()
    found = [program for program in load.programs if program.name == "busy_bench"]
    assert len(found) == 1 and found[0].own and 1.0 < found[0].percent < 110.0, load
    assert load.cores >= 1 and load.load_average >= 0.0


@pytest.mark.parametrize(
    ("executable", "arguments", "name"),
    [
        ("cc1plus", ["/usr/lib/cc1plus", "-quiet"], "cc1plus"),
        ("python3", ["/venv/bin/python3", "-u", "/x/lib/p/corners", "--ros-args"], "corners"),
        ("python3.11", ["python3.11", "-m", "pytest", "-q"], "pytest"),
        ("python3", ["python3", "-c", "pass"], "python3"),
        ("python3", ["python3"], "python3"),
        ("kworker", [], "kworker"),
    ],
)
def test_an_interpreter_has_the_name_of_what_it_runs(executable: str, arguments: list[str], name: str) -> None:
    assert program_name(executable, arguments) == name


def test_the_robots_own_programs_are_marked_and_the_three_largest_are_named() -> None:
    assert is_of_robot(["/venv/bin/python", "/w/install/gantry_driver/lib/gantry_driver/x"], ["gantry_driver"])
    assert not is_of_robot(["/usr/bin/python3", "/usr/lib/python3/x"], ["gantry_driver"])
    one, two = (ProgramLoad(name="cc1plus", percent=p, own=False) for p in (45.0, 50.0))
    rest = [
        ProgramLoad(name=n, percent=p, own=n == "corners") for n, p in (("corners", 60.0), ("a", 20.0), ("b", 12.0))
    ]
    load = ProcessorLoad(cores=2, load_average=7.06, programs=sorted_loads([one, *rest, two]))
    assert load.text() == (
        "load 7.1 on 2 cores, the robot uses 60 %, other programs 127 %: cc1plus 95 %, corners (robot) 60 %, a 20 %"
    )
    assert load.busy and not ProcessorLoad(cores=3, load_average=7.0, programs=load.programs).busy
    idle = ProcessorLoad(cores=2, load_average=0.2, programs=(ProgramLoad(name="a", percent=3.0, own=False),))
    assert (
        idle.text() == "load 0.2 on 2 cores, the robot uses 0 %, other programs 3 %: no program of the robot needs much"
    )


def test_a_meter_measures_once_for_several_messages_and_in_another_thread() -> None:
    may_end, threads = threading.Event(), []

    def measure() -> ProcessorLoad:
        threads.append(threading.current_thread())
        assert may_end.wait(WITHIN_S)
        return ProcessorLoad(cores=2, load_average=1.0, programs=())

    meter, said = LoadMeter(measure), []
    meter.describe(lambda text: said.append(f"first {text}"))
    meter.describe(lambda text: said.append(f"second {text}"))
    assert said == []
    may_end.set()
    meter.finish(WITHIN_S)
    text = "load 1.0 on 2 cores, the robot uses 0 %, other programs 0 %: no program of the robot needs much"
    assert said == [f"first {text}", f"second {text}"]
    meter.describe(lambda text: said.append(f"third {text}"))
    assert said[2] == f"third {text}" and len(threads) == 1 and threads[0] is not threading.current_thread()


def test_a_message_is_said_also_where_the_load_cannot_be_measured() -> None:
    def closed() -> ProcessorLoad:
        raise PermissionError("/proc")

    meter, said = LoadMeter(closed), []
    meter.describe(said.append)
    meter.finish(WITHIN_S)
    assert said == [""]
