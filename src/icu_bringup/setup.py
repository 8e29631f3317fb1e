"""Build file of the package; see package.xml for what it is."""

from glob import glob

from setuptools import find_packages, setup

NAME = "icu_bringup"
FOLDERS = ("launch", "config", "config/params", "config/cameras", "config/rooms", "config/scopes", "config/sequences")

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(),
    package_data={NAME: ["py.typed", "**/*.xml", "**/*.html", "**/*.css", "**/*.js", "**/*.svg"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + NAME]),
        ("share/" + NAME, ["package.xml"]),
        *[("share/" + NAME + "/" + folder, sorted(glob(folder + "/*.*"))) for folder in FOLDERS],
    ],
    install_requires=["setuptools"],
    extras_require={"export": ["pyarrow>=18", "rerun-sdk==0.41.0"]},  # bag_export's parquet, lerobot and rerun
    zip_safe=True,
    description="Start of the whole graph (bring-up, launch), and bags: record, play, check, info, export",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "bag_record = icu_bringup.cli.bag_record:main",
            "bag_play = icu_bringup.cli.bag_play:main",
            "bag_check = icu_bringup.cli.bag_check:main",
            "bag_info = icu_bringup.cli.bag_info:main",
            "bag_export = icu_bringup.cli.bag_export:main",
            "beds = icu_bringup.nodes.beds_node:main",
            "composed = icu_bringup.cli.composed:main",
            "bring_up = icu_bringup.cli.bring_up:main",
        ],
    },
)
