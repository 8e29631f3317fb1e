"""The table of the graph: what a profile gets, and errors that name the program and the key."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from icu_bringup.core.startup.graph_description import GraphDescriptionError, load_graph

TABLE = """\
scope: dial
profiles:
  bench: {about: simulated}
  test: {about: with truth, extends: bench}
  hardware: {about: real}
  replay: {about: recorded, set: {use_sim_time: true, a: 7}}
programs:
  board:
    {package: p, executable: board, ros: false, only: [bench], arguments: [--link, $(run)/b],
     when: {test: {arguments: [--log, $(state)/l]}}}
  eye:
    package: p
    executable: eye
    namespace: stereo
    parameters: [params/eye.yaml]
    set: {a: 1, part.gain: 2.5, path: $(config)/x, layout: $(scope)}
    remap: {image: stereo/left/image, local: /abs}
    when:
      bench: {set: {a: 2}}
      hardware: {set: {a: 3}}
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    (tmp_path / "params").mkdir()
    (tmp_path / "params" / "eye.yaml").write_text("{}")
    (tmp_path / "scopes").mkdir()
    (tmp_path / "scopes" / "dial.yaml").write_text("{}")
    (tmp_path / "graph.yaml").write_text(TABLE)
    return tmp_path


def load(config: Path, profile: str, namespace: str = "") -> dict:
    programs = load_graph(config, profile, run=Path("/r"), state=Path("/s"), robot_namespace=namespace)
    return {p.name: p for p in programs}


def test_profiles_extend_each_other(config: Path) -> None:
    assert load(config, "bench")["board"].arguments == ("--link", "/r/b")
    assert load(config, "test")["board"].arguments == ("--link", "/r/b", "--log", "/s/l")
    assert "board" not in load(config, "hardware")
    assert [load(config, p)["eye"].parameters["a"] for p in ("bench", "test", "hardware")] == [2, 2, 3]


def test_a_profile_sets_values_of_all_nodes_that_their_own_override(config: Path) -> None:
    eye = load(config, "replay")["eye"]
    assert (eye.parameters["use_sim_time"], eye.parameters["a"]) == (True, 1)


