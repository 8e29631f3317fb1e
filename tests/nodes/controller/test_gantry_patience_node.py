"""The controller's node with slow surroundings: late images, a late goal; what is slow is named."""

from __future__ import annotations

from typing import Any

import numpy as np
from nodes.gantry_bench import RUN_STOP, GantryBench
from rcl_interfaces.msg import Log
from std_msgs.msg import String

from icu_common.core.geometry.frames import BASE
from icu_common.core.goals.results import Outcome
from icu_common.core.processes.delays import delay_of
from icu_common.nodes import qos
from icu_common.nodes.messages.heads import header
from icu_common.nodes.messages.places import point_message


def ready(ros: Any, parameters: dict[str, Any] | None = None) -> GantryBench:
    bench = GantryBench(ros, parameters)
    bench.connect_goals()
    bench.see()
    bench.spin_until_state("ready")
    return bench


def test_images_that_are_late_by_more_than_a_look_reach_the_target_on_a_later_look(ros: Any) -> None:
    bench = ready(ros, {"look_timeout_s": 2.0})
    logs: list[Log] = ros.collect(bench.node, Log, "/rosout", qos.RESULTS)
    bench.late_s = 2.2
    bench.command.publish(String(data="press:RUN_STOP"))
    result = bench.spin_until_final(within_s=60.0)
    assert result.outcome is Outcome.REACHED, result
    assert result.error_m < 1e-4 and dict(result.details)["control"] == "RUN_STOP"
    pressed = [m for m in bench.trajectories if m.points[-1].positions[2] > 0.03]
    assert len(pressed) == 1, "it is touched once"
    np.testing.assert_allclose(pressed[0].points[-1].positions[:2], RUN_STOP[:2], atol=1e-4)
    late = "image that the stylus tracker has evaluated is late"
    said = [late, "waiting up to 4 s; load ", " on "]
    ros.spin_until(lambda: any(all(part in m.msg for part in said) for m in logs), 10.0, lambda: [m.msg for m in logs])


def test_a_stale_goal_has_a_code_and_names_what_uses_the_processor(ros: Any) -> None:
    bench = ready(ros, {"goal_max_age_s": 0.5})
    old_ns = bench.now_ns() - 1_000_000_000
    bench.goal.publish(point_message((0.2, 0.1, 0.0), header(old_ns, BASE)))
    result = bench.spin_until_final()
    assert result.outcome is Outcome.REJECTED and result.code == "stale" and result.goal_id == str(old_ns)
    delay = delay_of(result)
    assert delay is not None and delay.limit_s == 0.5 and 1.0 <= delay.measured_s < 2.0
    assert "(limit 0.5 s); load " in result.reason and " on " in result.reason
    assert not bench.trajectories
