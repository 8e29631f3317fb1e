"""ROS parameters come from the configuration dataclass, and bad values leave the old ones in force."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter

from icu_common.core.configuration.config import Config, ConfigError, nested, setting
from icu_common.nodes.parameters import LiveParameters
from icu_common.nodes.runtime import own_arguments, ros_session


@dataclass(frozen=True, slots=True, kw_only=True)
class Inner(Config):
    gain: float = setting(1.0, "gain", minimum=0.0, maximum=2.0, unit="V")


@dataclass(frozen=True, slots=True, kw_only=True)
class Outer(Config):
    rate: int = setting(10, "rate", minimum=1, maximum=60)
    mode: str = setting("fast", "mode", choices=("fast", "slow"))
    port: str = setting("p", "port", read_only=True)
    corner_m: tuple[float, ...] = setting((0.0, 1.0), "corner")
    inner: Inner = nested(Inner)


class Probe(Node):
    def __init__(self, **kwargs: Any) -> None:
        super().__init__("probe", **kwargs)
        self.changes: list[Outer] = []
        self.live = LiveParameters(self, Outer, self.changes.append, self.examine)

    def examine(self, config: Outer) -> None:
        if config.rate == 13:
            raise ConfigError("rate = 13 brings bad luck")


def test_defaults_overrides_and_descriptors(ros: Any) -> None:
    node = ros.node(Probe, {"rate": 20, "inner.gain": 1.5, "corner_m": [0.5, 2.0]})
    config = node.live.config
    assert (config.rate, config.inner.gain, config.corner_m) == (20, 1.5, (0.5, 2.0))
    descriptor = node.describe_parameter("inner.gain")
    assert "[V]" in descriptor.description and descriptor.floating_point_range[0].to_value == 2.0
    assert node.describe_parameter("port").read_only


def test_good_change_is_applied_and_reported(ros: Any) -> None:
    node = ros.node(Probe)
    assert node.set_parameters([Parameter("inner.gain", value=0.25)])[0].successful
    assert node.live.config.inner.gain == 0.25
    assert [c.inner.gain for c in node.changes] == [0.25]


@pytest.mark.parametrize(
    ("name", "value", "word"),
    [
        ("rate", 61, "rate"),
        ("rate", 13, "brings bad luck"),
        ("inner.gain", float("nan"), "gain"),
        ("mode", "warp", "fast, slow"),
        ("port", "q", "read-only"),
    ],
)
def test_bad_change_is_refused_with_its_reason(ros: Any, name: str, value: Any, word: str) -> None:
    node = ros.node(Probe)
    before = node.live.config
    result = node.set_parameters([Parameter(name, value=value)])[0]
    assert not result.successful and word in result.reason
    assert node.live.config == before and node.changes == []


def test_unknown_key_is_an_error_and_not_ignored(ros: Any) -> None:
    with pytest.raises(ConfigError, match="no parameter raet; it has"):
        ros.node(Probe, {"raet": 5})


def test_value_outside_its_range_at_start_is_an_error(ros: Any) -> None:
    with pytest.raises(Exception, match="rate"):
        ros.node(Probe, {"rate": 0})


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--ros-args", "--bogus"], r"unknown ROS arguments: \['--bogus'\]"),
        (["--ros-args", "-p", "x"], "-p x"),
        (["--ros-args", "-p", "name:=\udce9"], r"'name:=\\udce9' is no UTF-8"),
        (["--ros-args", "--params-file", "nowhere.yaml"], "nowhere.yaml"),
        (["--ros-args", "-r", "__ns:=9bad"], "__ns:=9bad"),
    ],
)
def test_wrong_ros_arguments_end_with_one_line(
    arguments: list[str], words: str, capfd: pytest.CaptureFixture[str]
) -> None:
    """Of a node, of a program that has arguments of its own, and of a session."""
    with pytest.raises(ConfigError, match=words), ros_session(arguments):
        pass
    capfd.readouterr()
    with pytest.raises(SystemExit) as ended:
        own_arguments(["program", "own", *arguments])
    assert ended.value.code == 2
    said = [line for line in capfd.readouterr().err.splitlines() if "[rcl]" not in line]
    assert len(said) == 1 and said[0].startswith("error: ") and re.search(words, said[0])


def test_own_arguments_are_those_that_ros_does_not_take() -> None:
    assert own_arguments(["program", "1", "--ros-args", "-r", "a:=b", "--", "--two"]) == ["1", "--two"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Guarded(Config):
    silence_s: float = setting(0.6, "silence", minimum=0.1, maximum=2.0, unit="s", guards="nobody stops it")
    lamp: bool = setting(True, "lamp")


def test_safety_settings_change_only_at_rest(ros: Any) -> None:
    node = ros.plain()
    unrest = ["it moves"]
    live = LiveParameters(node, Guarded, unrest=lambda: unrest[0])
    both = [Parameter("lamp", value=False), Parameter("silence_s", value=2.0)]
    refused = node.set_parameters_atomically(both)
    assert not refused.successful
    assert refused.reason == "silence_s can change only while the machine is at rest: it moves"
    assert live.config == Guarded()
    assert node.set_parameters([Parameter("silence_s", value=0.6)])[0].successful, "no change"
    assert node.set_parameters([Parameter("lamp", value=False)])[0].successful
    unrest[0] = ""
    assert node.set_parameters([Parameter("silence_s", value=2.0)])[0].successful
    assert live.config == Guarded(silence_s=2.0, lamp=False)


def test_safety_settings_need_to_know_whether_the_machine_is_at_rest(ros: Any) -> None:
    with pytest.raises(TypeError, match="Guarded has safety settings: unrest is required"):
        LiveParameters(ros.plain(), Guarded)
