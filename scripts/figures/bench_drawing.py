"""Draw the bench to scale, from the front and from the side, from the configuration: docs/how-to/bench.svg.

Run it by ``make figures``. One unit of the drawing is one millimetre of the bench.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from icu_common.core.panel.panel_layout import PanelLayout, load_layout

ROOT = Path(__file__).resolve().parents[2]
OVERHANG_MM = 60.0
"""Length of rails, carriage and motors beyond the travel, on each side: the design of a belt stage."""
CAMERA_MM = (36.0, 30.0, 40.0)
"""Width, height and length of a USB camera with its lens."""
INK, SOFT, LINE, MOVING, SIGHT = "#1f2328", "#57606a", "#8c959f", "#0969da", "#bc4c00"


def parameters(name: str) -> dict[str, Any]:
    """Return the parameters of a file below config/params that has one entry."""
    document = yaml.safe_load((ROOT / "config" / "params" / name).read_text(encoding="utf-8"))
    return dict(document["/**"]["ros__parameters"])


class Drawing:
    """Collects SVG elements of one view; ``at`` maps the view's millimetres (right, up) to the drawing."""

    def __init__(self, right: float, down: float) -> None:
        self._right, self._down = right, down
        self.parts: list[str] = []

    def at(self, x: float, y: float) -> tuple[float, float]:
        return self._right + x, self._down - y

    def box(self, x: float, y: float, width: float, height: float, **style: str) -> None:
        left, top = self.at(x, y + height)
        self.parts.append(
            f'<rect x="{left:.1f}" y="{top:.1f}" width="{width:.1f}" height="{height:.1f}" {_css(style)}/>'
        )

    def circle(self, x: float, y: float, radius: float, **style: str) -> None:
        left, top = self.at(x, y)
        self.parts.append(f'<circle cx="{left:.1f}" cy="{top:.1f}" r="{radius:.1f}" {_css(style)}/>')

    def line(self, x0: float, y0: float, x1: float, y1: float, **style: str) -> None:
        (a, b), (c, d) = self.at(x0, y0), self.at(x1, y1)
        self.parts.append(f'<line x1="{a:.1f}" y1="{b:.1f}" x2="{c:.1f}" y2="{d:.1f}" {_css(style)}/>')

    def turned_box(self, x: float, y: float, length: float, width: float, degrees: float, **style: str) -> None:
        """Draw a box whose front middle is at a point; its length runs away from there in a direction."""
        left, top = self.at(x, y)
        self.parts.append(
            f'<rect x="0" y="{-width / 2:.1f}" width="{length:.1f}" height="{width:.1f}" {_css(style)} '
            f'transform="translate({left:.1f} {top:.1f}) rotate({-degrees:.1f})"/>'
        )

    def text(self, x: float, y: float, words: str, anchor: str = "start", size: float = 12, fill: str = INK) -> None:
        left, top = self.at(x, y)
        self.parts.append(
            f'<text x="{left:.1f}" y="{top:.1f}" font-size="{size:g}" text-anchor="{anchor}" fill="{fill}">'
            f"{words}</text>"
        )

    def across(self, x0: float, x1: float, y: float, words: str) -> None:
        """Draw a horizontal dimension."""
        self.line(x0, y, x1, y, stroke=SOFT, marker_start="url(#end)", marker_end="url(#end)")
        self.text((x0 + x1) / 2, y + 4, words, "middle", fill=SOFT)

    def up(self, x: float, y0: float, y1: float, words: str) -> None:
        """Draw a vertical dimension."""
        self.line(x, y0, x, y1, stroke=SOFT, marker_start="url(#end)", marker_end="url(#end)")
        self.text(x - 5, (y0 + y1) / 2 - 4, words, "end", fill=SOFT)


def _css(style: dict[str, str]) -> str:
    given = {"fill": "none", "stroke": INK, "stroke_width": "1.2"} | style
    return " ".join(f'{name.replace("_", "-")}="{value}"' for name, value in given.items())


