"""Build file of the package; see package.xml for what it is."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = "icu_common"
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
    ],
    install_requires=["setuptools"],
    extras_require={"libraries": ["numpy", "opencv-python-headless", "PyYAML", "psutil"]},  # for pip
    zip_safe=True,
    description="Frames, cameras, parameters, QoS, messages and results shared by the gantry robot",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [],
    },
)
