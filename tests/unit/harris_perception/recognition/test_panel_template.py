"""The template: shapes are at the layout's positions, to a small part of a pixel; masks and hidden parts."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from harris_perception.core.recognition.panel_template import (
    draw_panel,
    hidden_by_controls,
    outline_mm,
    panel_template,
)
from icu_common.core.panel.panel_layout import (
    ArtworkCircle,
    ArtworkLine,
    ArtworkRectangle,
    ArtworkText,
    Control,
    PanelLayout,
    parse_layout,
)


def layout(*artwork: object, controls: tuple[Control, ...] = ()) -> PanelLayout:
    knob = Control(
        name="K", kind="knob", position_mm=(50.0, 30.0), size_mm=(10.0, 10.0), shape="circle", height_mm=10.0
    )
    return PanelLayout(
        model="m",
        title="",
        size_mm=(60.0, 40.0),
        colour="#000000",
        controls=controls or (knob,),
        artwork=artwork,  # type: ignore[arg-type]
    )


def moments(picture: np.ndarray, px_per_mm: float) -> tuple[float, float, float]:
    """Area in mm^2 and centroid x, y in mm (y up) of the bright part, pixel centres at (0, 0)."""
    weight = picture[..., 0] / 255.0
    rows, columns = np.mgrid[0 : weight.shape[0], 0 : weight.shape[1]]
    total = weight.sum()
    u, v = (weight * columns).sum() / total, (weight * rows).sum() / total
    return total / px_per_mm**2, (u + 0.5) / px_per_mm, (weight.shape[0] - v - 0.5) / px_per_mm


PLAIN = Control(name="C", kind="connector", position_mm=(55.0, 35.0), size_mm=(2.0, 2.0), colour="#000000")


@pytest.mark.parametrize("px_per_mm", [2.0, 3.5, 7.3])
@pytest.mark.parametrize(
    ("item", "area", "centre"),
    [
        (ArtworkRectangle(rectangle_mm=(10.13, 5.27, 8.61, 4.43), fill="#ffffff"), 8.61 * 4.43, (14.435, 7.485)),
        (ArtworkCircle(circle_mm=(20.31, 17.77, 6.2), fill="#ffffff"), np.pi * 6.2**2, (20.31, 17.77)),
        (ArtworkCircle(circle_mm=(20.31, 17.77, 6.2), outline="#ffffff", line_mm=1.0), 2 * np.pi * 6.2, (20.31, 17.77)),
        (
            ArtworkRectangle(rectangle_mm=(10.13, 5.27, 8.61, 4.43), outline="#ffffff", line_mm=1.0),
            2 * (8.61 + 4.43),
            (14.435, 7.485),
        ),
        (
            ArtworkLine(line_from_to_mm=(5.2, 8.1, 31.7, 22.4), colour="#ffffff", line_mm=0.9),
            0.9 * np.hypot(26.5, 14.3) + np.pi * 0.45**2,
            (18.45, 15.25),
        ),
    ],
)
def test_area_and_place_of_artwork(item: object, area: float, centre: tuple[float, float], px_per_mm: float) -> None:
    drawn = draw_panel(layout(item, controls=(PLAIN,)), px_per_mm)
    found = moments(drawn, drawn.shape[1] / 60.0)
    assert found[0] == pytest.approx(area, rel=0.02)
    assert found[1:] == pytest.approx(centre, abs=0.03 / px_per_mm + 0.001 * px_per_mm)


def test_text_is_centred_and_as_high_as_asked() -> None:
    drawn = draw_panel(layout(ArtworkText(text="HOH", at_mm=(30.0, 20.0), height_mm=6.0, colour="#ffffff")), 10.0)
    rows = np.flatnonzero(drawn[..., 0][:, :400].max(axis=1) > 128)
    columns = np.flatnonzero(drawn[..., 0][:, :400].max(axis=0) > 128)
    assert (rows[0] + rows[-1]) / 2 == pytest.approx(199.5, abs=1.0)
    assert (columns[0] + columns[-1]) / 2 == pytest.approx(299.5, abs=1.0)
    assert rows[-1] - rows[0] == pytest.approx(64, abs=2)


def test_later_artwork_and_controls_lie_on_top() -> None:
    drawn = draw_panel(
        layout(
            ArtworkRectangle(rectangle_mm=(0.0, 0.0, 60.0, 40.0), fill="#ff0000"),
            ArtworkRectangle(rectangle_mm=(10.0, 10.0, 10.0, 10.0), fill="#00ff00"),
        ),
        2.0,
    )
    assert drawn[20, 80].tolist() == [0, 0, 255]
    assert drawn[49, 30].tolist() == [0, 255, 0]
    assert drawn[19, 100].tolist() == [0x48, 0x44, 0x40]


def test_homography_maps_mm_to_pixel_centres() -> None:
    template = panel_template(layout(), 4.0)
    corner = template.px_from_mm @ np.array([0.0, 40.0, 1.0])
    np.testing.assert_allclose(corner / corner[2], (-0.5, -0.5, 1.0))
    middle = template.px_from_mm @ np.array([0.125, 0.125, 1.0])
    np.testing.assert_allclose(middle / middle[2], (0.0, 159.0, 1.0))


@pytest.mark.parametrize("px_per_mm", [4.0, 2.51, 1.26])
def test_homography_of_a_picture_that_is_made_smaller_to_whole_pixels(px_per_mm: float) -> None:
    face = layout(ArtworkRectangle(rectangle_mm=(45.0, 30.0, 9.0, 5.0), fill="#ffffff"), controls=(PLAIN,))
    template = panel_template(face, px_per_mm, draw_panel(face, 8.0), 8.0)
    light = template.gray[:, template.gray.shape[1] // 2 :].astype(float)
    light = np.hstack([np.zeros((len(light), template.gray.shape[1] // 2)), light - light.min()])
    rows, columns = np.indices(light.shape)
    seen = np.array([(columns * light).sum(), (rows * light).sum(), light.sum()]) / light.sum()
    np.testing.assert_allclose(np.linalg.solve(template.px_from_mm, seen), (49.5, 32.5, 1.0), atol=0.02)


def test_screens_lamps_and_proud_controls_are_not_steady_and_text_is_not_exact() -> None:
    controls = (
        Control(name="SCREEN", kind="touch_area", position_mm=(15.0, 30.0), size_mm=(20.0, 10.0)),
        Control(name="LAMP", kind="button", position_mm=(50.0, 30.0), size_mm=(6.0, 6.0), lit_colour="#00ff00"),
        Control(name="PROUD", kind="button", position_mm=(50.0, 10.0), size_mm=(6.0, 6.0), height_mm=3.0),
        Control(name="FLAT", kind="connector", position_mm=(10.0, 10.0), size_mm=(6.0, 6.0)),
    )
    template = panel_template(layout(ArtworkText(text="AB", at_mm=(30.0, 5.0)), controls=controls), 4.0)

    def at(mask: np.ndarray, x: float, y: float) -> bool:
        return bool(mask[round((40.0 - y) * 4), round(x * 4)])

    assert [at(template.steady, *p) for p in ((15, 30), (50, 30), (50, 10))] == [False, False, False]
    assert at(template.steady, 10, 10) and at(template.exact, 10, 10)
    assert at(template.steady, 30, 5) and not at(template.exact, 30, 5)
    assert at(template.exact, 30, 20)
    photo = panel_template(layout(ArtworkText(text="AB", at_mm=(30.0, 5.0))), 4.0, np.zeros((80, 120), np.uint8), 2.0)
    assert at(photo.exact, 30, 5)


def test_hidden_part_is_where_a_ray_meets_the_control() -> None:
    panel = layout()
    eye = np.array([30.0, -200.0, 300.0])
    hidden = hidden_by_controls(panel, eye, (160, 240), 4.0)
    # The knob's top, seen from below, covers what lies above it: points p with p + (eye - p) t at 10 mm inside it.
    t = 10.0 / 300.0
    rows, columns = np.mgrid[0:160, 0:240]
    x, y = (columns + 0.5) / 4, 40.0 - (rows + 0.5) / 4
    top = np.hypot(x + (eye[0] - x) * t - 50, y + (eye[1] - y) * t - 30) <= 5.0
    foot = np.hypot(x - 50, y - 30) <= 5.0
    assert hidden[foot].mean() > 0.98
    assert hidden[top].mean() > 0.98
    assert not hidden[y < 24].any()
    grown = cv2.dilate((foot | top).astype(np.uint8), np.ones((41, 41), np.uint8)).astype(bool)
    assert not hidden[~grown].any()
    assert not hidden_by_controls(panel, np.array([30.0, 20.0, 5.0]), (160, 240), 4.0).any()


def test_outline_of_a_circle_lies_on_it() -> None:
    outline = outline_mm(layout().controls[0])
    np.testing.assert_allclose(np.linalg.norm(outline - (50.0, 30.0), axis=1), 5.0)


def test_picture_of_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match=r"has 100 x 80 px, the layout's 60 x 40 mm at 2 px/mm are 120 x 80 px"):
        panel_template(layout(), 4.0, np.zeros((80, 100), np.uint8), 2.0)


@pytest.mark.parametrize("px_per_mm", [0.1, 500.0])
def test_absurd_scales_are_refused(px_per_mm: float) -> None:
    with pytest.raises(ValueError, match="limits 16 to 8192 px"):
        draw_panel(layout(), px_per_mm)


def test_layout_text_becomes_a_picture() -> None:
    text = (
        "model: m\nsize_mm: [60, 40]\ncontrols:\n  - {name: A, kind: button, position_mm: [30, 20], size_mm: [8, 8]}\n"
    )
    drawn = draw_panel(parse_layout(text), 2.0)
    assert drawn.shape == (80, 120, 3)
    assert drawn[40, 60].tolist() == [0x48, 0x44, 0x40]
    assert drawn[5, 5].tolist() == [0x38, 0x34, 0x30]
