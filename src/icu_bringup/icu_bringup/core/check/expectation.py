"""An expectation: the required results of a replay, and how it is run; read from and written as YAML.

The expected messages are in a bag next to the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import yaml

from icu_bringup.core.check.tolerances import Tolerance, tolerance_of
from icu_common.core.configuration.yaml_text import UNREADABLE, ForeignLoader, mistake

VERSION = 1
_HEAD = """# Expectation of bag_check: run `bag_check BAG --expect THIS_FILE`; `--make` writes it again.
# Limits: absolute (the field's unit) and relative; angle_deg; mean of the differences of pixels; distance between
# nearest points and count (relative) of a cloud. A field without limits must be the same; `ignore: true` leaves it out.
"""


class _Loader(ForeignLoader):
    max_bytes, max_depth, max_nodes = 4 << 20, 12, 100_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """How the bag is replayed.

    Attributes
    ----------
    nodes
        Programs of the profile ``replay`` that run; none: all.
    settings
        ``PROGRAM.PARAMETER=VALUE`` for them.
    scope
        Model of the instrument, "" for the default.
    moving
        Play the recorded goals and commands to the controller.
    exclude
        Topics of the bag that are not played.
    left, right
        Topics of the bag that are played as images of the left and the right camera, "" for /stereo/left/image_raw and
        /stereo/right/image_raw.
    camera_info
        Files of camera_calibration (left, right), relative to the expectation, whose camera_info is played with each
        image.
    duration_s
        Length of the part that is played, from the start; 0 for all.
    """

    nodes: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()
    scope: str = ""
    moving: bool = False
    exclude: tuple[str, ...] = ()
    left: str = ""
    right: str = ""
    camera_info: tuple[str, ...] = ()
    duration_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicExpectation:
    """What is expected on one topic.

    Attributes
    ----------
    type
        Message type.
    messages
        Number of messages.
    missing
        Allowed difference of this number.
    every
        Interval of the messages that are kept and compared: 12 means each twelfth message.
    fields
        Tolerances by path.
    """

    type: str
    messages: int
    missing: int = 0
    every: int = 1
    fields: Mapping[str, Tolerance] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Expectation:
    """An expectation without its messages.

    Attributes
    ----------
    bag
        Name of the bag it was made from.
    messages
        Name of the bag with the expected messages, in the same folder.
    run, topics
        How it is replayed, and what must be published.
    """

    bag: str
    messages: str
    run: Run = field(default_factory=Run)
    topics: Mapping[str, TopicExpectation] = field(default_factory=dict)


def to_yaml(expectation: Expectation) -> str:
    """Return the text of the file."""
    run = {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(expectation.run).items() if v != _DEFAULTS[k]}
    document = {
        "version": VERSION,
        "bag": expectation.bag,
        "messages": expectation.messages,
        "run": run,
        "topics": {
            name: {
                "type": topic.type,
                "messages": topic.messages,
                **({"missing": topic.missing} if topic.missing else {}),
                **({"every": topic.every} if topic.every != 1 else {}),
                "fields": {path: _tolerance(tolerance) for path, tolerance in topic.fields.items()},
            }
            for name, topic in sorted(expectation.topics.items())
        },
    }
    return _HEAD + yaml.safe_dump(document, sort_keys=False, width=140, allow_unicode=True)


def _tolerance(tolerance: Tolerance) -> dict[str, Any]:
    return {
        **tolerance.limits,
        **({"ignore": True} if tolerance.ignored else {}),
        **({"why": tolerance.why} if tolerance.why else {}),
    }


_DEFAULTS = asdict(Run())


def from_yaml(text: str) -> Expectation:
    """Return an expectation from the text of its file.

    Raises
    ------
    ValueError
        With position and reason, if the text does not have the form that :func:`to_yaml` writes.
    """
    try:
        document = yaml.load(text, _Loader)
    except UNREADABLE as error:
        raise ValueError(f"line {mistake(error)}") from error
    if not isinstance(document, dict) or document.get("version") != VERSION:
        raise ValueError(f"no expectation of version {VERSION}")
    known = {"version", "bag", "messages", "run", "topics"}
    _only(document, known, "the file")
    topics = _mapping(document.get("topics"), "topics")
    return Expectation(
        bag=str(document.get("bag", "")),
        messages=_text(document.get("messages"), "messages"),
        run=_run(_mapping(document.get("run"), "run")),
        topics={str(name): _topic(str(name), _mapping(value, str(name))) for name, value in topics.items()},
    )


def _run(document: Mapping[str, Any]) -> Run:
    names = {item.name for item in fields(Run)}
    _only(document, names, "run")
    given: dict[str, Any] = {}
    for name, value in document.items():
        default = _DEFAULTS[name]
        if isinstance(default, tuple):
            if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
                raise ValueError(f"run.{name}: a list of texts is expected, got {value!r}")
            given[name] = tuple(value)
        elif isinstance(default, float) and isinstance(value, int | float) and not isinstance(value, bool):
            given[name] = float(value)
        elif type(value) is type(default):
            given[name] = value
        else:
            raise ValueError(f"run.{name}: {type(default).__name__} is expected, got {value!r}")
    return Run(**given)


def _topic(name: str, document: Mapping[str, Any]) -> TopicExpectation:
    _only(document, {item.name for item in fields(TopicExpectation)}, name)
    found: dict[str, Tolerance] = {}
    for path, value in _mapping(document.get("fields"), f"{name}: fields").items():
        try:
            found[str(path)] = tolerance_of(_mapping(value, str(path)))
        except ValueError as error:
            raise ValueError(f"{name}: {path}: {error}") from error
    counts = {key: _count(document.get(key, default), f"{name}: {key}") for key, default in _COUNTS.items()}
    if not counts["every"]:
        raise ValueError(f"{name}: every: 0 is below 1")
    return TopicExpectation(type=_text(document.get("type"), f"{name}: type"), fields=found, **counts)


_COUNTS = {"messages": 0, "missing": 0, "every": 1}


def _only(document: Mapping[str, Any], known: set[str], where: str) -> None:
    if unknown := {str(key) for key in document} - known:
        raise ValueError(f"{where}: unknown {', '.join(sorted(unknown))}; known: {', '.join(sorted(known))}")


def _mapping(value: Any, where: str) -> Mapping[str, Any]:
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise ValueError(f"{where}: a mapping is expected, got {value!r}")
    return value


def _text(value: Any, where: str) -> str:
    if not isinstance(value, str) or not value:
        raise ValueError(f"{where}: a text is expected, got {value!r}")
    return value


def _count(value: Any, where: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"{where}: a number of at least 0 is expected, got {value!r}")
    return value
