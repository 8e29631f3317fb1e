"""A panel in files: a layout for config/scopes with its template next to it."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import cv2
import numpy.typing as npt

from harris_perception.core.recognition.panel_teaching import Taught, TeachingError
from icu_common.core.configuration.config import ConfigError
from icu_common.core.panel.panel_layout import LayoutError, PanelLayout, load_layout
from icu_common.core.reasons.message import Message


def read_panel(layout: str, template: str) -> tuple[PanelLayout, npt.NDArray[Any] | None]:
    """Read a layout file, and the image (H, W) uint8 of the face if one is given.

    Raises
    ------
    ConfigError
        If one of them cannot be read.
    """
    try:
        panel = load_layout(Path(layout))
    except (OSError, LayoutError) as error:
        raise ConfigError(f"layout: {error}") from error
    if not template:
        return panel, None
    image = cv2.imread(template, cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise ConfigError(f"template: {template} is not a picture that can be read")
    return panel, image


def write_panel(taught: Taught, folder: Path, source: str) -> tuple[Path, Path]:
    """Write ``MODEL.yaml`` and ``MODEL.png``; return their paths. Existing files are never changed.

    Raises
    ------
    TeachingError
        If one of them already exists.
    OSError
        If they cannot be written; neither file remains.
    """
    layout, template = folder / f"{taught.layout.model}.yaml", folder / f"{taught.layout.model}.png"
    for path in (layout, template):
        if path.exists():
            raise TeachingError(Message("teach.already_remove_choose_another_model", path=path))
    good, png = cv2.imencode(".png", taught.template)
    if not good:
        raise OSError(Message("teach.cannot_encoded", template=template))
    folder.mkdir(parents=True, exist_ok=True)
    # A panel is known once its layout exists, so the layout is written last and atomically.
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
    """Return the command that starts the robot with this panel."""
    return (
        f"bring_up --scope {taught.layout.model} --set recognition.template={shlex.quote(str(template.resolve()))} "
        f"--set recognition.template_px_per_mm={taught.px_per_mm:g}"
    )
