"""The driver's node, its guard and mock_grbl: no trajectory leaves its space at the panel, by the motors' place."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from nodes.driver_operator import HOMED, IN_PROCESS, PATIENCE, Operator
from nodes.grbl_board import GrblBoard

from gantry_driver.core.envelope.plane import PanelPlane
from gantry_driver.nodes.panel_plane import plane_message, plane_of_message
from gantry_driver.nodes.serial_driver_node import SerialDriverNode
from icu_common.core.goals.results import GoalResult
from icu_common.nodes.qos import LATCHED

pytestmark = pytest.mark.long

FACE_M = 0.035
DOWN_M = FACE_M + 0.001
PLANE = PanelPlane(at_m=(0.18, 0.11, FACE_M), slope=(0.0, 0.0), covariance=(1e-8, 0, 0, 0, 0, 0, 0, 0, 0))


class Panel:
    """The program that moves the machine, under the controller's name unless another is given, and the deepest position
    of the stylus."""

    def __init__(self, ros: Any, folder: Path, name: str, **parameters: Any) -> None:
        self.ros, self.board = ros, GrblBoard(folder)
        ros.node(SerialDriverNode, {"port": str(self.board.port), **PATIENCE, **IN_PROCESS, **parameters})
        self.op = Operator(ros, self.board, name)
        self.plane = self.op.node.create_publisher(PoseWithCovarianceStamped, "panel/plane", LATCHED)
        self.deepest_mm = 0.0
        self.op.ready()

    def see(self, plane: PanelPlane = PLANE) -> None:
        self.plane.publish(plane_message(plane, int(self.op.node.get_clock().now().nanoseconds)))

    def go(self, *points: tuple[float, ...], frame: str = "") -> GoalResult:
        """Return the final answer; where the motors are is looked at meanwhile."""
        count = len(self.op.results)

        def final() -> bool:
            self.deepest_mm = max(self.deepest_mm, HOMED[2] - self.board.mpos()[2])
            return any(result.outcome.final for result in self.op.results[count:])

        self.op.go(*points, frame_id=frame)
        self.op.until(final)
        return next(result for result in self.op.results[count:] if result.outcome.final)

    def until_known(self) -> None:
        """Wait until the guard has the plane, by what it answers to a path that it refuses in any case."""
        self.op.until(lambda: self.go((0.0, 0.0, 0.059)).code == "too_deep")


@pytest.fixture
def panel(ros: Any, tmp_path: Path) -> Iterator[Callable[..., Panel]]:
    made: list[Panel] = []

    def make(name: str = "gantry_controller", **parameters: Any) -> Panel:
        made.append(Panel(ros, tmp_path, name, **parameters))
        return made[-1]

    yield make
    ros.close()
    ros.nodes.clear()
    for each in made:
        each.board.close()


@pytest.mark.parametrize("frame", ["", "press/", "drag/", "turn/", "move/"])
def test_full_extension_and_158_mm_sideways_from_a_foreign_program_move_nothing(
    panel: Callable[..., Panel], frame: str
) -> None:
    foreign = panel()
    since = foreign.board.log()[-1]["n"]
    path = ((0.1, 0.05, 0.0), (0.1, 0.05, 0.059), (0.258, 0.05, 0.059))
    unknown = foreign.go(*path, frame=frame)
    assert (unknown.outcome.value, unknown.code) == ("rejected", "no_panel")
    assert unknown.reason == "the panel's plane is unknown: the stylus would extend 59.0 mm (limit 16.0 mm)"
    foreign.see()
    foreign.until_known()
    deep = foreign.go(*path, frame=frame)
    assert (deep.outcome.value, deep.code) == ("rejected", "too_deep")
    assert dict(deep.details)["reading_m"] == "0.10000 0.05000 0.05900"
    assert foreign.board.mpos() == pytest.approx(HOMED, abs=0.001) and foreign.deepest_mm < 0.001
    assert not [line for line in foreign.board.lines(since) if "G1" in line["text"]]


def test_press_turn_and_drag_of_the_controller_are_followed_and_go_no_deeper(panel: Callable[..., Panel]) -> None:
    controller = panel()
    controller.see()
    controller.until_known()
    hover = FACE_M - 0.008
    for frame, x in (("turn/", 0.105), ("drag/", 0.2)):
        steps = [
            ("move/", ((0.1, 0.05, 0.0), (0.1, 0.05, hover))),
            ("move/", ((0.103, 0.053, hover), (0.102, 0.05, hover))),
            ("press/", ((0.102, 0.05, DOWN_M),)),
            (frame, ((x, 0.05, DOWN_M),)),
            ("move/", ((x, 0.05, 0.0),)),
        ]
        for name, points in steps:
            assert controller.go(*points, frame=name).outcome.value == "reached"
            last = points[-1]
            expected = (HOMED[0] + 1e3 * last[0], HOMED[1] + 1e3 * last[1], HOMED[2] - 1e3 * last[2])
            assert controller.board.mpos() == pytest.approx(expected, abs=0.02)
    assert controller.deepest_mm == pytest.approx(1e3 * DOWN_M, abs=0.02)


def test_another_program_that_is_allowed_presses_and_neither_turns_nor_drags(panel: Callable[..., Panel]) -> None:
    other = panel("other", trajectory_programs="other")
    other.see()
    other.until_known()
    assert other.go((0.1, 0.05, 0.0), (0.1, 0.05, DOWN_M)).outcome.value == "reached"
    for frame in ("", "drag/", "turn/"):
        refused = other.go((0.2, 0.05, DOWN_M), frame=frame)
        assert (refused.outcome.value, refused.code) == ("rejected", "sideways")
        assert refused.reason == "the path moves 100.0 mm sideways with the stylus extended (limit 7.0 mm)"
    assert other.board.mpos() == pytest.approx((HOMED[0] + 100, HOMED[1] + 50, HOMED[2] - 36), abs=0.02)
    assert other.go((0.1, 0.05, 0.0)).outcome.value == "reached"


def test_a_plane_from_a_program_that_may_not_move_the_machine_is_ignored(panel: Callable[..., Panel], ros: Any) -> None:
    other = panel("other", trajectory_programs="gantry_controller other")
    other.op.node.destroy_publisher(other.plane)
    other.plane = ros.plain("foreign").create_publisher(PoseWithCovarianceStamped, "panel/plane", LATCHED)
    other.op.until(lambda: other.plane.get_subscription_count() == 1)
    for _ in range(3):
        other.see()
        assert other.go((0.0, 0.0, 0.02)).code == "no_panel"


def test_a_second_source_of_the_plane_stops_the_machine(panel: Callable[..., Panel], ros: Any) -> None:
    controller = panel()
    controller.see()
    controller.until_known()
    ros.plain("foreign").create_publisher(PoseWithCovarianceStamped, "panel/plane", LATCHED)
    controller.op.state("stopped: two programs publish panel/plane: /foreign and /gantry_controller")


@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.1, -0.05), (-0.15, 0.12)])
def test_a_plane_survives_its_message(slope: tuple[float, float]) -> None:
    covariance = (4e-8, 1e-8, -2e-8, 1e-8, 9e-6, 3e-7, -2e-8, 3e-7, 1e-6)
    plane = PanelPlane(at_m=(0.18, 0.11, 0.034), slope=slope, covariance=covariance)
    found = plane_of_message(plane_message(plane, 17))
    assert found.at_m == pytest.approx(plane.at_m) and found.slope == pytest.approx(slope)
    assert found.covariance == pytest.approx(covariance)
    message = plane_message(plane, 17)
    x, y, extension = 0.05, 0.02, plane.contact_m(0.05, 0.02)
    normal = (-slope[0], -slope[1], -1.0)
    pose = message.pose.pose.position
    assert normal[0] * (x - pose.x) + normal[1] * (y - pose.y) + normal[2] * (-extension - pose.z) == pytest.approx(0.0)


@pytest.mark.parametrize("damage", ["frame", "nan", "behind", "covariance"])
def test_what_is_no_plane_is_refused(damage: str) -> None:
    message = plane_message(PLANE, 17)
    if damage == "frame":
        message.header.frame_id = "base_link"
    elif damage == "nan":
        message.pose.pose.position.z = float("nan")
    elif damage == "behind":
        message.pose.pose.orientation.x, message.pose.pose.orientation.w = 1.0, 0.0
    else:
        message.pose.covariance[14] = -1.0
    with pytest.raises(ValueError, match=r"frame|finite|faces|variance"):
        plane_of_message(message)
