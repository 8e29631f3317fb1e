"""The driver's machine under any order of commands and faults, against what must hold in each state."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from campaign.faults import CONFIG
from campaign.virtual_link import VirtualRig
from hypothesis import Phase as Stage
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from gantry_driver.core.machine.machine import Machine
from gantry_driver.core.states.machine_states import MachinePhase
from icu_common.core.goals.results import Outcome

UP_MM = -1.1
"""Lowest z of a lifted stylus in machine coordinates: homing ends 1 mm from the switch."""
QUIET = MachinePhase.STOPPED, MachinePhase.IDLE, MachinePhase.UNHOMED, MachinePhase.ALARM, MachinePhase.MISMATCH
LONGEST_S = 90.0
"""Seconds in which every motion, stop and connection has ended."""
COLLECT_S = 1e-3
"""Seconds in which the rig collects the events of a command."""
UNIT = st.floats(0.0, 1.0)


class DriverUnderCommands(RuleBasedStateMachine):
    """Commands of a node and faults of the port, in simulated time, with the true position from the mock board."""

    @initialize(seed=st.integers(0, 2**16))
    def power_on(self, seed: int) -> None:
        self.rig = VirtualRig(CONFIG, seed)
        self.rig.home()
        self.goals = 0

    @rule(x=UNIT, y=UNIT, depth=UNIT, points=st.integers(1, 3))
    def order_a_trajectory(self, x: float, y: float, depth: float, points: int) -> None:
        self.goals += 1
        way = [(0.35 * x * k / points, 0.2 * y, 0.03 * depth if k == points else 0.0) for k in range(1, points + 1)]
        stopped, before = self.rig.machine.phase.state == "stopped", self.rig.mpos()
        answer = self.rig.go(way, f"goal {self.goals}")
        if stopped:
            assert answer.outcome is Outcome.REJECTED, "a stopped machine has accepted a goal"
        if answer.outcome is Outcome.REJECTED:
            assert self.rig.mpos() == before

    def _call(self, action: Callable[[Machine, float], object]) -> None:
        self.rig.call(action)
        self.rig.run_for(COLLECT_S)

    @rule(seconds=st.floats(0.01, 3.0))
    def wait(self, seconds: float) -> None:
        self.rig.run_for(seconds)

    @rule()
    def stop(self) -> None:
        self.rig.stop("stop requested")
        self.rig.run_for(COLLECT_S)

    @rule()
    def reset(self) -> None:
        self._call(lambda machine, now: machine.reset(now))

    @rule()
    def home(self) -> None:
        self._call(lambda machine, now: machine.home(now))

    @rule(on=st.booleans())
    def enable(self, on: bool) -> None:
        self._call(lambda machine, now: machine.enable(on, now))

    @rule(on=st.booleans())
    def activate(self, on: bool) -> None:
        self._call(lambda machine, now: machine.activate(on, now))

    @rule(seconds=st.floats(0.1, 2.0))
    def unplug(self, seconds: float) -> None:
        self.rig.fault("unplug", seconds=seconds)
        self.rig.run_for(COLLECT_S)

    @rule(number=st.sampled_from([1, 2, 3]))
    def raise_an_alarm(self, number: int) -> None:
        self.rig.fault("alarm", number=number)

    @precondition(lambda self: self.rig.machine.phase in QUIET)
    @rule(seconds=st.floats(0.1, 2.0))
    def watch_it_rest(self, seconds: float) -> None:
        phase, before = self.rig.machine.phase, self.rig.mpos()
        self.rig.run_for(seconds)
        if self.rig.machine.phase is phase:
            assert self.rig.mpos() == before, f"a machine in {phase.name} has moved"

    @invariant()
    def a_goal_is_accepted_once_and_answered_once(self) -> None:
        accepted = Counter(r.goal_id for r in self.rig.results if r.outcome is Outcome.ACCEPTED)
        final = Counter(r.goal_id for r in self.rig.results if r.outcome.final)
        assert all(count == 1 for count in (*accepted.values(), *final.values())), self.rig.results
        open_goals = set(accepted) - set(final)
        assert len(open_goals) <= (self.rig.machine.phase is MachinePhase.MOVING), (
            open_goals,
            self.rig.machine.state_text,
        )

    @invariant()
    def a_stopped_machine_has_lifted_its_stylus_or_reports_that_it_has_not(self) -> None:
        if self.rig.machine.phase is MachinePhase.STOPPED and not self.rig.machine.may_be_down:
            assert self.rig.mpos()[2] >= UP_MM, self.rig.machine.state_text

    def teardown(self) -> None:
        if not hasattr(self, "rig"):
            return
        self.rig.run_for(LONGEST_S)
        assert self.rig.machine.at_rest, self.rig.machine.state_text
        self.a_goal_is_accepted_once_and_answered_once()


TestDriverUnderCommands = DriverUnderCommands.TestCase
TestDriverUnderCommands.settings = settings(
    max_examples=60, stateful_step_count=20, deadline=None, phases=(Stage.explicit, Stage.generate)
)
