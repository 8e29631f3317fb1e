"""Build file of the package; see package.xml for what it is."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = "harris_perception"
VERSION = ElementTree.parse(Path(__file__).resolve().with_name("package.xml")).findtext("version")
LIBRARIES = ["numpy", "opencv-python-headless", "PyYAML", "numba"]
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
        ("share/" + NAME + "/launch", ["launch/perception.launch.py"]),
        ("share/" + NAME + "/config", ["config/example.yaml"]),
    ],
    install_requires=["setuptools", *NEEDED],
    extras_require={"libraries": LIBRARIES},
    zip_safe=True,
    description="Harris corners, stereo matching, hand-eye calibration and panel recognition",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "camera = harris_perception.nodes.camera_node:main",
            "corners = harris_perception.nodes.corners_node:main",
            "stereo = harris_perception.cli.stereo:stereo",
            "dense_stereo = harris_perception.nodes.dense_stereo_node:main",
            "stylus_tracker = harris_perception.nodes.stylus_node:main",
            "panel_teach = harris_perception.cli.panel_teach:main",
            "recognition = harris_perception.nodes.recognition_node:main",
            "hand_eye = harris_perception.nodes.hand_eye_node:main",
            "harris = harris_perception.cli.harris:main",
            "camera_calibration = harris_perception.cli.calibrate:main",
            "hand_eye_solve = harris_perception.cli.hand_eye:main",
        ],
    },
)
