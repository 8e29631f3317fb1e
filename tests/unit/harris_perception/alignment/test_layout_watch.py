"""Positions of controls from measured outlines: print out of register, controls out of place, and both."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from support.parameter_files import CONFIG
from unit.harris_perception.rendered_stylus import stereo_model

from harris_perception.core.alignment.control_outlines import TopShift
from harris_perception.core.alignment.layout_config import LayoutConfig
from harris_perception.core.alignment.layout_watch import LayoutWatch
from icu_common.core.alignment.layout import DeviationCode
from icu_common.core.geometry.geometry import Array
from icu_common.core.panel.panel_layout import load_layout

LAYOUT = load_layout(CONFIG / "scopes" / "dso_bench_4.yaml")
PROUD = [c.name for c in LAYOUT.controls if c.height_mm > 0]
LEAN = np.array([0.0, 0.5])


def watch(offsets_mm: dict[str, Array], noise_mm: float = 0.05, seed: int = 3) -> LayoutWatch:
    """Return a watch that has measured some controls at offsets from their layout, each with an error of its own."""
    print(f"seed {seed}")
    rng = np.random.default_rng(seed)
    made = LayoutWatch(LayoutConfig(), LAYOUT, stereo_model())
    for name, offset in offsets_mm.items():
        shift = TopShift(shift_mm=offset + noise_mm * rng.standard_normal(2), lean=LEAN, sigma_mm=np.zeros(2))
        made._seen[name].extend([(shift, dataclasses.replace(shift, lean=-LEAN))] * 3)
    return made


def own(spread_mm: float) -> dict[str, Array]:
    rng = np.random.default_rng(8)
    return {name: rng.uniform(-spread_mm, spread_mm, 2) for name in PROUD}


def test_a_print_out_of_register_shifts_controls_that_are_not_measured_too() -> None:
    """Before, these were touched at their layout positions, 0.4 mm from their centres."""
    register = np.array([0.25, -0.3])
    truth = {name: register + offset for name, offset in own(0.2).items()}
    unmeasured = "RUN_STOP", "CURSORS"
    deviations = watch({n: t for n, t in truth.items() if n not in unmeasured}).deviations()
    for name in unmeasured:
        assert deviations[name].code is DeviationCode.UNMEASURED
        assert deviations[name].offset_mm == pytest.approx(register, abs=0.1)
        assert min(deviations[name].sigma_mm) > LAYOUT.tolerance_mm / np.sqrt(3)
    off = [np.subtract(deviations[n].offset_mm, t) for n, t in truth.items() if n not in unmeasured]
    # Deviations below significance count as well: before, 0.2 mm rms.
    assert np.sqrt(np.mean(np.square(off))) < 0.08
    flat = next(d for n, d in deviations.items() if n not in PROUD)
    assert flat.offset_mm == (0.0, 0.0)


def test_noise_does_not_shift_the_controls_of_a_correct_panel() -> None:
    deviations = watch(own(0.0)).deviations()
    assert max(np.abs(d.offset_mm).max() for d in deviations.values()) < 0.06


def test_a_single_control_out_of_place_is_used_where_it_was_measured() -> None:
    truth = own(0.0) | {"MATH": np.array([0.5, 0.6]), "SAVE": np.array([1.2, 0.0])}
    deviations = watch(truth).deviations()
    assert deviations["MATH"].code is DeviationCode.CORRECTED
    assert deviations["MATH"].offset_mm == pytest.approx(truth["MATH"], abs=0.15)
    assert deviations["SAVE"].code is DeviationCode.REFUSED
    assert max(np.abs(d.offset_mm).max() for n, d in deviations.items() if n not in ("MATH", "SAVE")) < 0.06


def test_few_measured_controls_say_nothing_about_the_others() -> None:
    truth = {name: np.array([0.5, 0.0]) for name in PROUD[:3]}
    deviations = watch(truth).deviations()
    assert deviations[PROUD[0]].offset_mm == pytest.approx((0.5, 0.0), abs=0.15)
    assert deviations[PROUD[5]].offset_mm == (0.0, 0.0)
