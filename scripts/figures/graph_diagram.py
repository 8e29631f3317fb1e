"""Draw the programs of the graph and the topics between them (docs/explanation/graph.svg); see ``make figures``."""

from __future__ import annotations

import argparse
import html
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
WIDTH, HEIGHT = 150, 44
NODES = {
    "cameras": (20, 150, "cameras / bench"),
    "camera": (210, 150, "camera"),
    "corners": (440, 60, "corners (left, right)"),
    "stereo": (700, 60, "stereo"),
    "recognition": (440, 150, "recognition"),
    "stylus_tracker": (440, 240, "stylus_tracker"),
    "hand_eye": (700, 240, "hand_eye"),
    "controller": (960, 150, "gantry_controller"),
    "sequencer": (700, 330, "sequencer"),
    "page": (960, 330, "ui_bridge (page)"),
    "driver": (1200, 150, "serial_driver"),
    "guard": (1200, 240, "gantry_guard"),
    "board": (1200, 330, "GRBL board (or mock)"),
}
"""Left and upper edge, and text of each box."""
ROOM = ("cameras", "board")
"""Boxes that are in the room, or simulated."""
EDGES = (
    ("cameras", "camera", "", "r", "l"),
    ("camera", "corners", "image_raw", "r", "l"),
    ("camera", "recognition", "", "r", "l"),
    ("camera", "stylus_tracker", "image_raw", "r", "l"),
    ("corners", "stereo", "corners", "r", "l"),
    ("corners", "recognition", "corners", "b", "t"),
    ("recognition", "controller", "panel pose, controls, lamps and knobs", "r", "l"),
    ("stylus_tracker", "hand_eye", "tip", "r", "l"),
    ("stylus_tracker", "controller", "tip", "r", "l"),
    ("hand_eye", "controller", "calibration, goals", "r", "b"),
    ("sequencer", "controller", "commands", "r", "b"),
    ("page", "controller", "goal, command, heartbeat", "t", "b"),
    ("controller", "driver", "trajectory", "r", "l"),
    ("driver", "guard", "orders", "b", "t"),
    ("guard", "board", "G-code", "b", "t"),
    ("page", "guard", "stop", "r", "l"),
)
"""From, to, topics, and the sides of both boxes."""


def end(name: str, side: str) -> tuple[float, float]:
    """Return the middle of a side of a box."""
    x, y, _ = NODES[name]
    return {
        "l": (x, y + HEIGHT / 2),
        "r": (x + WIDTH, y + HEIGHT / 2),
        "t": (x + WIDTH / 2, y),
        "b": (x + WIDTH / 2, y + HEIGHT),
    }[side]


def drawing() -> str:
    """Return the SVG document."""
    parts = []
    for start, to, words, out, into in EDGES:
        (x0, y0), (x1, y1) = end(start, out), end(to, into)
        parts.append(
            f'<line x1="{x0:g}" y1="{y0:g}" x2="{x1:g}" y2="{y1:g}" stroke="#57606a" stroke-width="1.4" '
            'marker-end="url(#to)"/>'
        )
        share = {"sequencer": 0.25, "hand_eye": 0.35}.get(start, 0.5)
        x, y = x0 + share * (x1 - x0), y0 + share * (y1 - y0)
        if words:
            wide = 6.4 * len(words)
            parts.append(f'<rect x="{x - wide / 2:g}" y="{y - 8:g}" width="{wide:g}" height="15" fill="#fff"/>')
            parts.append(f'<text x="{x:g}" y="{y + 4:g}" text-anchor="middle">{html.escape(words)}</text>')
    for name, (left, top, words) in NODES.items():
        fill, line = ("#fff1e5", "#bc4c00") if name in ROOM else ("#ddf4ff", "#0969da")
        parts.append(
            f'<rect x="{left}" y="{top}" width="{WIDTH}" height="{HEIGHT}" rx="6" fill="{fill}" stroke="{line}"/>'
            f'<text x="{left + WIDTH / 2:g}" y="{top + HEIGHT / 2 + 5:g}" text-anchor="middle" font-size="13">'
            f"{html.escape(words)}</text>"
        )
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 40 1370 350" width="1370" height="350" '
        'font-family="system-ui, sans-serif" font-size="12" fill="#1f2328">\n'
        "<title>Programs of the graph and the topics between them</title>\n"
        '<defs><marker id="to" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="8" markerHeight="8" orient="auto">'
        '<path d="M0 0L10 5L0 10z" fill="#57606a"/></marker></defs>\n'
        '<rect y="40" width="1370" height="350" fill="#fff"/>\n' + "\n".join(parts) + "\n</svg>\n"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "docs" / "explanation" / "graph.svg")
    parser.parse_args().out.write_text(drawing(), encoding="utf-8")
