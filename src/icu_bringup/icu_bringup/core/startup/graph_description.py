"""The single description of the graph, ``config/graph.yaml``, as values for bring-up and the launch file."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import yaml

from icu_common.core.configuration.yaml_text import UNREADABLE, Loader, RepeatedKey, mistake

SIMULATED_TIME = "simulated_time"
"""Profile that is added if all hardware is simulated."""
_PROFILE_KEYS = {"about", "extends", "room", "set", "simulated_by"}
_KEYS = {"package", "executable", "namespace", "only", "ros", "ends_last", "when"}
_NAMESPACE = re.compile(r"/?[A-Za-z]\w*(/[A-Za-z]\w*)*/?", re.ASCII)
_TEXTS = ("package", "executable", "namespace", "waits_for", "extends", "scope", "room")
_LISTS, _MAPPINGS = ("parameters", "arguments", "only", "simulated_by"), ("set", "remap", "when")
_ADDABLE = {"parameters", "set", "remap", "arguments", "waits_for"}


class GraphDescriptionError(ValueError):
    """graph.yaml is wrong; the message names the program and the key."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Program:
    """One process of the graph.

    Parameters
    ----------
    name
        Node name, and the name in messages of bring-up.
    namespace
        Absolute ROS namespace.
    parameter_files
        Absolute paths; later files take precedence.
    parameters
        Single values, which take precedence over the files.
    remappings
        Pairs of relative topic name and absolute one.
    arguments
        Further command line arguments.
    is_node
        False for a program without ROS.
    ends_last
        True for simulated hardware, which must answer until the other programs have ended.
    waits_for
        Socket or port that bring-up waits for before it starts the program, so that a simulated device that is still
        warming up is not reported as missing. The program itself handles a missing device.
    """

    name: str
    package: str
    executable: str
    namespace: str
    parameter_files: tuple[Path, ...]
    parameters: Mapping[str, Any]
    remappings: tuple[tuple[str, str], ...]
    arguments: tuple[str, ...]
    is_node: bool
    ends_last: bool
    waits_for: Path | None

    def ros_arguments(self, values_file: Path) -> list[str]:
        """Return the command line after the executable; ``values_file`` contains the single values."""
        if not self.is_node:
            return list(self.arguments)
        result = [*self.arguments, "--ros-args", "-r", f"__node:={self.name}", "-r", f"__ns:={self.namespace}"]
        for source, target in self.remappings:
            result += ["-r", f"{source}:={target}"]
        for path in (*self.parameter_files, values_file):
            result += ["--params-file", str(path)]
        return result

    def value(self, name: str) -> Any:
        """Return a parameter as the node receives it, from the single values or the files; None if neither has it."""
        result = None
        for path in self.parameter_files:
            for section in (_read(path, yaml.load) or {}).values():
                result = ((section or {}).get("ros__parameters") or {}).get(name, result)
        return self.parameters.get(name, result)

    def values_document(self) -> str:
        """Return the single values as a ROS parameter file.

        It uses the node's full name, as rcl keeps one list for each name, in the order of their appearance. Values for
        all nodes (/**) would lose to values for this node in an earlier file.
        """
        node = str(PurePosixPath(self.namespace) / self.name)
        return yaml.safe_dump({node: {"ros__parameters": dict(self.parameters)}}, sort_keys=True)


def check_namespace(namespace: str) -> None:
    """Raise :class:`GraphDescriptionError` unless the text is empty or a ROS namespace; it also names a folder."""
    if namespace and not _NAMESPACE.fullmatch(namespace):
        raise GraphDescriptionError(
            f"namespace {namespace}; expected names of letters, digits and _, each with a letter first, "
            "with / between them"
        )


def simulators(config: Path, profile: str) -> list[str]:
    """Return the programs that simulate all hardware of a profile, with which it can run by simulated time.

    Raises
    ------
    GraphDescriptionError
        As of :func:`load_graph`.
    """
    document = _read(config / "graph.yaml", yaml.load)
    _check_form(document)
    chain = _chain(document["profiles"], profile)
    named = [document["profiles"][p]["simulated_by"] for p in chain if "simulated_by" in document["profiles"][p]]
    return list(named[-1]) if named else []


