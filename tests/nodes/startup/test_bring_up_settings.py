"""The value of ``bring_up --set`` reaches its node, also where a file for this node names another value."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rclpy.node import Node
from support.ros_rig import Ros

from icu_bringup.cli import bring_up, graph_run

CONFIG = Path(__file__).resolve().parents[3] / "config"


def started(
    ros: Ros,
    given: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    rescues: dict[str, list[str]] | None = None,
) -> dict[str, dict[str, Any]]:
    """Return each program's parameters, as rclpy reads its command line; note the programs' rescues in ``rescues``."""
    taken: dict[str, dict[str, Any]] = {}

    class Reader:
        gave_up = ()
        hanging: frozenset[int] = frozenset()

        def __init__(self, *_: Any, **__: Any) -> None:
            self.misconfigured: list[str] = []

        def start(self, name: str, command: list[str], rescue: list[str], **_: Any) -> None:
            if rescues is not None and rescue:
                rescues[name] = rescue
            node = Node("any", context=ros.context, cli_args=command[1:], use_global_arguments=False)
            taken[name] = {key: parameter.value for key, parameter in node._parameter_overrides.items()}
            node.destroy_node()

        def ready_count(self) -> int:
            return len(taken)

        def running(self) -> dict[str, dict[str, Any]]:
            return taken

        def watch(self, _: float) -> None:
            self.misconfigured = ["the test's end"]

        def stop(self, on_ended: Callable[[str, float], None]) -> list[str]:
            return []

    monkeypatch.setattr(graph_run, "ProcessGroup", Reader)
    monkeypatch.setattr(graph_run, "find_executable", lambda _, executable, __: Path(executable))
    monkeypatch.setattr("signal.signal", lambda *_: None)  # the test keeps its own
    monkeypatch.setattr("sys.argv", ["bring_up", "--config", str(CONFIG), "--state", str(tmp_path / "state"), *given])
    assert bring_up.main() == 0
    return taken


def test_a_single_value_wins_over_the_file_of_the_profile(
    ros: Ros, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = ["--profile", "hardware", "--only", "serial_driver", "--only", "camera"]
    given += ["--set", "serial_driver.port=/dev/ttyACM0"]
    given += ["--set", "serial_driver.machine.travel_mm=[300.0, 200.0, 40.0]"]
    given += ["--set", 'camera.right_device="4"', "--set", "camera.left_calibration=/lab/left.yaml"]
    given += ["--set", "camera.rate_hz=3e+1"]
    taken = started(ros, given, tmp_path, monkeypatch)
    driver, camera = taken["serial_driver"], taken["camera"]
    assert (driver["port"], driver["machine.travel_mm"]) == ("/dev/ttyACM0", [300.0, 200.0, 40.0])
    assert driver["machine.homing_direction_mask"] == 3  # what is not given stays
    assert (camera["right_device"], camera["left_device"]) == ("4", "0")
    assert camera["left_calibration"] == "/lab/left.yaml"
    assert camera["right_calibration"] == f"{CONFIG}/cameras/right.yaml"
    assert camera["rate_hz"] == 30.0


@pytest.mark.parametrize(
    ("given", "name"),
    [
        (["--only", "serial_driver", "--only", "camera"], "serial_driver"),
        (["--only", "serial_driver", "--only", "camera", "--composed"], "composed"),
        (["--only", "camera"], ""),
    ],
)
def test_the_driver_s_rescue_is_a_guard_of_its_port(
    ros: Ros, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: list[str], name: str
) -> None:
    rescues: dict[str, list[str]] = {}
    port = ["--set", "serial_driver.port=/dev/ttyACM0"] if name else []
    started(ros, ["--profile", "hardware", *given, *port], tmp_path, monkeypatch, rescues)
    assert rescues == ({name: ["gantry_guard", "--port", "/dev/ttyACM0", "--recover"]} if name else {})


def test_a_single_value_of_a_robot_in_a_namespace(ros: Ros, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given = ["--profile", "carriage", "--namespace", "bed_1/left", "--only", "gantry_controller"]
    given += ["--set", "gantry_controller.look_timeout_s=20.0"]
    controller = started(ros, given, tmp_path, monkeypatch)["gantry_controller"]
    assert (controller["look_timeout_s"], controller["camera_timeout_s"]) == (20.0, 4.0)


@pytest.mark.parametrize(
    ("given", "simulated"),
    [
        ([], True),
        (["--without", "ui_bridge"], True),
        (["--real-time"], False),
        (["--without", "bench"], False),
        (["--only", "gantry_controller"], False),
        (["--profile", "hardware", "--without", "camera", "--without", "ui_bridge"], False),
    ],
)
def test_graph_whose_hardware_is_all_simulated_runs_by_simulated_time(
    ros: Ros, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: list[str], simulated: bool
) -> None:
    monkeypatch.setattr(bring_up, "hold_names", lambda _: None)  # a process holds them until it ends
    monkeypatch.setattr(graph_run, "WAIT_S", 0.0)
    taken = started(ros, given, tmp_path, monkeypatch)
    assert taken["gantry_controller"].get("use_sim_time", False) is simulated
    if "bench" in taken:
        assert taken["bench"].get("stepped", False) is simulated
