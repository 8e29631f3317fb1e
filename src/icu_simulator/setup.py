"""Build file of the package; see package.xml for what it is."""

from setuptools import find_packages, setup

NAME = "icu_simulator"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(),
    package_data={NAME: ["py.typed", "**/*.xml", "**/*.html", "**/*.css", "**/*.js", "**/*.svg"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + NAME]),
        ("share/" + NAME, ["package.xml"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    description="Simulated bench: instrument panel, room, stereo camera, mechanics and touch",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "bench = icu_simulator.nodes.bench_node:main",
            "bench_render = icu_simulator.cli.render:main",
        ],
    },
)