def load_graph(
    config: Path,
    profile: str,
    *,
    run: Path,
    state: Path,
    robot_namespace: str = "",
    scope: str = "",
    room: str = "",
    simulated_time: bool = False,
) -> list[Program]:
    """Return the programs of ``graph.yaml`` in the folder ``config`` for one profile, in the file's order.

    Parameters
    ----------
    config, run, state
        Folders that replace $(config), $(run) and $(state).
    profile
        One of the file's profiles.
    robot_namespace
        Prefix of every name, for several robots in one ROS domain.
    scope
        Model of the designated instrument; empty for the file's default.
    room
        Room of a simulated bench in config/rooms; empty for the profile's, or the file's, default.
    simulated_time
        Whether the graph follows ``/clock``, which the bench publishes.

    Raises
    ------
    GraphDescriptionError
        For invalid YAML, unknown and repeated keys, unknown profiles and scopes, and parameter files that do not
        exist or have values for a node that does not read them.
    """
    document = _read(config / "graph.yaml", yaml.load)
    _check_form(document)
    profiles = list(document["profiles"])
    chain = [*_chain(document["profiles"], profile), *([SIMULATED_TIME] if simulated_time else [])]
    scope = scope or document["scope"]
    models = sorted(p.stem for p in (config / "scopes").glob("*.yaml"))
    if scope not in models:
        raise GraphDescriptionError(
            f"scope {scope!r} is none of the models in {config / 'scopes'}: {', '.join(models)}"
        )
    layout = config / "scopes" / f"{scope}.yaml"
    words = {"$(config)": str(config), "$(run)": str(run), "$(state)": str(state), "$(scope)": str(layout)}
    room_file = _room_file(config, document, profile, room)
    root = PurePosixPath("/") / robot_namespace.strip("/")
    # These topics are absolute by convention; two robots in one domain would mix them.
    shared_names = ("diagnostics", "clock") if simulated_time else ("diagnostics",)
    absolute = tuple((f"/{name}", str(root / name)) for name in shared_names if str(root) != "/")
    programs = []
    for name, entry in document["programs"].items():
        _check_keys(name, entry, profiles)
        if not set(chain) & set(entry.get("only", profiles)):
            continue
        parts = [entry, *(entry["when"][p] for p in chain if p in entry.get("when", {}))]
        named = [f for part in parts for f in part.get("parameters", ())]
        files = [config / f.replace("$(room)", room_file) for f in named]
        for path in files:
            if not path.is_file():
                raise GraphDescriptionError(f"{name}: parameter file {path} does not exist")
        remap = {source: target for part in parts for source, target in part.get("remap", {}).items()}
        shared = [document["profiles"][p] for p in chain] if entry.get("ros", True) else []
        values = {key: value for part in (*shared, *parts) for key, value in part.get("set", {}).items()}
        waits = [part["waits_for"] for part in parts if "waits_for" in part]
        programs.append(
            Program(
                name=name,
                package=entry["package"],
                executable=entry["executable"],
                namespace=str(root / entry.get("namespace", "")),
                parameter_files=tuple(files),
                parameters=_fill(values, words),
                remappings=tuple((source, str(root / target)) for source, target in remap.items()) + absolute,
                arguments=tuple(_fill([a for part in parts for a in part.get("arguments", ())], words)),
                is_node=entry.get("ros", True),
                ends_last=entry.get("ends_last", False),
                waits_for=Path(_fill(waits[-1], words)) if waits else None,
            )
        )
    _refuse_unread_values(programs)
    return programs


def _room_file(config: Path, document: Any, profile: str, room: str) -> str:
    """Return the file of the room below ``config``, as the parameter lists name it by ``$(room)``."""
    chain = _chain(document["profiles"], profile)
    of_profile = [document["profiles"][p]["room"] for p in chain if "room" in document["profiles"][p]]
    chosen = room or [document.get("room", ""), *of_profile][-1]
    rooms = sorted(p.stem for p in (config / "rooms").glob("*.yaml"))
    if chosen and chosen not in rooms:
        raise GraphDescriptionError(f"room {chosen!r} is none of the rooms in {config / 'rooms'}: {', '.join(rooms)}")
    if room and not any("simulated_by" in document["profiles"][p] for p in chain):
        raise GraphDescriptionError(
            f"room {room!r}: profile {profile} has no simulated bench that could stand in a room"
        )
    return f"rooms/{chosen}.yaml"


def _read(path: Path, parse: Callable[..., Any]) -> Any:
    try:
        return parse(path.read_text(encoding="utf-8"), Loader)
    except RepeatedKey as error:
        # Other loaders, including rcl's, silently keep the last of equal keys.
        line, name = error.key.start_mark.line + 1, error.key.value
        raise GraphDescriptionError(f"{path.name}:{line}: {name!r} stands here a second time") from error
    except UNREADABLE as error:
        raise GraphDescriptionError(f"{path.name}:{mistake(error)}") from error
    except UnicodeDecodeError as error:
        raise GraphDescriptionError(f"{path.name}: {error}") from error


