"""Messages to the pages about the desk's state."""

from __future__ import annotations

from unit.scope_ui_bridge.desk_rig import BOOT, Rig, of_type, refusal

from scope_ui_bridge.core.config import BridgeConfig
from scope_ui_bridge.core.effects import (
    Broadcast,
    Effect,
)


def test_the_state_is_sent_on_change_at_most_ten_times_a_second_and_at_least_once() -> None:
    def states(effects: list[Effect]) -> list[dict]:
        return [e.message for e in of_type(effects, Broadcast) if e.message["type"] == "state"]

    rig = Rig()
    assert 2 <= len(states(rig.wait(3.0, alive=True))) <= 5
    sent = []
    for step in range(40):
        rig.desk.machine.set_position(0.001 * step, 0.02, 0.003, rig.now)
        sent += states(rig.wait(0.05, alive=True))
    assert 15 <= len(sent) <= 21
    assert sent[-1]["position_mm"][1:] == [20.0, 3.0]
    assert sent[-1]["driver"] == {"state": "idle", "reason": ""}


def test_a_place_that_no_driver_reports_any_more_is_not_shown() -> None:
    rig = Rig()
    for _ in range(4):
        rig.desk.machine.set_position(0.1, 0.05, 0.0, rig.now)
        rig.wait(0.5, alive=True)
        assert rig.desk.machine.message()["position_mm"] == [100.0, 50.0, 0.0]
    rig.wait(1.0, alive=True)
    assert rig.desk.machine.message()["position_mm"] is None, "the driver hangs or has ended; the stylus may be down"
    assert refusal(rig.jog(1, 0)) == "position_unknown"


def test_a_tip_that_was_seen_before_the_clock_was_set_back_is_not_seen_now() -> None:
    rig = Rig()
    rig.desk.scene.tip_ns = rig.now.ros_ns
    rig.wait(0.1)
    assert rig.desk.join("Operator 2")[1]["state"]["tip_seen"]
    rig.desk.scene.tip_ns += 3600 * 1_000_000_000
    rig.wait(0.1)
    assert not rig.desk.join("Operator 3")[1]["state"]["tip_seen"]


def test_a_new_page_gets_the_log_the_selection_and_the_state() -> None:
    rig = Rig()
    rig.select(control="RUN_STOP")
    rig.act()
    _, hello = rig.desk.join("Operator 2")
    assert (hello["boot"], hello["you"]["name"], hello["title"]) == (BOOT, "Operator 2", "DSO")
    assert [entry["action"] for entry in hello["log"]] == ["press"]
    assert hello["selection"]["control"] == "RUN_STOP"
    assert hello["state"]["calibration"] == {"state": "calibrated", "reason": "rms 0.1 mm"}
    assert hello["limits"] == {"amber_ms": 250.0, "max_age_ms": 500.0, "stale_ms": 1000.0, "jog_step_mm": 10.0}


def test_pages_that_are_open_follow_limits_that_change() -> None:
    rig = Rig()
    rig.wait(0.2)
    rig.desk.config = BridgeConfig(frame_max_age_s=0.8, jog_step_max_m=0.005)
    told = [e.message for e in of_type(rig.wait(0.5), Broadcast) if e.message["type"] == "limits"]
    changed = {"amber_ms": 250.0, "max_age_ms": 800.0, "stale_ms": 1000.0, "jog_step_mm": 5.0}
    assert told == [{"type": "limits", "limits": changed}]
