"""The recording for the Rerun viewer has the bag's numbers and images, read back with rerun's own reader."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from unit.icu_bringup.export import recorded_session as recorded

from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.cli import bag_export

GOLDEN = Path(__file__).parents[3] / "golden" / "bag"
chunks = pytest.importorskip("rerun.chunk", reason="rerun-sdk is not installed")


def columns(bag: Path, out: Path) -> dict[str, dict[str, list[Any]]]:
    """Return the values of each component of each entity."""
    assert bag_export.main([str(bag), "--out", str(out), "--form", "rerun"]) == 0
    reader = chunks.RrdReader(out / "session.rrd")
    assert len(reader.blueprints()) == 1
    found: dict[str, dict[str, list[Any]]] = {}
    for chunk in reader.stream():
        batch = chunk.to_record_batch()
        entity = found.setdefault(str(chunk.entity_path).strip("/"), {})
        for name, values in zip(batch.schema.names, batch.columns):
            entity.setdefault(name, []).extend(values.to_numpy(zero_copy_only=False).tolist())
    return found


def test_readings_scene_and_images_are_those_of_the_bag(tmp_path: Path) -> None:
    bag = recorded.write(tmp_path / "bag")
    found = columns(bag, tmp_path / "out")
    states = [row for row in recorded.rows() if row[0] == "/joint_states"]
    for i, name in enumerate(recorded.NAMES):
        values = [value for [value] in found[f"joints/{name}"]["Scalars:scalars"]]
        assert values == [message.position[i] for _, _, message in states]
    times = found[f"joints/{recorded.NAMES[0]}"]["time"]
    assert times == [recorded.START_NS + round(seconds * 1e9) for _, seconds, _ in states]

    def numbers(entity: str, component: str) -> np.ndarray:
        return np.array([np.ravel(np.array(value.tolist())) for value in found[entity][component]])

    assert numbers("scene/base", "Transform3D:translation") == pytest.approx(np.array([[0.1, 0.2, 0.5]]))
    assert numbers("scene/panel", "Transform3D:translation") == pytest.approx(np.array([[0.1, 0.2, 0.6]]))
    assert numbers("scene/tip", "Points3D:positions") == pytest.approx(np.array([[0.1, 0.2, 0.6]]))
    assert numbers("scene/base/stylus", "Points3D:positions")[-1] == pytest.approx([0.08, 0.08, -0.004])
    assert numbers("scene/base/axes", "Arrows3D:vectors").reshape(3, 3) == pytest.approx(0.05 * np.eye(3))
    [[trace]] = found["scene/base/trace"]["LineStrips3D:strips"]
    assert np.array(trace.tolist())[-1] == pytest.approx([0.08, 0.08, -0.004]) and len(trace) == len(states)
    assert numbers("scene/right", "Transform3D:translation")[-1] == pytest.approx([0.12, 0.0, 0.0])
    kind = recorded.KINDS["/stereo/left/image_raw/compressed"]
    with BagReader(bag) as source:
        rows = source.messages(["/stereo/left/image_raw/compressed"])
        packed = [bytes(source.decode(data, kind).data) for _, _, data in rows]
    assert [np.asarray(blob, np.uint8).tobytes() for [blob] in found["images/left"]["EncodedImage:blob"]] == packed
    raw = [np.asarray(buffer, np.uint8).reshape(48, 64, 3) for [buffer] in found["images/right"]["Image:buffer"]]
    assert [np.array_equal(pixels, recorded.picture(i, "right")) for i, pixels in enumerate(raw)] == [True] * 20
    texts = [text for [text] in found["texts/gantry/command"]["TextLog:text"]]
    assert texts == ["press:RUN_STOP id=a1", "press:MENU id=a2"]


def test_readings_before_the_first_calibration_are_placed_by_it(tmp_path: Path) -> None:
    """The viewer puts an entity without a transform at the camera."""
    found = columns(recorded.write(tmp_path / "bag", calibrated_s=2.0), tmp_path / "out")
    assert found["scene/base"]["time"] == [recorded.START_NS, recorded.START_NS + 2 * 10**9]
    placed = [np.ravel(value.tolist()) for value in found["scene/base"]["Transform3D:translation"]]
    assert np.array(placed) == pytest.approx(np.array(2 * [[0.1, 0.2, 0.5]]))
    times = [round((ns - recorded.START_NS) / 1e9, 2) for ns in found["scene/base/stylus"]["time"]]
    places = [np.ravel(value[0]) for value in found["scene/base/stylus"]["Points3D:positions"]]
    readings = np.array([[0.01 * seconds, 0.02 * seconds] for seconds in times])
    assert np.array(places)[:, :2] == pytest.approx(readings @ np.array(recorded.AXES).T, abs=1e-7)


def test_without_a_calibration_the_machine_has_a_scene_of_its_own(tmp_path: Path) -> None:
    found = columns(GOLDEN, tmp_path / "out")
    with BagReader(GOLDEN) as bag:
        count = {topic.name: topic.count for topic in bag.topics}
    assert len(found["base/stylus"]["Points3D:positions"]) == count["/joint_states"] > 200
    assert len(found["images/left"]["EncodedImage:blob"]) == count["/stereo/left/image_raw/compressed"] > 100
    assert "scene/base" not in found
