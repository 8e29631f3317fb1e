"""Look-move-touch on a machine with backlash, scale, skew and noise that the controller does not know."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from unit.gantry_driver.controller_bench import BASE_FROM_PANEL, BUTTON, PANEL, Bench, RidingBench, config

from gantry_driver.core.goals.controller import Controller
from gantry_driver.core.job import controller_messages as msg
from gantry_driver.core.job.goal_job import GoalPhase
from gantry_driver.core.motion.scene import PanelControl
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.goals.results import Felt, Outcome

SEEDS = range(20)


def sloppy_bench(seed: int, kind: type[Bench] = Bench) -> Bench:
    """Errors as large as the machine is allowed to have; the calibration knows none of them."""
    rng = np.random.default_rng(seed)
    bench = kind(seed=seed)
    scale, skew = rng.uniform(-0.004, 0.004, 2), rng.uniform(-0.003, 0.003)
    bench.true_axes = np.array([[1 + scale[0], skew], [0.0, 1 + scale[1]]])
    bench.backlash = rng.uniform(0.00015, 0.00025, 2)
    bench.noise_m = np.array([4e-5, 4e-5, 1.5e-4])
    return bench


@pytest.mark.parametrize("kind", [Bench, RidingBench])
@pytest.mark.parametrize("seed", SEEDS)
def test_true_error_at_contact(seed: int, kind: type[Bench]) -> None:
    print(f"seed {seed}")
    bench = sloppy_bench(seed, kind).start()
    for name in ("RUN_STOP", "CH1", "CH1_SCALE", "SCREEN"):
        bench.lowest.clear()
        result = bench.do(f"press:{name}")
        assert result.outcome is Outcome.REACHED, result
        control = next(c for c in PANEL.controls if c.name == name)
        surface = BASE_FROM_PANEL.apply([*control.centre, control.height])
        contact = min(bench.lowest, key=lambda p: p[2])
        true_error = float(np.linalg.norm(contact[:2] - surface[:2]))
        # Tolerance 0.15 mm plus the noise of the mean of five looks.
        assert true_error < 0.00025, (name, true_error)
        assert result.error_m < 0.00025
        assert abs(result.error_m - true_error) < 0.0001
        sunk = bench.stroke_m if control.kind == "button" else 0.0
        assert contact[2] == pytest.approx(surface[2] + 0.002 - sunk, abs=2e-5), "pressed to the end"
        assert result.touch is Felt.TOUCHED, "nothing shows an effect here"
        assert int(dict(result.details)["corrections"]) <= 2


@pytest.mark.parametrize("kind", [Bench, RidingBench])
@pytest.mark.parametrize("gesture", ["drag:0.05,0.06@panel_link:0.12,0.10@panel_link", "turn:CH1_SCALE:40"])
@pytest.mark.parametrize("seed", range(3))
def test_an_arc_is_measured_where_it_began(seed: int, gesture: str, kind: type[Bench]) -> None:
    """Cameras on the carriage have moved along it when the contact is judged: it was 81 mm off the target."""
    bench = sloppy_bench(seed, kind).start()
    result = bench.do(gesture)
    assert result.outcome is Outcome.REACHED, result
    began = next(p for p in bench.lowest if p[2] < min(p[2] for p in bench.lowest) + 2e-5)
    place = dict(result.details)["target_base_m"]
    true_error = float(np.linalg.norm(began[:2] - np.array([float(v) for v in place.split()])[:2]))
    assert true_error < 0.0003 and abs(result.error_m - true_error) < 0.0001


def test_without_servoing_the_same_machine_misses() -> None:
    errors = []
    for seed in SEEDS:
        bench = sloppy_bench(seed).start()
        bench.go(*BASE_FROM_PANEL.apply([0.208, 0.127, 0.003])[:2])
        errors.append(np.linalg.norm(bench.tip_in_base()[:2] - BASE_FROM_PANEL.apply([0.208, 0.127, 0.003])[:2]))
    assert np.median(errors) > 0.0004, "the errors are too small to show anything"


def dazzling_bench(kind: type[Bench], within_m: float, **changes: object) -> Bench:
    """A sloppy bench whose RUN_STOP shines in the ball's colour."""
    bench = sloppy_bench(8, kind)
    bench.controller = Controller(config(camera_on_carriage=kind is RidingBench, **changes))
    bench.talking.add("state")
    bench.dazzle_m = within_m
    return bench.start()


