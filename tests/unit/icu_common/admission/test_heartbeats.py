"""Programs of this project send heartbeats side by side; a stranger must be the only sender."""

from __future__ import annotations

from icu_common.core.admission.heartbeats import HEARD_S, PROGRAMS, HeartbeatSources

PAGE, GOAL, STRANGER = "/bed_1/ui_bridge", "/bed_1/gantry_goal", "/_ros2cli_7"
TOPIC = "/bed_1/operator/heartbeat"


def test_page_and_command_line_send_side_by_side() -> None:
    watched = HeartbeatSources(PROGRAMS)
    assert watched.heard(PAGE, 0.0) and watched.heard(GOAL, 0.1)
    assert watched.judge(TOPIC, [PAGE, GOAL]) == ""
    assert watched.senders([PAGE, GOAL]) == [PAGE, GOAL]


def test_page_without_an_operator_leaves_room_for_a_stranger() -> None:
    watched = HeartbeatSources(PROGRAMS)
    watched.heard("terminal", 0.0)
    assert watched.judge(TOPIC, [PAGE, STRANGER]) == ""
    assert watched.senders([PAGE, STRANGER]) == [STRANGER]


def test_stranger_beside_a_page_that_sends_is_one_too_many_until_one_stops() -> None:
    watched = HeartbeatSources(PROGRAMS)
    assert watched.heard(PAGE, 0.0) and not watched.heard(PAGE, 0.1)
    text = watched.judge(TOPIC, [PAGE, STRANGER])
    assert text == "two programs publish bed_1/operator/heartbeat: /_ros2cli_7 and /bed_1/ui_bridge"
    assert watched.judge(TOPIC, [PAGE]) == ""
    watched.heard("terminal", 0.2 + HEARD_S)
    assert watched.judge(TOPIC, [PAGE, STRANGER]) == "", "nobody has control on the page any more"
    assert watched.heard(PAGE, 0.3 + HEARD_S), "somebody has again"
    assert watched.judge(TOPIC, [PAGE, STRANGER])


def test_two_strangers_are_one_too_many() -> None:
    assert HeartbeatSources(PROGRAMS).judge(TOPIC, [STRANGER, "/other"])


def test_programs_are_set() -> None:
    watched = HeartbeatSources("mine")
    watched.heard(PAGE, 0.0)
    assert watched.judge(TOPIC, [PAGE, "/mine"]) == "", "mine has sent nothing"
    assert watched.heard("/mine", 0.1)
    assert watched.judge(TOPIC, [PAGE, "/mine"])