def _refuse_unread_values(programs: Sequence[Program]) -> None:
    """Reject values in parameter files under a name that no node has: every node would ignore them."""
    for path in dict.fromkeys(path for program in programs for path in program.parameter_files):
        readers = [str(PurePosixPath(p.namespace) / p.name) for p in programs if path in p.parameter_files]
        root = _read(path, yaml.compose)
        if root is not None and not isinstance(root, yaml.MappingNode):
            raise GraphDescriptionError(f"{path.name}:1; expected a mapping of nodes to their ros__parameters")
        for key, _ in root.value if root is not None else ():
            at = f"{path.name}:{key.start_mark.line + 1}"
            if not isinstance(key, yaml.ScalarNode):
                raise GraphDescriptionError(f"{at}: a node's name is needed, not a list or mapping")
            if not any(_pattern(key.value).fullmatch(reader) for reader in readers):
                raise GraphDescriptionError(
                    f"{at}: {key.value} is none of the nodes that read this file: {', '.join(readers)}"
                )


def _pattern(node: str) -> re.Pattern[str]:
    """Return the pattern of a node's name in a parameter file, as in rcl: * is one name, ** any number of names."""
    forms = {"*": r"/\w+", "**": r"(/\w+)*"}
    return re.compile("".join(forms.get(part, "/" + re.escape(part)) for part in node.removeprefix("/").split("/")))


def _chain(profiles: Mapping[str, Any], profile: str, above: tuple[str, ...] = ()) -> list[str]:
    """Return the profile and those that it extends, the most general first."""
    if profile not in profiles:
        raise GraphDescriptionError(f"profile {profile!r} is none of {', '.join(profiles)}")
    if profile in above:
        raise GraphDescriptionError(f"profile {profile} extends itself")
    base = profiles[profile].get("extends")
    return [*(_chain(profiles, base, (*above, profile)) if base else []), profile]


def _check_form(document: Any) -> None:
    for key in ("scope", "profiles", "programs"):
        if not isinstance(document, dict) or key not in document:
            raise GraphDescriptionError(f"graph.yaml: {key} is missing")
    _check_kinds("graph.yaml", {key: document[key] for key in ("scope", "room") if key in document})
    for group in ("profiles", "programs"):
        if not isinstance(document[group], dict):
            raise GraphDescriptionError(f"graph.yaml: {group} = {document[group]!r}; expected a mapping")
        for name, entry in document[group].items():
            if not isinstance(entry, dict):
                raise GraphDescriptionError(f"graph.yaml: {group}: {name}; expected a mapping")
    for name, entry in document["profiles"].items():
        if unknown := set(entry) - _PROFILE_KEYS:
            known = ", ".join(sorted(_PROFILE_KEYS))
            raise GraphDescriptionError(f"profile {name}: unknown key {', '.join(sorted(unknown))}; known: {known}")
        _check_kinds(f"profile {name}", entry)


def _check_kinds(place: str, entry: Mapping[str, Any]) -> None:
    for key in (key for key in _TEXTS if key in entry):
        if not isinstance(entry[key], str):
            raise GraphDescriptionError(f"{place}: {key} = {entry[key]!r}; expected a text")
    for key in (key for key in _LISTS if key in entry):
        if not isinstance(entry[key], list) or not all(isinstance(text, str) for text in entry[key]):
            raise GraphDescriptionError(f"{place}: {key} = {entry[key]!r}; expected a list of texts")
    for key in (key for key in _MAPPINGS if key in entry):
        if not isinstance(entry[key], dict):
            raise GraphDescriptionError(f"{place}: {key} = {entry[key]!r}; expected a mapping")


def _check_keys(name: str, entry: Mapping[str, Any], profiles: list[str]) -> None:
    for key in ("package", "executable"):
        if key not in entry:
            raise GraphDescriptionError(f"{name}: {key} is missing")
    unknown = set(entry) - _KEYS - _ADDABLE
    if unknown:
        raise GraphDescriptionError(
            f"{name}: unknown key {', '.join(sorted(unknown))}; known: {', '.join(sorted(_KEYS | _ADDABLE))}"
        )
    _check_kinds(name, entry)
    for profile in entry.get("only", ()):
        if profile not in profiles:
            raise GraphDescriptionError(f"{name}: only {profile!r}: the profiles are {', '.join(profiles)}")
    for profile, addition in entry.get("when", {}).items():
        if profile not in profiles:
            raise GraphDescriptionError(f"{name}: when {profile!r}: the profiles are {', '.join(profiles)}")
        if not isinstance(addition, dict):
            raise GraphDescriptionError(f"{name}: when {profile} = {addition!r}; expected a mapping")
        _check_kinds(f"{name}: when {profile}", addition)
        if set(addition) - _ADDABLE:
            raise GraphDescriptionError(f"{name}: when {profile}: only {', '.join(sorted(_ADDABLE))} can be added")


def _fill(value: Any, words: Mapping[str, str]) -> Any:
    if isinstance(value, str):
        for word, text in words.items():
            value = value.replace(word, text)
        return value
    if isinstance(value, list):
        return [_fill(item, words) for item in value]
    if isinstance(value, Mapping):
        return {key: _fill(item, words) for key, item in value.items()}
    return value