def front(view: Drawing, bench: dict[str, Any], travel: Sequence[float], layout: PanelLayout) -> None:
    """Draw the view from the operator's side: rails, travel, panel, cameras."""
    width, height = travel[:2]
    x0, y0 = (1e3 * v for v in bench["panel"]["position_m"][:2])
    outer = (width + 2 * OVERHANG_MM, height + 2 * OVERHANG_MM)
    for y in (-OVERHANG_MM + 15, height + OVERHANG_MM - 15):
        view.box(-OVERHANG_MM, y - 8, outer[0], 16, fill="#d0d7de", stroke=LINE)
    view.box(x0, y0, *layout.size_mm, fill="#f6f8fa", stroke=INK, stroke_width="2")
    for control in layout.controls:
        x, y = x0 + control.position_mm[0], y0 + control.position_mm[1]
        if control.shape == "circle":
            view.circle(x, y, control.size_mm[0] / 2, stroke=LINE, fill="#eaeef2")
        else:
            w, h = control.size_mm
            view.box(x - w / 2, y - h / 2, w, h, stroke=LINE, fill="#eaeef2")
    view.box(0, 0, width, height, stroke=MOVING, stroke_dasharray="6 4")
    view.box(-10, -OVERHANG_MM, 20, outer[1], fill="#ddf4ff", stroke=MOVING, fill_opacity="0.6")
    view.box(-16, -16, 32, 32, fill="#ddf4ff", stroke=MOVING)
    view.circle(0, 0, 2, fill=MOVING, stroke=MOVING)
    view.text(14, -30, "stylus at home: origin of base_link", fill=MOVING)
    view.text(width - 4, height + 6, "travel of the stylus", "end", fill=MOVING)
    view.text(x0 + 4, y0 - 12, f"panel {layout.size_mm[0]:g} x {layout.size_mm[1]:g} mm")
    view.across(-OVERHANG_MM, width + OVERHANG_MM, height + OVERHANG_MM + 14, f"{outer[0]:g} mm, rails and motors")
    view.across(0, width, height + 22, f"{width:g} mm, $130")
    view.up(-OVERHANG_MM - 12, 0, height, f"{height:g} mm, $131")
    camera = bench["camera"]
    aim, down, _ = camera_place(camera)
    half = 500 * camera["baseline_m"]
    view.box(aim[0] - half - 30, down - 8, 2 * half + 60, 16, fill="#d0d7de", stroke=LINE)
    for x in (aim[0] - half, aim[0] + half):
        view.box(
            x - CAMERA_MM[0] / 2, down - CAMERA_MM[1] / 2, CAMERA_MM[0], CAMERA_MM[1], fill="#fff1e5", stroke=SIGHT
        )
        view.circle(x, down, 9, stroke=SIGHT, fill="#fff")
    view.across(aim[0] - half, aim[0] + half, down - 40, f"{2 * half:g} mm baseline")
    view.text(aim[0] + half + 36, down - 4, "two USB cameras on a rigid bar", fill=SIGHT)
    view.text(-OVERHANG_MM, height + OVERHANG_MM + 48, "Front", size=18)


def camera_place(camera: dict[str, Any]) -> tuple[list[float], float, float]:
    """Return the aim in mm, and the cameras' height and distance from the travel plane in mm."""
    aim = [1e3 * v for v in camera["aim_m"]]
    angle, distance = math.radians(camera["elevation_deg"]), 1e3 * camera["distance_m"]
    return aim, aim[1] - distance * math.sin(angle), aim[2] + distance * math.cos(angle)


