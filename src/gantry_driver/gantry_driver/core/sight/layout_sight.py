"""Positions of controls, from their layout and their seen deviations from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gantry_driver.core.motion.scene import PanelMap
from icu_common.core.alignment.findings import Finding, FindingCode
from icu_common.core.alignment.layout import ControlDeviation, DeviationCode


def seen_panel(panel: PanelMap, deviations: Mapping[str, ControlDeviation]) -> PanelMap:
    """Return the panel with all controls at their most likely positions; a refused one keeps that of its layout."""
    controls = []
    for control in panel.controls:
        deviation = deviations.get(control.name)
        if deviation is not None and deviation.code is not DeviationCode.REFUSED:
            control = replace(control, centre=control.centre + 1e-3 * np.array(deviation.offset_mm))
        controls.append(control)
    return replace(panel, controls=tuple(controls))


def layout_finding(name: str, deviations: Mapping[str, ControlDeviation]) -> Finding | None:
    """Return the finding for which a control must not be touched, None if its layout does not forbid a touch."""
    deviation = deviations.get(name)
    if deviation is None or deviation.code is not DeviationCode.REFUSED:
        return None
    x, y = deviation.offset_mm
    values = (("control", name), ("x_mm", f"{x:+.2f}"), ("y_mm", f"{y:+.2f}"), ("limit_mm", f"{deviation.limit_mm:g}"))
    return Finding(code=FindingCode.LAYOUT_DEVIATES, values=values)