def test_command_line_of_a_node(config: Path) -> None:
    eye = load(config, "bench", "bed_1")["eye"]
    assert eye.namespace == "/bed_1/stereo"
    assert eye.ros_arguments(Path("/v.yaml")) == [
        *("--ros-args", "-r", "__node:=eye", "-r", "__ns:=/bed_1/stereo"),
        *("-r", "image:=/bed_1/stereo/left/image", "-r", "local:=/abs", "-r", "/diagnostics:=/bed_1/diagnostics"),
        *("--params-file", f"{config}/params/eye.yaml", "--params-file", "/v.yaml"),
    ]
    values = yaml.safe_load(eye.values_document())["/bed_1/stereo/eye"]["ros__parameters"]
    assert values == {"a": 2, "part.gain": 2.5, "path": f"{config}/x", "layout": f"{config}/scopes/dial.yaml"}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("executable: eye", "exe: eye", "eye: executable is missing"),
        ("remap:", "remaps:", "eye: unknown key remaps"),
        ("hardware: {set: {a: 3}}", "hardwear: {set: {a: 3}}", "eye: when 'hardwear'"),
        ("hardware: {set: {a: 3}}", "hardware: {package: q}", "eye: when hardware: only"),
        (
            "    when:\n      bench:",
            "    set: {b: 1}\n    when:\n      bench:",
            r"graph\.yaml:18: 'set' stands here a second time",
        ),
        ("params/eye.yaml", "params/ear.yaml", r"eye: parameter file .*ear\.yaml does not exist"),
        ("only: [bench], arguments", "only: [bnech], arguments", "board: only 'bnech': the profiles are bench, test"),
        ("extends: bench", "extend: bench", "profile test: unknown key extend; known: about, extends, room, set"),
        ("scope: dial", "scope: [dial", r"graph.yaml:2: expected ',' or '\]'"),
        ("profiles:", "profile:", "graph.yaml: profiles is missing"),
        ("  board:\n", "  board: none\n  other:\n", "graph.yaml: programs: board; expected a mapping"),
        ("programs:\n", "programs: []\nothers:\n", "graph.yaml: programs = \\[\\]; expected a mapping"),
        ("scope: dial", "scope: 7", "graph.yaml: scope = 7; expected a text"),
        ("executable: eye", "executable: 5", "eye: executable = 5; expected a text"),
        ("    namespace: stereo", "    namespace: [stereo]", r"eye: namespace = \['stereo'\]; expected a text"),
        ("hardware: {set: {a: 3}}", "hardware: {waits_for: 3}", "eye: when hardware: waits_for = 3; expected a text"),
        ("extends: bench", "extends: [bench]", r"profile test: extends = \['bench'\]; expected a text"),
        ("[--link, $(run)/b]", "--link", "board: arguments = '--link'; expected a list of texts"),
        ("[--link, $(run)/b]", "[--baud, 9600]", r"board: arguments = \['--baud', 9600\]; expected a list of texts"),
        ("only: [bench], arguments", "only: bench, arguments", "board: only = 'bench'; expected a list of texts"),
        (
            "parameters: [params/eye.yaml]",
            "parameters: params/eye.yaml",
            "eye: parameters = 'params/eye.yaml'; expected a list",
        ),
        ("{image: stereo/left/image, local: /abs}", "image", "eye: remap = 'image'; expected a mapping"),
        ("hardware: {set: {a: 3}}", "hardware: {set: }", "eye: when hardware: set = None; expected a mapping"),
        ("hardware: {set: {a: 3}}", "hardware:", "eye: when hardware = None; expected a mapping"),
        ("{about: simulated}", "{about: simulated, extends: test}", "profile bench extends itself"),
        (
            "recorded, set: {use_sim_time: true, a: 7}",
            "recorded, set: a",
            "profile replay: set = 'a'; expected a mapping",
        ),
    ],
)
def test_errors(config: Path, old: str, new: str, message: str) -> None:
    assert old in TABLE
    (config / "graph.yaml").write_text(TABLE.replace(old, new))
    with pytest.raises(GraphDescriptionError, match=message):
        load(config, "bench")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "/**/eye:\n  ros__parameters: {part: {gain: 1.0,\n    gain: 2.0}}",
            r"eye\.yaml:3: 'gain' stands here a second time",
        ),
        (
            "/**/eye: {ros__parameters: {a: 1}}\n/**/eey: {ros__parameters: {b: 1}}",
            r"eye\.yaml:2: /\*\*/eey is none of the nodes that read this file: /stereo/eye",
        ),
        ("/other/eye: {ros__parameters: {a: 1}}", r"eye\.yaml:1: /other/eye is none of"),
        ("eye: {ros__parameters: {a: 1}}", r"eye\.yaml:1: eye is none of"),
        ("/**:\n  ros__parameters:\n\ta: 1", r"eye\.yaml:3: found character '\\t' that cannot start any token"),
        ("# für das Gerät", r"eye\.yaml: 'utf-8' codec can't decode"),
        ("[a]", r"eye\.yaml:1; expected a mapping of nodes to their ros__parameters"),
        ("/**/eye: {}\n[/**/eye]: {ros__parameters: {a: 1}}", r"eye\.yaml:2: a node's name is needed, not a list or"),
    ],
)
def test_a_parameter_file_that_is_wrong_or_would_be_ignored_in_part_is_refused(
    config: Path, text: str, message: str
) -> None:
    (config / "params" / "eye.yaml").write_text(text, encoding="latin-1")
    with pytest.raises(GraphDescriptionError, match=message):
        load(config, "bench")


@pytest.mark.parametrize("node", ["/**", "/**/eye", "/stereo/eye", "stereo/eye", "/stereo/*", '"/*/eye"'])
def test_every_way_to_name_a_node_in_a_parameter_file_is_known(config: Path, node: str) -> None:
    (config / "params" / "eye.yaml").write_text(f"{node}: {{ros__parameters: {{a: 1}}}}")
    assert load(config, "bench")["eye"].parameter_files == (config / "params" / "eye.yaml",)


def test_unknown_scope_and_profile(config: Path) -> None:
    for scope in ("gauge", "../graph", "dial/", f"{config}/scopes/dial"):
        with pytest.raises(
            GraphDescriptionError, match=f"scope '{scope}' is none of the models in {config}/scopes: dial"
        ):
            load_graph(config, "bench", run=Path("/r"), state=Path("/s"), scope=scope)
    with pytest.raises(GraphDescriptionError, match="'moon' is none of bench, test, hardware, replay"):
        load(config, "moon")