def away(bench: Bench, tip: Array) -> float:
    """How far the tip is from RUN_STOP, sideways, in metres."""
    return float(np.linalg.norm((tip - BASE_FROM_PANEL.apply(BUTTON))[:2]))


@pytest.mark.parametrize("kind", [Bench, RidingBench])
@pytest.mark.parametrize("gesture", ["press", "long", "double"])
def test_a_lit_control_that_hides_the_tip_is_touched_by_a_look_from_beside_it(kind: type[Bench], gesture: str) -> None:
    bench = dazzling_bench(kind, 0.015)
    bench.on_phase[GoalPhase.LIFT] = acts
    result = bench.do(f"{gesture}:RUN_STOP")
    assert result.outcome is Outcome.REACHED, result
    assert result.touch is Felt.PRESSED, "its own lamp replaces the contact that cannot be measured"
    contact = min(bench.lowest, key=lambda p: p[2])
    assert contact[2] == pytest.approx(BASE_FROM_PANEL.apply(BUTTON)[2] + 0.002 - bench.stroke_m, abs=2e-5)
    # The change by the machine's scale and skew within 20 mm, up to 0.14 mm, is added.
    assert away(bench, contact) < 0.0004
    details = dict(result.details)
    assert (
        result.reason == "the cameras measured the tip off the target, because they could not see it above the target"
    )
    assert details["measured_by"] == "cameras off it" and int(details["corrections"]) >= 1
    assert result.error_m == pytest.approx(float(details["hover_error_m"]), abs=1e-6) and result.error_m < 0.00025
    beside = [p for p in bench.lowest if away(bench, p) > 0.015]
    hover = bench.paths[0][-1][2]
    assert min(p[2] for p in beside) == pytest.approx(-hover, abs=1e-9), "beside it the stylus stays as high as above"


def acts(bench: Bench) -> None:
    """RUN_STOP has acted."""
    bench.lamp = "red"


def test_a_touch_that_is_neither_seen_nor_has_an_effect_is_not_reached() -> None:
    result = dazzling_bench(Bench, 0.015).do("press:RUN_STOP")
    assert result.outcome is Outcome.ABORTED and result.touch is Felt.UNKNOWN
    assert result.code == "contact_unknown" and "the cameras did not measure the ball in contact" in result.reason


def test_the_tip_that_is_seen_in_contact_counts_although_it_was_hidden_before() -> None:
    bench = dazzling_bench(Bench, 0.015)

    def out(running: Bench) -> None:
        running.lamp = "off"

    bench.on_phase[GoalPhase.CONTACT] = out
    result = bench.do("press:RUN_STOP")
    assert result.outcome is Outcome.REACHED
    assert dict(result.details)["measured_by"] == "cameras" and result.reason == ""
    contact = min(bench.lowest, key=lambda p: p[2])
    assert abs(result.error_m - away(bench, contact)) < 0.0001


@pytest.mark.parametrize(
    "within_m, changes, looks",
    [
        (0.05, {}, 3),  # it shines that far: nothing is seen from the side either
        (0.015, {"beside_m": 0.0}, 1),
    ],
)
def test_a_tip_that_is_seen_from_nowhere_touches_nothing(
    within_m: float, changes: dict[str, object], looks: int
) -> None:
    bench = dazzling_bench(Bench, within_m, **changes)
    hover = BASE_FROM_PANEL.apply(BUTTON)[2] + 0.009
    result = bench.do("press:RUN_STOP")
    assert result.outcome is Outcome.ABORTED
    assert "the cameras saw the tip 0 times (at least 4 times" in result.reason and "the stylus is up" in result.reason
    assert min(p[2] for p in bench.lowest) > hover and bench.readings[2] == 0.0
    assert sum(state == "looking" for state in bench.states) == looks


def test_an_arc_is_not_followed_from_a_place_that_was_not_seen() -> None:
    bench = dazzling_bench(Bench, 0.06)  # as far as CH1_SCALE
    result = bench.do("turn:CH1_SCALE:20")
    assert result.outcome is Outcome.ABORTED and "the cameras saw the tip 0 times" in result.reason
    assert sum(state == "looking" for state in bench.states) == 1


