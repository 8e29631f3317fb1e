"""Build file of the package; see package.xml for what it is."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = "scope_ui_bridge"
VERSION = ElementTree.parse(Path(__file__).resolve().with_name("package.xml")).findtext("version")

setup(
    name=NAME,
    version=VERSION,
    packages=find_packages(),
    package_data={
        NAME: ["py.typed", "**/*.xml", "**/*.html", "**/*.css", "**/*.js", "**/*.svg", "**/*.ftl", "**/LICENSE"]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + NAME]),
        ("share/" + NAME, ["package.xml"]),
        ("share/" + NAME + "/launch", ["launch/page.launch.py"]),
    ],
    install_requires=["setuptools"],
    extras_require={"libraries": ["numpy", "opencv-python-headless", "aiohttp"]},  # for pip
    zip_safe=True,
    description="Operator page: live picture, clicks, stop; served by aiohttp from a bridge to the graph",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "ui_bridge = scope_ui_bridge.nodes.bridge_node:main",
            "page_admin = scope_ui_bridge.cli.page_admin:main",
            "foxglove_sidecar = scope_ui_bridge.nodes.foxglove_sidecar:main",
        ],
    },
)
