"""Drawings in true size, as SVG and PDF: filled rectangles, a ruler and lines of text on one sheet of paper.

Both formats are written directly: the size on paper must not depend on a drawing library's resolution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

PAPERS_MM = {"a4": (297.0, 210.0), "a3": (420.0, 297.0), "letter": (279.4, 215.9)}
RULER_MM = 100.0
BORDER_MM = 13.0
"""Minimum white border of a sheet, in which printers do not print."""
_POINTS_PER_MM = 72 / 25.4


class PrintRectangle(NamedTuple):
    """One filled rectangle in metres, relative to the upper left corner of the drawing, y down."""

    x: float
    y: float
    width: float
    height: float
    black: bool


class Label(NamedTuple):
    """A line of text 2.6 mm high; its left end in metres from the upper left corner of the drawing."""

    x: float
    y: float
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Sheet:
    """A sheet of paper in mm, and the upper left corner of the drawing on it; ``notes`` are at its lower border."""

    width: float
    height: float
    left: float
    top: float
    notes: tuple[str, str]
    rectangles: Sequence[PrintRectangle]
    labels: Sequence[Label] = ()


def svg(sheet: Sheet) -> str:
    """Return an SVG document; one user unit is one millimetre."""
    w, h = f"{sheet.width:.4f}", f"{sheet.height:.4f}"
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{w}mm" height="{h}mm" viewBox="0 0 {w} {h}">',
        f"<title>{sheet.notes[0]}</title>",
        f'<rect width="{w}" height="{h}" fill="#fff"/>',
    ]
    for part in sheet.rectangles:
        x, y = part.x * 1e3 + sheet.left, part.y * 1e3 + sheet.top
        size = f'width="{part.width * 1e3:.5f}" height="{part.height * 1e3:.5f}"'
        lines.append(f'<rect x="{x:.5f}" y="{y:.5f}" {size} fill="{"#000" if part.black else "#fff"}"/>')
    base = sheet.height - 8.5
    text = '<text x="{:g}" y="{:.4f}" font-family="Helvetica, Arial, sans-serif" font-size="2.6">{}</text>'
    lines += [text.format(part.x * 1e3 + sheet.left, part.y * 1e3 + sheet.top, part.text) for part in sheet.labels]
    lines.append(f'<rect x="{BORDER_MM:g}" y="{base:.4f}" width="{RULER_MM:g}" height="0.3" fill="#000"/>')
    lines += [text.format(BORDER_MM, base + 3.2 * (i + 1), note) for i, note in enumerate(sheet.notes)]
    return "\n".join([*lines, "</svg>", ""])


def pdf(sheet: Sheet) -> bytes:
    """Return a PDF document of one page (ISO 32000-1; 72 points are an inch, y points up)."""
    content = [f"{_POINTS_PER_MM:.8f} 0 0 {_POINTS_PER_MM:.8f} 0 0 cm"]
    for part in sheet.rectangles:
        x, y = part.x * 1e3 + sheet.left, sheet.height - sheet.top - (part.y + part.height) * 1e3
        size = f"{part.width * 1e3:.5f} {part.height * 1e3:.5f}"
        content.append(f"{0 if part.black else 1} g {x:.5f} {y:.5f} {size} re f")
    content.append(f"0 g {BORDER_MM:g} 8.2 {RULER_MM:g} 0.3 re f")
    texts = [(part.x * 1e3 + sheet.left, sheet.height - sheet.top - part.y * 1e3, part.text) for part in sheet.labels]
    texts += [(BORDER_MM, 8.5 - 3.2 * (i + 1), note) for i, note in enumerate(sheet.notes)]
    content += [f"BT /F1 2.6 Tf {x:g} {y:.4f} Td ({text}) Tj ET" for x, y, text in texts]
    stream = "\n".join(content).encode("ascii")
    box = f"0 0 {sheet.width * _POINTS_PER_MM:.5f} {sheet.height * _POINTS_PER_MM:.5f}"
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [{box}] /Contents 4 0 R "
        "/Resources << /Font << /F1 5 0 R >> >> >>".encode(),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(stream), stream),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    document, places = b"%PDF-1.6\n", []
    for number, body in enumerate(objects, start=1):
        places.append(len(document))
        document += b"%d 0 obj\n%s\nendobj\n" % (number, body)
    table = b"".join(b"%010d 00000 n \n" % place for place in places)
    count, start = len(objects) + 1, len(document)
    return (
        document
        + b"xref\n0 %d\n0000000000 65535 f \n%s" % (count, table)
        + b"trailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (count, start)
    )