def test_it_is_looked_from_beside_where_nothing_stands_in_the_way() -> None:
    bench = dazzling_bench(Bench, 0.015)
    knob = PanelControl(
        name="TALL", kind="knob", centre=np.array([0.188, 0.127]), size=np.full(2, 0.012), height=0.02, round=True
    )
    bench.tell(msg.PanelControls(panel=dataclasses.replace(PANEL, controls=(*PANEL.controls, knob))))
    bench.on_phase[GoalPhase.LIFT] = acts
    assert bench.do("press:RUN_STOP").outcome is Outcome.REACHED
    top = BASE_FROM_PANEL.apply([*knob.centre, knob.height])
    near = [p[2] for p in bench.lowest if np.linalg.norm((p - top)[:2]) < 0.006 + 0.0025]
    assert min(near, default=0.0) > top[2] + 0.002 + 0.003 - 1e-6, "the ball's bottom passes 3 mm above"


def test_every_correction_arrives_from_the_same_side() -> None:
    bench = sloppy_bench(5).start()
    assert bench.do("press:RUN_STOP").outcome is Outcome.REACHED
    for path in bench.paths:
        for before, after in itertools.pairwise(path):
            if np.abs(after[:2] - before[:2]).max() > 1e-9:
                assert (after[:2] > before[:2]).all()
    bends = [p for p in bench.paths if len(p) == 2 and p[0][2] == p[1][2]]
    assert bends, "no correction was made"
    for path in bends:
        np.testing.assert_allclose(path[1] - path[0], [0.001, 0.001, 0.0], atol=1e-12)
        assert path[0][2] == bench.paths[0][-1][2], "corrections stay at the hover height"


class DazzledBench(Bench):
    """Its cameras take a light that stays where it is for the ball, from the first look on."""

    light: Array | None = None

    def tip_seen_in_base(self) -> Array:
        return self.tip_in_base() if self.light is None else self.light


def test_corrections_that_change_nothing_do_not_lead_the_stylus_into_a_neighbour() -> None:
    bench = DazzledBench().start()
    assert isinstance(bench, DazzledBench)

    def dazzle(running: Bench) -> None:
        assert isinstance(running, DazzledBench)
        running.light = running.tip_in_base() - (0.0, 0.0045, 0.0)

    bench.on_phase[GoalPhase.LOOK] = dazzle
    bench.lowest.clear()
    result = bench.do("press:CH1")
    assert result.outcome is Outcome.ABORTED
    # Range for which the hover height was found; beyond it the knob above CH1 is 4 mm higher than the ball's lower end.
    above = BASE_FROM_PANEL.apply([0.211, 0.071, 0.003])
    low = np.array([p for p in bench.lowest if p[2] < above[2] + 0.015])
    assert len(low) and np.linalg.norm(low[:, :2] - above[:2], axis=1).max() < 0.0065
    assert result.reason == (
        "the seen errors add up to a correction by 9.00 mm (limit 5 mm): calibrate again; the stylus is up"
    )


def test_cameras_on_the_carriage_notice_a_panel_that_moves() -> None:
    bench = RidingBench(seed=3).start()
    assert isinstance(bench, RidingBench)

    def push(running: Bench) -> None:
        assert isinstance(running, RidingBench)
        running.base_from_panel = Transform(BASE_FROM_PANEL.rotation, BASE_FROM_PANEL.translation + (0.004, 0.0, 0.0))

    bench.on_phase[GoalPhase.LOOK] = push
    result = bench.do("press:RUN_STOP")
    assert result.outcome is Outcome.ABORTED
    assert "the panel has moved by 4.0 mm" in result.reason


def test_cameras_on_the_carriage_wait_for_a_panel_seen_from_where_they_are() -> None:
    bench = RidingBench(seed=3).start()
    assert bench.go(0.1, 0.1).outcome is Outcome.REACHED
    bench.talking.discard("panel")
    assert bench.go(0.2, 0.1).outcome is Outcome.REACHED
    moved = len(bench.paths)
    given_up = bench.do("press:RUN_STOP")
    assert given_up.outcome is Outcome.ABORTED and len(bench.paths) == moved
    assert "the cameras have not seen the panel from their new position (limit 3 s)" in given_up.reason
    bench.talking.add("panel")
    bench.run(0.5)
    assert bench.do("press:RUN_STOP").outcome is Outcome.REACHED
