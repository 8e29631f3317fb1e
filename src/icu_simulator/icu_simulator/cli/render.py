"""Render pictures of the bench without ROS, with their ground truth as JSON, for experiments with perception."""

from __future__ import annotations

import argparse
import json
import math

import cv2

from icu_common.adapters.configuration_folder import configuration_folder
from icu_common.adapters.processes.program_end import ends_quietly
from icu_common.core.configuration.config import from_mapping
from icu_common.core.configuration.option_bounds import named_path
from icu_common.core.configuration.yaml_text import values_of_pairs
from icu_common.core.panel.panel_layout import PanelLayout, load_layout
from icu_simulator.core.bench import matrix
from icu_simulator.core.configuration import BenchConfig
from icu_simulator.core.instrument import InstrumentState, press, turn
from icu_simulator.core.renderer import Moment, Renderer, base_from_panel, control_pixels

_FARTHEST_M = 10.0
_LAYOUT = "scopes/dso_bench_4.yaml"


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} is not finite")
    return value


def _tip(options: argparse.Namespace) -> str:
    return f"--tip {' '.join(f'{v:g}' for v in options.tip)}"


def _state(options: argparse.Namespace, layout: PanelLayout) -> InstrumentState:
    """Return the instrument after the given presses and turns; a KeyError names an unknown control."""
    state = InstrumentState()
    for name in options.press:
        state = press(state, layout.control(name).name, options.time - 0.5)
    for item in options.turn:
        name, _, degrees = item.partition("=")
        try:
            angle_deg = _finite(degrees)
        except (ValueError, argparse.ArgumentTypeError):
            raise ValueError(f"--turn {item}; expected NAME=DEGREES") from None
        if (control := layout.control(name)).kind != "knob":
            raise ValueError(f"--turn {item}: {name} is a {control.kind}; expected a knob")
        state = turn(state, name, angle_deg, control.detent_deg)
    return state


@ends_quietly
def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="bench_render", description=__doc__)
    parser.add_argument(
        "--layout",
        type=named_path,
        help=f"panel's file (default: {_LAYOUT} of the configuration)",
    )
    parser.add_argument("--out", type=named_path, required=True, help="picture to write, for example left.png")
    parser.add_argument("--truth", type=named_path, help="JSON file with the truth; default: beside the picture, .json")
    parser.add_argument("--side", choices=("left", "right"), default="left", help="camera (default: %(default)s)")
    parser.add_argument(
        "--tip",
        type=_finite,
        nargs=3,
        metavar=("X", "Y", "Z"),
        default=(0.30, 0.20, 0.0),
        help="stylus's tip in base_link, m (default: 0.3 0.2 0)",
    )
    parser.add_argument(
        "--press", action="append", default=[], metavar="NAME", help="button pressed before the picture"
    )
    parser.add_argument("--turn", action="append", default=[], metavar="NAME=DEGREES", help="knob turned before")
    parser.add_argument(
        "--time", type=_finite, default=3.0, help="seconds since the bench was switched on (default: %(default)s)"
    )
    parser.add_argument("--hide", type=_finite, nargs=4, metavar=("X", "Y", "W", "H"), help="hand over the panel, mm")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="setting, e.g. light.noise=0")
    options = parser.parse_args(arguments)
    truth_file = options.truth or options.out.with_suffix(".json")
    try:
        layout_file = options.layout or configuration_folder() / _LAYOUT
        if truth_file.resolve() == options.out.resolve():
            raise ValueError(f"--truth {truth_file}: the picture is written there")
        for name, file in (("--truth", truth_file), ("--out", options.out)):
            if file.resolve() == layout_file.resolve():
                raise ValueError(f"{name} {file}: the layout is read from there")
        if not max(map(abs, options.tip)) <= _FARTHEST_M:
            raise ValueError(f"{_tip(options)}: at most {_FARTHEST_M:g} m from base_link's origin are drawn")
        if options.hide and min(options.hide[2:]) <= 0:
            raise ValueError(f"--hide {' '.join(f'{v:g}' for v in options.hide)}; expected W and H above 0")
        config = from_mapping(BenchConfig, values_of_pairs(options.set))
        layout = load_layout(layout_file)
        state = _state(options, layout)
    except (ValueError, OSError) as error:
        parser.error(str(error))
    except KeyError as error:
        parser.error(str(error.args[0]))
    stands = base_from_panel(config.panel)
    renderer = Renderer(layout, config, stands)
    index = ("left", "right").index(options.side)
    view = renderer.views[index]
    if not view.camera.camera_from_base.apply(options.tip)[2] > 0:
        parser.error(f"{_tip(options)}: it is behind the {options.side} camera")
    renderer.hide(tuple(options.hide) if options.hide else None)
    moment = Moment(tip=tuple(options.tip), state=state, now_s=options.time)
    picture = renderer.render(moment)[index]
    try:
        encoded = cv2.imencode(options.out.suffix, picture)[1].tobytes()
    except cv2.error:
        parser.error(f"{options.out} cannot be written: no format {options.out.suffix!r} is known")
    camera_from_base = renderer.rig.rectified_left_from_base()
    truth = {
        "side": options.side,
        "tip_base_m": list(options.tip),
        "tip_px": view.camera.project(options.tip)[0].tolist(),
        "camera_left_from_base": matrix(camera_from_base),
        "camera_left_from_panel": matrix(camera_from_base @ stands),
        "base_from_panel": matrix(stands),
        "controls_px": control_pixels(view, renderer.layout),
    }
    try:
        options.out.write_bytes(encoded)  # imwrite does not report that a small file did not fit on the disk
        truth_file.write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        parser.error(str(error))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
