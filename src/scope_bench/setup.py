"""Build file of the package; see package.xml for what it is."""

from glob import glob

from setuptools import find_packages, setup

NAME = "scope_bench"
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
    description="Simulated bench (instrument panel, stereo camera, mechanics, touch) and bring-up of the whole graph",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "bench = scope_bench.nodes.bench_node:main",
            "bench_render = scope_bench.cli.render:main",
            "bag_record = scope_bench.cli.bag_record:main",
            "bag_play = scope_bench.cli.bag_play:main",
            "bag_check = scope_bench.cli.bag_check:main",
            "bag_info = scope_bench.cli.bag_info:main",
            "bag_export = scope_bench.cli.bag_export:main",
            "beds = scope_bench.nodes.beds_node:main",
            "composed = scope_bench.cli.composed:main",
            "bring_up = scope_bench.cli.bring_up:main",
        ],
    },
)
