"""Serial driver and gantry controller, and in the profile bench the mock board: this package's part of the graph.

``ros2 launch gantry_driver gantry.launch.py profile:=hardware`` reads config/graph.yaml by icu_bringup,
which therefore must be built too; package.xml cannot name it, as icu_bringup depends on this package.
"""

from ament_index_python.packages import get_package_share_directory
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    graph = PythonLaunchDescriptionSource(get_package_share_directory("icu_bringup") + "/launch/graph.launch.py")
    return LaunchDescription([IncludeLaunchDescription(graph, launch_arguments=[("package", "gantry_driver")])])