def side(view: Drawing, bench: dict[str, Any], travel: Sequence[float], layout: PanelLayout) -> None:
    """Draw the view along the x rails: panel, stylus, cameras with their line of sight."""
    height, face = travel[1], 1e3 * bench["panel"]["position_m"][2]
    low = 1e3 * bench["panel"]["position_m"][1]
    view.box(face - 90, low - 4, 90, layout.size_mm[1] + 8, fill="#f6f8fa", stroke=INK, stroke_width="2")
    view.text(face - 86, low + layout.size_mm[1] / 2, "instrument")
    stylus = bench["stylus"]
    for y in (-OVERHANG_MM + 15, height + OVERHANG_MM - 15):
        view.box(112, y - 8, 22, 16, fill="#d0d7de", stroke=LINE)
    view.box(106, -OVERHANG_MM, 6, height + 2 * OVERHANG_MM, fill="#ddf4ff", stroke=MOVING)
    y = low + layout.size_mm[1] * 0.75
    shaft, stem = stylus["shaft_mm"], stylus["stem_mm"]
    view.box(
        stem, y - stylus["shaft_diameter_mm"] / 2, shaft, stylus["shaft_diameter_mm"], fill="#ddf4ff", stroke=MOVING
    )
    view.line(0, y, stem, y, stroke=MOVING, stroke_width="1.5")
    view.circle(0, y, stylus["ball_diameter_mm"] / 2, fill="#d63384", stroke="#d63384")
    view.box(96, y - 22, 44, 44, fill="#ddf4ff", stroke=MOVING)
    view.text(146, y + 10, "Z drive with spring", fill=MOVING)
    view.text(146, y - 6, f"stylus, ball of {stylus['ball_diameter_mm']:g} mm", fill=MOVING)
    view.line(0, -OVERHANG_MM, 0, height + OVERHANG_MM, stroke=MOVING, stroke_dasharray="6 4")
    view.across(face, 0, height + OVERHANG_MM + 12, "")
    view.text(6, height + OVERHANG_MM + 8, f"{-face:g} mm from the panel to the retracted ball", fill=SOFT)
    camera = bench["camera"]
    aim, down, out = camera_place(camera)
    elevation = camera["elevation_deg"]
    for edge in (low, low + layout.size_mm[1]):
        view.line(out, down, face, edge, stroke=SIGHT, stroke_dasharray="3 4")
    view.line(out, down, aim[2], aim[1], stroke=SIGHT)
    view.turned_box(out, down, CAMERA_MM[2], CAMERA_MM[1], -elevation, fill="#fff1e5", stroke=SIGHT)
    middle = ((out + aim[2]) / 2, (down + aim[1]) / 2)
    words = f"{1e3 * camera['distance_m']:g} mm, {elevation:g} deg from below"
    view.text(middle[0] - 10, middle[1] + 75, words, fill=SIGHT)
    view.across(0, out, down - 46, f"{out:.0f} mm")
    view.up(out + 70, down, 0, f"{-down:.0f} mm")
    view.text(out + 66, 6, "height of the home position", "end", fill=SOFT)
    view.text(face - 90, height + OVERHANG_MM + 48, "Side", size=18)


def drawing() -> str:
    """Return the SVG document."""
    bench = parameters("bench.yaml")
    travel = parameters("serial_driver.yaml")["machine"]["travel_mm"]
    layout = load_layout(ROOT / "config" / "scopes" / "dso_bench_4.yaml")
    views = Drawing(185, 360), Drawing(790, 360)
    front(views[0], bench, travel, layout)
    side(views[1], bench, travel, layout)
    foot = Drawing(125, 640)
    foot.line(0, 0, 100, 0, stroke_width="3")
    foot.text(106, -4, "100 mm. Distances are those of config/params/bench.yaml and serial_driver.yaml.", fill=SOFT)
    parts = "\n".join(part for view in (*views, foot) for part in view.parts)
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 1480 660" width="1480" height="660" '
        'font-family="system-ui, sans-serif">\n<title>The bench to scale, from the front and from the side</title>\n'
        '<defs><marker id="end" viewBox="0 0 2 10" refX="1" refY="5" markerWidth="2" markerHeight="10">'
        f'<path d="M1 0V10" stroke="{SOFT}" stroke-width="1.5"/></marker></defs>\n'
        f'<rect width="1480" height="660" fill="#fff"/>\n{parts}\n</svg>\n'
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "docs" / "how-to" / "bench.svg")
    parser.parse_args().out.write_text(drawing(), encoding="utf-8")
