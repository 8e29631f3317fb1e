"""Build file of the package; see package.xml for what it is."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = "gantry_driver"
VERSION = ElementTree.parse(Path(__file__).resolve().with_name("package.xml")).findtext("version")
LIBRARIES = ["numpy", "opencv-python-headless", "pyserial", "PyYAML"]
COMMON = Path(__file__).resolve().parents[1] / "icu_common"
# In the project's folder pip installs all that is needed. A package on its own names nothing: rosdep has other names.
NEEDED = [f"icu_common[libraries] @ {COMMON.as_uri()}", *LIBRARIES] if COMMON.is_dir() else []

setup(
    name=NAME,
    version=VERSION,
    packages=find_packages(),
    package_data={NAME: ["py.typed", "**/*.xml", "**/*.html", "**/*.css", "**/*.js", "**/*.svg"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + NAME]),
        ("share/" + NAME, ["package.xml"]),
        ("share/" + NAME + "/launch", ["launch/gantry.launch.py"]),
        ("share/" + NAME + "/config", ["config/example.yaml"]),
    ],
    install_requires=["setuptools", *NEEDED],
    extras_require={"libraries": LIBRARIES},
    zip_safe=True,
    description="GRBL serial driver, gantry controller and mock serial port for an XY stage with a stylus",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "serial_driver = gantry_driver.nodes.serial_driver_node:main",
            "gantry_guard = gantry_driver.cli.gantry_guard:main",
            "gantry_controller = gantry_driver.nodes.controller_node:main",
            "sequencer = gantry_driver.nodes.sequence_node:main",
            "mock_grbl = gantry_driver.mock.main:main",
            "gantry_goal = gantry_driver.cli.gantry_goal:main",
            "gantry_sequence = gantry_driver.cli.gantry_sequence:main",
            "gantry_gcode = gantry_driver.cli.gantry_gcode:main",
            "gantry_monitor = gantry_driver.cli.gantry_monitor:main",
            "gantry_prepare = gantry_driver.cli.gantry_prepare:main",
            "gantry_accept = gantry_driver.cli.gantry_accept:main",
        ],
    },
)
