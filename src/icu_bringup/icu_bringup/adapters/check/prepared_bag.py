"""A copy of a bag under the names of this graph: cameras renamed, camera_info added, ROS 1 converted."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import yaml
from rosbags.convert import ConverterError, convert
from rosbags.typesys import Stores, get_typestore

from icu_bringup.adapters.bag.bag_pictures import COMPRESSED, IMAGE, SUFFIX
from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.adapters.bag.bag_writer import BagWriter
from icu_bringup.adapters.bag.bags import BagError, BagTopic
from icu_bringup.core.check.expectation import Run
from icu_common.core.configuration.yaml_text import UNREADABLE, ForeignLoader, mistake

CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
SIDES = ("left", "right")
_TYPES = get_typestore(Stores.ROS2_JAZZY)


def converted(bag: Path, folder: Path) -> Path:
    """Convert a ROS 1 bag into a new bag in ``folder``, as ``rosbags-convert`` does.

    Raises
    ------
    BagError
        If that fails.
    """
    target = folder / f"{bag.stem}_ros2"
    try:
        convert([bag], target, "mcap", 9, None, "file", None, _TYPES, (), (), (), ())
    except ConverterError as error:
        raise BagError(f"{bag} is a ROS 1 bag that rosbags cannot convert: {error}") from error
    return target


def prepared(bag: Path, run: Run, folder: Path, calibrations: Path) -> Path:
    """Return a bag with the names of this graph: the bag itself, if it has them, or a new one in ``folder``.

    Parameters
    ----------
    bag, run
        The bag, and how it is replayed.
    folder
        For the new bag.
    calibrations
        Folder to which the files of ``run.camera_info`` are relative.

    Raises
    ------
    BagError
        If a topic or a calibration is missing or unusable.
    """
    if not (run.left or run.right or run.camera_info):
        return bag
    names: dict[str, str] = {}
    for side, topic in zip(SIDES, (run.left, run.right)):
        if topic:
            names |= _names(topic, side)
    infos = dict(zip(SIDES, (_camera_info(calibrations / file) for file in run.camera_info)))
    with BagReader(bag) as reader:
        topics = {topic.name: topic for topic in reader.topics}
        for topic in (t for t in (run.left, run.right) if t and t not in topics):
            images = sorted(t.name for t in reader.topics if t.type in (IMAGE, COMPRESSED))
            raise BagError(f"{bag} has no {topic}; its images are {', '.join(images) or 'none'}")
        target = folder / f"{bag.stem}_renamed"
        with BagWriter(target, "mcap", types=reader.types) as writer:
            _copy(reader, writer, topics, names, infos)
    return target


def _names(topic: str, side: str) -> dict[str, str]:
    """Return the new names of a camera's topics: its images, and the camera_info next to them."""
    base = topic.removesuffix(SUFFIX)
    image = f"/stereo/{side}/image_raw"
    info = str(PurePosixPath(base).parent / "camera_info")
    return {base: image, base + SUFFIX: image + SUFFIX, info: f"/stereo/{side}/camera_info"}


def _copy(
    reader: BagReader,
    writer: BagWriter,
    topics: Mapping[str, BagTopic],
    names: Mapping[str, str],
    infos: Mapping[str, dict[str, Any]],
) -> None:
    adds = {f"/stereo/{side}/image_raw{end}": side for side in infos for end in ("", SUFFIX)}
    info_names = {side: f"/stereo/{side}/camera_info" for side in infos}
    taken = {name for name in topics if names.get(name, name) not in info_names.values()}
    there = {names.get(name, name) for name in topics}
    for name in sorted(taken):
        topic = topics[name]
        writer.add_topic(BagTopic(name=names.get(name, name), type=topic.type, qos=topic.qos))
    for image, side in adds.items():
        if image in there:
            source = next(t for t in topics.values() if names.get(t.name, t.name) == image)
            writer.add_topic(BagTopic(name=info_names[side], type=CAMERA_INFO, qos=source.qos))
    for name, time_ns, data in reader.messages(sorted(taken)):
        new = names.get(name, name)
        if new in adds:
            side = adds[new]
            header = reader.decode(data, topics[name].type).header
            writer.write(info_names[side], time_ns, _info_message(header, infos[side]))
        writer.write(new, time_ns, data)


def _camera_info(file: Path) -> dict[str, Any]:
    """Return the values of a camera_calibration file (image_pipeline's YAML form)."""
    try:
        document = yaml.load(file.read_text(encoding="utf-8"), ForeignLoader)
        return {
            "height": int(document["image_height"]),
            "width": int(document["image_width"]),
            "distortion_model": str(document["distortion_model"]),
            "d": np.array(document["distortion_coefficients"]["data"], np.float64),
            "k": np.array(document["camera_matrix"]["data"], np.float64).reshape(9),
            "r": np.array(document["rectification_matrix"]["data"], np.float64).reshape(9),
            "p": np.array(document["projection_matrix"]["data"], np.float64).reshape(12),
        }
    except OSError as error:
        raise BagError(f"{file}: {error.strerror}") from error
    except UNREADABLE as error:
        raise BagError(f"{file}:{mistake(error)}") from error
    except (KeyError, TypeError, ValueError) as error:
        raise BagError(f"{file} is no calibration of camera_calibration: {error!r}") from error


def _info_message(header: Any, values: Mapping[str, Any]) -> bytes:
    kinds = _TYPES.types
    region = kinds["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    message = kinds[CAMERA_INFO](header=header, binning_x=0, binning_y=0, roi=region, **values)
    return bytes(_TYPES.serialize_cdr(message, CAMERA_INFO))


def played_topics(bag: Path, inputs: Collection[str], outputs: Collection[str], exclude: Collection[str]) -> list[str]:
    """Return the topics of a bag that are played: those that the nodes read, and none that they publish.

    Raises
    ------
    BagError
        If there are none.
    """
    with BagReader(bag) as reader:
        names = [topic.name for topic in reader.topics]
    found = [
        name
        for name in dict.fromkeys(names)
        if name.removesuffix(SUFFIX) in inputs and name.removesuffix(SUFFIX) not in outputs and name not in exclude
    ]
    if not found:
        raise BagError(
            f"{bag} has none of the topics that the nodes read. The bag has {', '.join(sorted(names)) or 'none'}; the "
            f"nodes read {', '.join(sorted(inputs))}. Name the bag's images with --left and --right"
        )
    return found
