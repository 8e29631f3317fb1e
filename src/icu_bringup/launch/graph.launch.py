"""ros2 launch icu_bringup graph.launch.py profile:=bench -- the same graph as bring_up, from the same table."""

import atexit
import contextlib
from pathlib import Path
from tempfile import mkdtemp

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.substitutions import ExecutableInPackage

from icu_bringup.adapters.graph_ledger import is_used, new_ledger, path_of_graph
from icu_bringup.adapters.graph_names import hold_names
from icu_bringup.cli.bring_up import state_folder
from icu_bringup.core.startup.graph_description import check_namespace, load_graph, simulators
from icu_common.adapters.configuration_folder import true_configuration
from icu_common.adapters.steps.step_ledger import LEDGER_VARIABLE
from launch import LaunchContext, LaunchDescription


def steps_of(values: dict[str, str]) -> dict[str, str]:
    """Return the variables of a graph that runs by simulated time, none by the wall clock.

    A part follows the graph that it comes to.
    """
    ledger = path_of_graph(values["namespace"])
    config = Path(values["config"]).expanduser()
    if values["real_time"] == "true" or not simulators(config, values["profile"]):
        return {}
    if values["package"]:
        return {LEDGER_VARIABLE: str(ledger)} if is_used(ledger) else {}
    kept = contextlib.ExitStack()
    kept.enter_context(new_ledger(ledger, simulated=True))
    atexit.register(kept.close)
    return {LEDGER_VARIABLE: str(ledger)}


def start(context: LaunchContext) -> list:
    values = {
        name: LaunchConfiguration(name).perform(context)
        for name in ("profile", "config", "state", "namespace", "scope", "room", "package", "run", "real_time")
    }
    check_namespace(values["namespace"])
    given = Path(values["state"]).expanduser() if values["state"] else None
    state = state_folder(given, values["namespace"])
    run = Path(values["run"] or mkdtemp(prefix="icu_gantry_")).expanduser()
    run.mkdir(parents=True, exist_ok=True)
    if not values["package"]:  # a part may come to a graph
        hold_names(values["namespace"])
    environment = steps_of(values)
    programs = load_graph(
        Path(values["config"]).expanduser(),
        values["profile"],
        run=run,
        state=state,
        robot_namespace=values["namespace"],
        scope=values["scope"],
        room=values["room"],
        simulated_time=bool(environment),
    )
    actions = []
    for program in (p for p in programs if values["package"] in ("", p.package)):
        if program.is_node:
            actions.append(
                Node(
                    package=program.package,
                    executable=program.executable,
                    name=program.name,
                    namespace=program.namespace,
                    parameters=[*map(str, program.parameter_files), dict(program.parameters)],
                    remappings=list(program.remappings),
                    arguments=list(program.arguments),
                    additional_env=environment,
                    output="screen",
                )
            )
        else:
            executable = ExecutableInPackage(package=program.package, executable=program.executable)
            command = [executable, *program.arguments]
            actions.append(ExecuteProcess(cmd=command, name=program.name, additional_env=environment, output="screen"))
    return actions


def generate_launch_description() -> LaunchDescription:
    config = str(true_configuration(Path(get_package_share_directory("icu_bringup")) / "config"))
    return LaunchDescription(
        [
            DeclareLaunchArgument("profile", default_value="bench", description="profile of graph.yaml"),
            DeclareLaunchArgument("config", default_value=config, description="folder with graph.yaml"),
            DeclareLaunchArgument(
                "state",
                default_value="",
                description="folder of kept files; without: the user's, one for each namespace",
            ),
            DeclareLaunchArgument("namespace", default_value="", description="the robot's namespace"),
            DeclareLaunchArgument("scope", default_value="", description="model in config/scopes"),
            DeclareLaunchArgument("room", default_value="", description="room of the simulated bench in config/rooms"),
            DeclareLaunchArgument("package", default_value="", description="only this package's part of the graph"),
            DeclareLaunchArgument(
                "run", default_value="", description="folder for sockets, shared by several launches"
            ),
            DeclareLaunchArgument(
                "real_time", default_value="false", description="true: run a simulated machine by the wall clock"
            ),
            OpaqueFunction(function=start),
        ]
    )
