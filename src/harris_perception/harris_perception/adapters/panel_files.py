"""A taught panel as files: a layout for config/scopes and its template beside it."""

from __future__ import annotations

import shlex
from pathlib import Path

import cv2

from harris_perception.core.panel_teaching import Taught, TeachingError


def write_panel(taught: Taught, folder: Path, source: str) -> tuple[Path, Path]:
    """Write ``MODEL.yaml`` and ``MODEL.png``; return their paths. A panel that is there already is not touched.

    Raises
    ------
    TeachingError
        If one of them is there already.
    OSError
        If they cannot be written; then neither is left.
    """
    layout, template = folder / f"{taught.layout.model}.yaml", folder / f"{taught.layout.model}.png"
    for path in (layout, template):
        if path.exists():
            raise TeachingError(f"{path} is there already; remove it, or choose another model")
    good, png = cv2.imencode(".png", taught.template)
    if not good:
        raise OSError(f"{template} cannot be encoded")
    folder.mkdir(parents=True, exist_ok=True)
    # The layout is what makes the panel known, so it comes last and whole.
    unfinished = layout.with_suffix(".part")
    try:
        template.write_bytes(png.tobytes())
        unfinished.write_text(f"# Taught from {source}.\n{taught.text}", encoding="utf-8")
        unfinished.replace(layout)
    except OSError:
        for path in (template, unfinished):
            path.unlink(missing_ok=True)
        raise
    return layout, template


def how_to_start(taught: Taught, template: Path) -> str:
    """Return the command that brings the robot up with this panel."""
    return (
        f"bring_up --scope {taught.layout.model} --set recognition.template={shlex.quote(str(template.resolve()))} "
        f"--set recognition.template_px_per_mm={taught.px_per_mm:g}"
    )
