"""The rooms in config/rooms: the bench accepts their parameters, and uses those of the chosen room."""

from __future__ import annotations

from pathlib import Path

import pytest

from icu_bringup.core.startup.graph_description import GraphDescriptionError, load_graph
from icu_common.core.configuration.config import from_mapping
from icu_common.core.configuration.parameter_file import values_for
from icu_simulator.core.configuration import BenchConfig
from icu_simulator.imaging.effect import effects_of

CONFIG = Path(__file__).parents[4] / "config"
ROOMS = ("ideal", "ward", "workshop")


def room(name: str) -> BenchConfig:
    base = values_for("bench", CONFIG / "params" / "bench.yaml")
    return from_mapping(BenchConfig, {**base, **values_for("bench", CONFIG / "rooms" / f"{name}.yaml")})


def test_there_are_three_rooms_and_ideal_is_the_bench_without_effects() -> None:
    assert tuple(sorted(path.stem for path in (CONFIG / "rooms").glob("*.yaml"))) == ROOMS
    assert room("ideal") == BenchConfig()


@pytest.mark.parametrize("name", ["workshop", "ward"])
def test_rooms_switch_effects_on(name: str) -> None:
    enabled = {effect for effect, settings in effects_of(room(name)) if settings.enabled}
    assert {"imaging.calibration", "imaging.jpeg", "imaging.bayer", "imaging.free_running"} <= enabled
    assert "imaging.knock" not in enabled, "only a test knocks against a camera"


def test_every_value_has_its_reason_beside_it() -> None:
    for name in ("workshop", "ward"):
        text = (CONFIG / "rooms" / f"{name}.yaml").read_text(encoding="utf-8")
        assert text.startswith("#") and text.count("#") >= 12


def test_the_bench_of_the_graph_stands_in_the_named_room() -> None:
    def rooms(profile: str, name: str) -> list[str]:
        programs = load_graph(CONFIG, profile, run=Path("/run"), state=Path("/state"), room=name)
        return [p.stem for program in programs for p in program.parameter_files if p.parent.name == "rooms"]

    assert rooms("bench", "") == ["workshop"] and rooms("bench", "ideal") == ["ideal"]
    assert rooms("test", "") == ["ideal"] and rooms("test", "ward") == ["ward"]
    assert rooms("carriage", "") == rooms("carriage_test", "") == ["ideal"], "a profile's own room"
    assert rooms("carriage", "workshop") == ["workshop"]
    assert rooms("hardware", "") == rooms("replay", "") == []
    with pytest.raises(GraphDescriptionError, match=r"room 'cellar' is none of the rooms in .*: ideal, ward, workshop"):
        rooms("bench", "cellar")
    with pytest.raises(GraphDescriptionError, match="room 'ward': profile hardware has no simulated bench"):
        rooms("hardware", "ward")
