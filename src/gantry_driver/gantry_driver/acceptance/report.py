"""The report of the acceptance test: one HTML file that needs no other, and the same values as JSON."""

from __future__ import annotations

import base64
import html
import json
import math
from collections.abc import Sequence
from typing import Any

from gantry_driver.acceptance.checks import AcceptanceCheck
from gantry_driver.acceptance.limits import AcceptanceLimits
from gantry_driver.acceptance.measured import Measured
from gantry_driver.acceptance.plots import axes_plot, touch_plot

BY_HAND = (
    "Press the emergency stop while the stage moves: the motors lose their supply and the board needs homing.",
    "Push each limit switch by hand while the board is connected: the state becomes alarm.",
    "Unplug the board's USB cable while the stage moves: the stage stops, and the state is disconnected.",
    "Close the operator page while the stage moves: the stage stops within the heartbeat's limit.",
)
"""Checks that no program can make."""
_STYLE = """body{font:15px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#1f2328}
table{border-collapse:collapse;width:100%}th,td{border:1px solid #d0d7de;padding:.3rem .6rem;text-align:left}
td.n{text-align:right;font-variant-numeric:tabular-nums}.ok{color:#1a7f37}.bad{color:#b3261e}
img,svg{max-width:100%;height:auto;border:1px solid #d0d7de}h1 span{font-size:1rem}"""


def passed(checks: Sequence[AcceptanceCheck]) -> bool:
    """Return whether a machine with these checks is accepted."""
    return bool(checks) and all(check.passed for check in checks)


def shown(value: float) -> str:
    """Return a value with four significant digits; a count as integer."""
    if math.isnan(value):
        return "not measured"
    return f"{value:.0f}" if float(value).is_integer() else f"{value:.4g}"


def line(check: AcceptanceCheck) -> str:
    """Return a check as one line of text."""
    limit = f"{'at least' if check.at_least else 'limit'} {shown(check.limit)}"
    verdict = "ok  " if check.passed else "FAIL"
    note = f" - {check.note}" if check.note else ""
    unit = f" {check.unit}" if check.unit else ""
    return f"{verdict} {check.group}: {check.name}: {shown(check.value)}{unit} ({limit}{unit}){note}"


def as_json(
    measured: Measured, checks: Sequence[AcceptanceCheck], limits: AcceptanceLimits, about: dict[str, str]
) -> str:
    """Return the report as JSON; NaN becomes null."""
    fit = measured.fit
    document: dict[str, Any] = {
        "about": about,
        "passed": passed(checks),
        "limits": {name: getattr(limits, name) for name in AcceptanceLimits.__dataclass_fields__},
        "checks": [
            {
                "group": check.group,
                "name": check.name,
                "value": check.value,
                "limit": check.limit,
                "at_least": check.at_least,
                "unit": check.unit,
                "passed": check.passed,
                "note": check.note,
            }
            for check in checks
        ],
        "stops": [
            {
                "ordered_m": visit.stop.reading.tolist(),
                "reading_m": visit.reading.tolist(),
                "tip_panel_m": None if visit.tip is None else visit.tip.tolist(),
                "problem": visit.problem,
            }
            for visit in measured.visits
        ],
        "beyond": [
            {"reading_m": goal.reading.tolist(), "rejected": goal.rejected, "reason": goal.reason}
            for goal in measured.beyond
        ],
        "axes": None
        if fit is None
        else {
            "panel_from_reading": fit.axes.tolist(),
            "scale_sigma": fit.axis_sigma.tolist(),
            "backlash_m": fit.backlash_m.tolist(),
            "backlash_sigma_m": fit.lag_sigma_m.tolist(),
            "tip_sigma_m": fit.sigma_m,
        },
        "touches": [
            {
                "panel_m": touch.point.tolist(),
                "touched": touch.touched,
                "error_m": touch.error_m,
                "duration_s": touch.duration_s,
                "reason": touch.reason,
            }
            for touch in measured.touches
        ],
    }
    return json.dumps(_plain(document), indent=1, allow_nan=False) + "\n"


def _plain(value: Any) -> Any:
    """Return a document without NaN, which JSON does not have."""
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_plain(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def as_html(
    measured: Measured,
    checks: Sequence[AcceptanceCheck],
    limits: AcceptanceLimits,
    about: dict[str, str],
    pictures: Sequence[tuple[str, bytes]],
) -> str:
    """Return the report as one HTML document; ``pictures`` are JPEG files with their titles."""
    good = passed(checks)
    failed = sum(not check.passed for check in checks)
    verdict = "accepted" if good else f"not accepted: {failed} of {len(checks)} checks failed"
    rows = "".join(_row(check) for check in checks)
    facts = "".join(f"<tr><th>{html.escape(k)}</th><td>{html.escape(v)}</td></tr>" for k, v in about.items())
    images = "".join(
        f'<h3>{html.escape(title)}</h3><img alt="{html.escape(title)}" '
        f'src="data:image/jpeg;base64,{base64.b64encode(data).decode()}">'
        for title, data in pictures
    )
    hand = "".join(f"<li>☐ {html.escape(text)}</li>" for text in BY_HAND)
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Acceptance test</title>'
        f"<style>{_STYLE}</style></head><body><h1>Acceptance test "
        f'<span class="{"ok" if good else "bad"}">{verdict}</span></h1><table>{facts}</table>'
        "<h2>Checks</h2><table><tr><th>check</th><th>value</th><th>limit</th><th>result</th></tr>"
        f"{rows}</table><h2>Axes</h2>{axes_plot(measured)}"
        f"<h2>Touches</h2>{touch_plot(measured, limits.touch_error_m)}<h2>Images</h2>{images}"
        f"<h2>Checks by hand</h2><ul>{hand}</ul></body></html>\n"
    )


def _row(check: AcceptanceCheck) -> str:
    sign = "≥" if check.at_least else "≤"
    result = '<td class="ok">passed</td>' if check.passed else f'<td class="bad">failed: {html.escape(check.note)}</td>'
    value, limit = f"{shown(check.value)} {check.unit}", f"{sign} {shown(check.limit)} {check.unit}"
    return (
        f"<tr><td>{html.escape(check.group)}: {html.escape(check.name)}</td>"
        f'<td class="n">{value}</td><td class="n">{limit}</td>{result}</tr>'
    )
