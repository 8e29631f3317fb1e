"""Checks and report of the acceptance test, for a machine that passes and for machines that do not."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from gantry_driver.acceptance.axes_fit import fit_axes
from gantry_driver.acceptance.checks import all_checks
from gantry_driver.acceptance.coverage import PanelCoverage
from gantry_driver.acceptance.limits import AcceptanceLimits, limits_of
from gantry_driver.acceptance.measured import Beyond, CameraSnapshot, Measured, MeasuredTouch, Visit
from gantry_driver.acceptance.plots import axes_plot, marked_image, touch_plot
from gantry_driver.acceptance.report import as_html, as_json, line, passed
from gantry_driver.acceptance.stops import beyond, plan_stops
from gantry_driver.cli.gantry_accept import parse
from icu_common.core.configuration.config import ConfigError

LOW, HIGH = np.array([0.0, 0.0]), np.array([0.359, 0.219])
OUTLINE = np.array([(0, 0), (0.32, 0), (0.32, 0.15), (0, 0.15)])
ABOUT = {"machine": "bench <1>"}


def good_machine(axes: np.ndarray | None = None) -> Measured:
    axes = np.eye(3)[:, :2] if axes is None else axes
    measured = Measured(low=LOW, high=HIGH, outline=OUTLINE, wanted_touches=2)
    for stop in plan_stops(LOW, HIGH):
        measured.visits.append(Visit(stop=stop, reading=stop.reading, tip=axes @ stop.reading))
    tips = np.array([visit.tip for visit in measured.visits])
    measured.fit = fit_axes([v.stop for v in measured.visits], np.array([v.reading for v in measured.visits]), tips)
    for reading in beyond(LOW, HIGH):
        measured.beyond.append(Beyond(reading=reading, rejected=True, reason="rejected: outside", moved_m=0.0))
    outline_px = np.array([(20.0, 20.0), (180.0, 20.0), (180.0, 100.0), (20.0, 100.0)])
    for name in ("left", "right"):
        image = np.full((120, 200, 3), 128, np.uint8)
        view = PanelCoverage(outline_px=outline_px, share=1.0, margin_px=19.0)
        touch_px = np.array([(50.0, 50.0), (math.nan, math.nan)])
        measured.cameras.append(CameraSnapshot(name=name, image=image, view=view, blur_px=0.7, touch_px=touch_px))
    for x in (0.1, 0.2):
        measured.touches.append(MeasuredTouch(point=np.array([x, 0.05]), touched=True, error_m=0.0001, duration_s=3.0))
    return measured


def failed_names(measured: Measured, *limits: str) -> list[str]:
    return [f"{check.group}: {check.name}" for check in all_checks(measured, limits_of(limits)) if not check.passed]


def test_a_good_machine_passes_all_checks() -> None:
    checks = all_checks(good_machine(), AcceptanceLimits())
    assert passed(checks) and len(checks) == 21
    assert not passed([])
    assert line(checks[0]) == "ok   limits: corners of the travel reached: 4 (at least 4)"


def test_each_fault_fails_its_own_check() -> None:
    machine = good_machine()
    machine.visits[1].problem = "0.0, 0.0 mm: aborted: hard limit"
    assert failed_names(machine) == ["limits: corners of the travel reached"]
    machine = good_machine()
    machine.visits[2].reading = machine.visits[2].reading + (0.0, 0.001)
    assert failed_names(machine) == ["limits: distance from the ordered position"]
    machine = good_machine()
    machine.beyond[3] = Beyond(reading=HIGH, rejected=False, reason="reached", moved_m=0.005)
    assert failed_names(machine) == ["limits: goals outside the limits rejected", "limits: motion by rejected goals"]
    assert failed_names(good_machine(np.array([(1.02, 0.0), (0.0, 1.0), (0.0, 0.0)]))) == ["scale: x axis"]
    skewed = np.array([(1.0, 0.02), (0.0, 1.0), (0.0, 0.0)])
    assert failed_names(good_machine(skewed)) == ["squareness: angle between the axes less 90 deg"]
    machine = good_machine()
    machine.cameras[1].blur_px = 2.5
    assert failed_names(machine) == ["camera: right: blur of edges"]
    assert failed_names(machine, "blur_px=3") == []
    machine = good_machine()
    machine.touches[0] = MeasuredTouch(point=OUTLINE[0], touched=False, error_m=math.nan, reason="aborted: no contact")
    assert failed_names(machine) == ["touch: points touched"]
    assert "no contact" in line(all_checks(machine, AcceptanceLimits())[-3])


def test_what_was_not_measured_fails() -> None:
    machine = good_machine()
    machine.fit, machine.fit_problem, machine.touches = None, "the tip was seen at 2 stops", []
    names = failed_names(machine)
    assert len([name for name in names if name.startswith(("direction", "scale", "squareness", "backlash"))]) == 9
    assert [name for name in names if name.startswith("touch")] == [
        "touch: points touched", "touch: mean error", "touch: largest error",
    ]  # fmt: skip
    texts = [line(check) for check in all_checks(machine, AcceptanceLimits())]
    assert "FAIL scale: x axis: not measured % (limit 1 %) - the tip was seen at 2 stops" in texts


def test_json_has_every_value_and_no_nan() -> None:
    machine = good_machine()
    machine.touches[0].error_m = math.nan
    checks = all_checks(machine, AcceptanceLimits())
    document = json.loads(as_json(machine, checks, AcceptanceLimits(), ABOUT), parse_constant=pytest.fail)
    assert document["passed"] is False and document["about"] == ABOUT
    assert len(document["checks"]) == len(checks) and document["checks"][0]["value"] == 4
    assert document["touches"][0]["error_m"] is None and document["touches"][1]["error_m"] == 0.0001
    assert len(document["stops"]) == 13 and document["stops"][1]["ordered_m"] == [0.0, 0.0]
    assert np.allclose(document["axes"]["panel_from_reading"], np.eye(3)[:, :2])
    assert document["limits"]["blur_px"] == 1.6


def test_html_needs_no_other_file_and_escapes_names() -> None:
    machine = good_machine()
    checks = all_checks(machine, AcceptanceLimits())
    page = as_html(machine, checks, AcceptanceLimits(), ABOUT, [("left camera", b"picture")])
    assert "accepted</span>" in page and "bench &lt;1&gt;" in page and "bench <1>" not in page
    assert page.count("data:image/jpeg;base64,cGljdHVyZQ==") == 1 and 'src="http' not in page
    assert page.count("<svg") == 2 and page.count(">passed<") == len(checks)
    failing = all_checks(machine, limits_of(["touch_error_m=0.00005"]))
    assert "not accepted: 2 of 21 checks failed" in as_html(machine, failing, AcceptanceLimits(), ABOUT, [])


def test_plots_are_valid_and_have_a_mark_for_each_value() -> None:
    machine = good_machine()
    machine.touches[1] = MeasuredTouch(point=OUTLINE[2], touched=False, error_m=math.nan, reason="no <contact>")
    axes, touches = (ET.fromstring(text) for text in (axes_plot(machine), touch_plot(machine, 0.0005)))
    assert len(axes.findall(".//{*}circle")) == 13
    circles = touches.findall(".//{*}circle")
    assert len(circles) == 2 and circles[0].get("fill") != circles[1].get("fill")
    assert circles[1].findtext("{*}title") == "no <contact>"


def test_marks_are_drawn_on_a_copy_of_the_image() -> None:
    camera = good_machine().cameras[0]
    marked = marked_image(camera, good_machine().touches)
    changed = np.argwhere((marked != camera.image).any(axis=2))
    assert (camera.image == 128).all() and len(changed) > 200
    assert (marked[50, 57] != 128).any(), "the circle around the first touch"


def test_limits_are_checked_by_name_and_value() -> None:
    assert limits_of(["squareness_deg=0.3", "blur_px=2"]) == AcceptanceLimits(squareness_deg=0.3, blur_px=2.0)
    with pytest.raises(ConfigError, match="limit 'speed' is none of position_error_m, direction_deg"):
        limits_of(["speed=3"])
    with pytest.raises(ConfigError, match="limit blur_px: expected a number, got 'small'"):
        limits_of(["blur_px=small"])


def test_arguments_give_folder_touches_and_limits(capsys: pytest.CaptureFixture[str]) -> None:
    order = parse(["-o", "report", "--touches", "3", "--limit", "blur_px=2", "--machine", "stage 1"])
    assert (str(order.out), order.touches, order.limits.blur_px, order.machine) == ("report", 3, 2.0, "stage 1")
    assert (str(parse([]).out), parse([]).touches) == ("acceptance", 20)
    for wrong, text in ((["--touches", "-1"], "--touches -1: 0 to 200"), (["--limit", "x=1"], "limit 'x' is none of")):
        with pytest.raises(SystemExit) as ended:
            parse(wrong)
        assert ended.value.code == 2 and text in capsys.readouterr().err
