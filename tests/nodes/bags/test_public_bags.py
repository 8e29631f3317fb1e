"""Public bags, and bags of the same structure, are read and played whole, or what is missing is named."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from nodes.bag_programs import Start
from nodes.bags.public_bags import BAGS, NOT_INSTALLED, VARIABLE, PublicBag, convert, found
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from support.ros_rig import Ros

from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.core.bag.account import INCOMPLETE
from icu_bringup.nodes.bag_qos import message_class

pytestmark = pytest.mark.long

LISTENED = 10_000
"""Messages of a bag that a listener in Python keeps up with."""
ANY = QoSProfile(depth=30_000, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.VOLATILE)


def public(one: PublicBag, folder: Path) -> Path:
    path = found(one)
    if path is None:
        pytest.skip(
            f"{one.path} is not in the folder of {VARIABLE}: "
            "PYTHONPATH=tests python -m nodes.bags.public_bags FOLDER --fetch"
        )
    return convert(path, folder) if one.is_ros1 else path


def plays(ros: Ros, command: Start, one: PublicBag, path: Path) -> None:
    with BagReader(path) as bag:
        assert {f"/{t.name.lstrip('/')}": (t.type, t.count) for t in bag.topics} == dict(one.topics)
        assert bag.check() == one.count
        names = {f"/{t.name.lstrip('/')}": t.name for t in bag.topics}
    listener = ros.plain("listener")
    heard: dict[str, list[Any]] = {}
    for topic, (kind, count) in one.topics.items():
        if topic not in one.missing and count and one.count < LISTENED:
            heard[topic] = ros.collect(listener, message_class(kind), topic, ANY)
    program = command("bag_play", str(path), "--rate", "20" if one.count < LISTENED else "1000")
    ros.spin_until(lambda: program.process.poll() is not None, 200.0)
    output = program.end(code=INCOMPLETE if one.missing else 0)
    assert output.endswith(f"{one.played} messages played\n"), output
    for topic, reason in one.missing.items():
        count = one.topics[topic][1]
        (line,) = (row for row in output.splitlines() if row.startswith(f"missing: {names[topic]}: "))
        assert f"{count} of {count} messages: not played: " in line and reason in line
    lost = {topic: len(messages) for topic, messages in heard.items()}
    ros.spin_until(lambda: not heard or sum(map(len, heard.values())) == one.played, 40.0, lambda: lost)


REPRODUCED = [one for one in BAGS if one.write is not None]


@pytest.mark.parametrize("one", REPRODUCED, ids=lambda one: one.name)
def test_a_bag_of_the_same_structure_is_played_whole(ros: Ros, tmp_path: Path, command: Start, one: PublicBag) -> None:
    write: Callable[[Path], Path] | None = one.write
    assert write is not None
    plays(ros, command, one, write(tmp_path / "bag"))


@pytest.mark.parametrize("one", BAGS, ids=lambda one: one.name)
def test_a_public_bag_is_played_whole(ros: Ros, tmp_path: Path, command: Start, one: PublicBag) -> None:
    if NOT_INSTALLED in one.missing.values():
        for topic, (kind, _) in one.topics.items():
            if topic in one.missing:
                with pytest.raises(ImportError):
                    message_class(kind)
    plays(ros, command, one, public(one, tmp_path))
