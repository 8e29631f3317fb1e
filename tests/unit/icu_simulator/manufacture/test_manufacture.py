"""The made panel: its deviations have the size that is asked for, and truth, touch and images agree on it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from icu_common.core.configuration.config import from_mapping
from icu_common.core.panel.panel_layout import ArtworkCircle, ArtworkRectangle, ArtworkText, load_layout
from icu_simulator.core.bench import Bench
from icu_simulator.core.configuration import BenchConfig
from icu_simulator.core.instrument import InstrumentState
from icu_simulator.core.panel_texture import draw_face
from icu_simulator.core.renderer import Moment, Renderer, base_from_panel, control_pixels
from icu_simulator.manufacture.age import aged
from icu_simulator.manufacture.configuration import AgeConfig, ManufactureConfig, PrintConfig
from icu_simulator.manufacture.layout import deviations, manufactured, print_offset_mm

SCOPES = Path(__file__).parents[4] / "config/scopes"
LAYOUT = load_layout(SCOPES / "dso_bench_4.yaml")
MADE = ManufactureConfig(enabled=True)
PLAIN_PRINT = PrintConfig(offset_mm=0.0, font_weight=1.0, font_width=1.0, font_height=1.0)
NEW = AgeConfig(wear=0.0, dust_per_dm2=0.0, screws=False)


def offsets(seed: int, config: ManufactureConfig = MADE) -> np.ndarray:
    made = manufactured(LAYOUT, config, seed)
    return np.array([entry["off_mm"] for entry in deviations(LAYOUT, made).values()])


def test_switched_off_the_panel_is_its_layout_file() -> None:
    assert manufactured(LAYOUT, ManufactureConfig(), 1) is LAYOUT
    bench = Bench(LAYOUT, BenchConfig())
    assert bench.layout is LAYOUT
    assert bench.take_records() == []
    assert {tuple(c["off_mm"]) for c in bench.truth()["controls"].values()} == {(0.0, 0.0, 0.0)}


@pytest.mark.parametrize("name", sorted(path.stem for path in SCOPES.glob("*.yaml")))
def test_the_offset_of_the_print_is_that_of_all_its_shapes(name: str) -> None:
    layout = load_layout(SCOPES / f"{name}.yaml")
    assert print_offset_mm(layout, layout) == (0.0, 0.0)
    made = manufactured(layout, MADE, 7)
    x, y = print_offset_mm(layout, made)
    assert 0.0 < max(abs(x), abs(y)) <= MADE.print.offset_mm
    for before, after in zip(layout.markers, made.markers):
        assert np.subtract(after.position_mm, before.position_mm) == pytest.approx((x, y), abs=1e-9)
    for kind, corner in ((ArtworkRectangle, "rectangle_mm"), (ArtworkCircle, "circle_mm")):
        pairs = zip(
            *(
                [getattr(item, corner)[:2] for item in panel.artwork if isinstance(item, kind)]
                for panel in (layout, made)
            )
        )
        for first, second in pairs:
            assert np.subtract(second, first) == pytest.approx((x, y), abs=1e-9)


@pytest.mark.parametrize("position_mm", [0.2, 0.6])
@pytest.mark.parametrize("height_mm", [0.2, 0.8])
def test_deviations_keep_their_bounds_and_use_them(position_mm: float, height_mm: float) -> None:
    config = dataclasses.replace(MADE, position_mm=position_mm, height_mm=height_mm)
    off = np.concatenate([offsets(seed, config) for seed in range(30)])
    assert np.abs(off[:, :2]).max() <= position_mm + 1e-4
    assert np.abs(off[:, :2]).max() > 0.97 * position_mm
    assert off[:, :2].std() == pytest.approx(position_mm / np.sqrt(3), rel=0.1), "uniform within the bounds"
    proud = np.tile([c.height_mm > 0 for c in LAYOUT.controls], 30)
    assert np.abs(off[proud, 2]).max() <= height_mm + 1e-4
    assert np.abs(off[proud, 2]).max() > 0.95 * height_mm
    assert not off[~proud, 2].any(), "a screen stays in the face"


def test_the_seed_makes_the_panel() -> None:
    assert np.array_equal(offsets(4), offsets(4))
    assert not np.array_equal(offsets(4), offsets(5))


@pytest.mark.parametrize("name", sorted(path.stem for path in SCOPES.glob("*.yaml")))
def test_every_panel_can_be_made_with_the_greatest_deviations(name: str) -> None:
    layout = load_layout(SCOPES / f"{name}.yaml")
    config = dataclasses.replace(MADE, position_mm=5.0, height_mm=5.0, colour_levels=80.0)
    made = manufactured(layout, config, 3)
    for control, nominal in zip(made.controls, layout.controls):
        half = np.array(control.size_mm) / 2
        assert (np.array(control.position_mm) >= half - 1e-9).all()
        assert (np.array(control.position_mm) <= np.array(layout.size_mm) - half + 1e-9).all()
        assert (control.height_mm > 0) == (nominal.height_mm > 0)


def test_the_print_is_offset_as_a_whole_and_its_letters_have_another_shape() -> None:
    config = ManufactureConfig(
        enabled=True, position_mm=0.0, height_mm=0.0, colour_levels=0.0, age=NEW, print=PrintConfig(offset_mm=0.5)
    )
    text = ArtworkText(text="OXO", at_mm=(100.0, 100.0), height_mm=5.0)
    layout = dataclasses.replace(LAYOUT, artwork=(LAYOUT.artwork[0], text))
    made = manufactured(layout, config, 2)
    frame, moved = layout.artwork[0], made.artwork[0]
    offset = np.array(moved.rectangle_mm)[:2] - np.array(frame.rectangle_mm)[:2]
    assert 0 < np.abs(offset).max() <= 0.5
    lines = [i for i in made.artwork if getattr(i, "line_mm", 0) == pytest.approx(text.line_mm * 1.35)]
    ends = np.array([i.line_from_to_mm for i in lines]).reshape(-1, 2)
    middle = (ends.min(axis=0) + ends.max(axis=0)) / 2
    assert middle == pytest.approx(np.array(text.at_mm) + offset, abs=0.01), "a word that is the same mirrored"
    assert np.ptp(ends[:, 1]) == pytest.approx(0.97 * 5.0, abs=1e-6)
    assert not any(isinstance(item, ArtworkText) for item in made.artwork)


def ink_box(face: np.ndarray, ground: np.ndarray) -> tuple[float, float, float]:
    """Return width, height and area of the print, in texels."""
    rows, columns = np.nonzero(np.abs(face.astype(int) - ground).sum(axis=2) > 60)
    return np.ptp(columns) + 1.0, np.ptp(rows) + 1.0, float(len(rows))


def test_the_font_is_heavier_and_narrower_in_the_drawn_face() -> None:
    word = ArtworkText(text="RUN/STOP", at_mm=(100.0, 100.0), height_mm=6.0, colour="#101010", line_mm=0.6)
    layout = dataclasses.replace(LAYOUT, artwork=(word,), controls=LAYOUT.controls[1:2])
    exact = ManufactureConfig(enabled=True, position_mm=0.0, height_mm=0.0, colour_levels=0.0, age=NEW)
    same = manufactured(layout, dataclasses.replace(exact, print=PLAIN_PRINT), 1)
    bold = manufactured(
        layout,
        dataclasses.replace(exact, print=dataclasses.replace(PLAIN_PRINT, font_weight=1.5, font_width=0.8)),
        1,
    )
    ground = np.array([0xC1, 0xC4, 0xBF])
    window = slice(200, 600), slice(300, 1300)
    faces = [draw_face(panel, 8.0)[window] for panel in (layout, same, bold)]
    nominal, again, heavy = (ink_box(face, ground) for face in faces)
    assert np.abs(faces[0].astype(int) - faces[1]).mean() < 0.05, "as lines, the letters look as the layout's do"
    assert again[:2] == pytest.approx(nominal[:2], abs=1.1)
    # Ink reaches half a line beyond the strokes: 0.8 of the strokes' width, and 1.5 lines instead of 1.
    assert heavy[0] == pytest.approx((nominal[0] - 0.6 * 8) * 0.8 + 0.9 * 8, abs=2.5)
    assert heavy[2] > 1.2 * nominal[2]


@pytest.mark.parametrize("share", [0.05, 0.3])
def test_wear_takes_the_asked_share_of_the_print(share: float) -> None:
    face = draw_face(LAYOUT, 4.0).astype(int)
    bare = draw_face(dataclasses.replace(LAYOUT, artwork=tuple(a for a in LAYOUT.artwork if hasattr(a, "fill"))), 4.0)
    ink = np.abs(face - bare).sum(axis=2) > 90
    worn = aged(LAYOUT, AgeConfig(wear=share, dust_per_dm2=0.0), 3, 4.0, draw_face).astype(int)
    gone = np.abs(worn - bare).sum(axis=2) < np.abs(worn - face).sum(axis=2)
    assert gone[ink].mean() == pytest.approx(share, rel=0.45)
    assert np.array_equal(worn[~(np.abs(face - bare).sum(axis=2) > 0)], face[~(np.abs(face - bare).sum(axis=2) > 0)])


def test_dust_has_the_asked_density_and_size() -> None:
    clean = draw_face(LAYOUT, 4.0).astype(int)
    dusty = aged(LAYOUT, AgeConfig(wear=0.0, dust_per_dm2=40.0), 3, 4.0, draw_face).astype(int)
    changed = np.abs(dusty - clean).sum(axis=2) > 0
    expected = 40.0 * LAYOUT.size_mm[0] * LAYOUT.size_mm[1] / 1e4
    # A speck of 0.08 to 0.35 mm radius covers 1 to 15 texels of a quarter of a millimetre.
    assert expected < changed.sum() < 20 * expected
    assert np.array_equal(dusty, aged(LAYOUT, AgeConfig(wear=0.0, dust_per_dm2=40.0), 3, 4.0, draw_face))


def made_bench(values: dict[str, object], seed: int = 3) -> tuple[Bench, BenchConfig]:
    config = from_mapping(BenchConfig, {"seed": seed, "manufacture.enabled": True, **values})
    return Bench(LAYOUT, config), config


def test_log_and_truth_say_which_panel_is_true() -> None:
    bench, _ = made_bench({"manufacture.position_mm": 0.6, "manufacture.height_mm": 0.8})
    (record,) = bench.take_records()
    assert record["event"] == "layout"
    for control in bench.layout.controls:
        entry = record["controls"][control.name]
        assert entry["true_mm"] == pytest.approx([*control.position_mm, control.height_mm], abs=1e-4)
        nominal = LAYOUT.control(control.name)
        expected = np.array(entry["true_mm"]) - [*nominal.position_mm, nominal.height_mm]
        assert entry["off_mm"] == pytest.approx(expected.tolist(), abs=2e-4)
    assert bench.truth()["controls"] == record["controls"]


def test_a_touch_meets_the_made_control_and_is_logged_with_its_true_place() -> None:
    bench, _ = made_bench({"manufacture.height_mm": 0.8})
    made, nominal = bench.layout.control("SAVE"), LAYOUT.control("SAVE")
    assert abs(made.height_mm - nominal.height_mm) > 0.05
    bench.take_records()
    x, y = nominal.position_mm
    bench.touch.place(np.array([x, y, 30.0]), 1.0)
    bench.touch.move(np.array([x, y, made.height_mm + 2.0 - 0.001]), 2.0, 1.0)
    (contact,) = bench.take_records()
    assert (contact["event"], contact["control"]) == ("contact", "SAVE")
    assert contact["control_mm"] == pytest.approx([*made.position_mm, made.height_mm], abs=1e-4)
    assert contact["tip_panel_mm"][2] == pytest.approx(made.height_mm + 2.0, abs=0.11)


def test_a_new_manufacture_is_taken_live_and_logged() -> None:
    bench = Bench(LAYOUT, BenchConfig(seed=3))
    bench.feed((-359.0, -219.0, -1.0), 0, False, 10.0)
    tip = bench.tip_base()
    bench.reconfigure(dataclasses.replace(bench.config, manufacture=MADE))
    assert bench.layout == manufactured(LAYOUT, MADE, 3)
    assert bench.tip_base() == pytest.approx(tip.tolist(), abs=1e-12), "the machine has not moved"
    assert [r["event"] for r in bench.take_records()] == ["layout"]
    bench.reconfigure(dataclasses.replace(bench.config, manufacture=ManufactureConfig()))
    assert bench.layout is LAYOUT


def test_the_image_shows_the_made_panel() -> None:
    values = {"manufacture.position_mm": 3.0, "manufacture.height_mm": 0.0, "light.noise": 0.0, "light.blur_px": 0.0}
    bench, config = made_bench(values)
    nominal = dataclasses.replace(config, manufacture=ManufactureConfig())
    panel = base_from_panel(config.panel)
    moment = Moment(tip=(0.0, 0.0, 0.2), state=InstrumentState(), now_s=1.0)
    made, ideal = Renderer(LAYOUT, config, panel), Renderer(LAYOUT, nominal, panel)
    image, reference = made.render(moment)[0].astype(int), ideal.render(moment)[0].astype(int)
    assert np.abs(image - reference).mean() > 1
    there = control_pixels(made.views[0], bench.layout)["AUTO_SET"]["centre"]
    here = control_pixels(ideal.views[0], LAYOUT)["AUTO_SET"]["centre"]
    off_px = np.array(there) - here
    off_mm = np.array(bench.layout.control("AUTO_SET").position_mm) - LAYOUT.control("AUTO_SET").position_mm
    assert off_px[0] == pytest.approx(off_mm[0] * 1700 / 665, rel=0.25)
    # The blue key's own colour is found around its made place.
    blue = (reference[..., 0] - reference[..., 2] > 40) | (image[..., 0] - image[..., 2] > 40)
    blue[: int(here[1]) - 40] = blue[int(here[1]) + 40 :] = False
    blue[:, : int(here[0]) - 45] = blue[:, int(here[0]) + 45 :] = False
    centres = []
    for picture in (image, reference):
        rows, columns = np.nonzero((picture[..., 0] - picture[..., 2] > 40) & blue)
        centres.append((columns.mean(), rows.mean()))
    assert np.subtract(*centres) == pytest.approx(off_px.tolist(), abs=0.6)
