"""Check a release: licences, package.xml, distributions and their metadata, and the programs in an empty environment.

Run it by ``make release-check``. The distributions are in artifacts/release. The check needs a network, to install the
libraries of the packages, and publishes nothing.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from collections.abc import Callable, Sequence
from importlib.metadata import EntryPoint
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
OUT = ROOT / "artifacts" / "release"
PACKAGES = sorted(path.parent.name for path in ROOT.glob("src/*/package.xml"))
VERSION = (ROOT / "VERSION").read_text(encoding="ascii").strip()
WITHIN_S = 900.0
CORNERS = """
import numpy as np
from harris_perception import detect_corners
found = detect_corners(np.kron(np.eye(4, dtype=np.uint8) * 255, np.ones((16, 16), np.uint8)))
assert len(found) > 3, found
"""
"""A smoke test of the detector without ROS, from the documents."""


class Failed(Exception):
    """A check has failed; the message says which and why."""


def run(command: Sequence[str | Path], **options: object) -> str:
    """Run a command and return its output.

    Raises
    ------
    Failed
        With the last lines of its output.
    """
    done = subprocess.run(  # type: ignore[call-overload]
        [*map(str, command)], capture_output=True, text=True, timeout=WITHIN_S, check=False, **options
    )
    if done.returncode != 0:
        lines = f"{done.stdout}{done.stderr}".strip().splitlines()[-15:]
        raise Failed(f"{' '.join(map(str, command))} ended with {done.returncode}:\n" + "\n".join(lines))
    return str(done.stdout)


def versions() -> None:
    """Compare the version of VERSION with the packages and the changelog."""
    for package in PACKAGES:
        told = re.search(r"<version>(.*)</version>", (ROOT / "src" / package / "package.xml").read_text())
        if told is None or told[1] != VERSION:
            raise Failed(
                f"{package}: version {told and told[1]}, VERSION says {VERSION}: scripts/release/set_version.py"
            )
    if not re.search(rf"^## \[{re.escape(VERSION)}\] - \d{{4}}-\d\d-\d\d$", (ROOT / "CHANGELOG.md").read_text(), re.M):
        raise Failed(f"CHANGELOG.md has no section [{VERSION}] with a date")


def licences() -> None:
    """Check that each file has a licence (REUSE)."""
    run([tool("reuse"), "--root", ROOT, "lint", "--quiet"])


def descriptions() -> None:
    """Compare each package's imports with its package.xml and setup.py, and its files for a release."""
    tests = ["tests/unit/project/test_packaging.py", "tests/unit/project/release"]
    run([sys.executable, "-m", "pytest", "-q", "-k", "package_xml or setup_py or release", *tests], cwd=ROOT)


def distributions() -> None:
    """Build a source distribution of each package, and from it the wheel, and look into both."""
    shutil.rmtree(OUT, ignore_errors=True)
    for package in PACKAGES:
        run([sys.executable, "-m", "build", "--no-isolation", "--outdir", OUT, ROOT / "src" / package])
        with tarfile.open(OUT / f"{package}-{VERSION}.tar.gz") as source:
            names = {name.partition("/")[2] for name in source.getnames()}
        missing = {"package.xml", "setup.py", "LICENSE", f"resource/{package}", "README.md"} - names
        if missing:
            raise Failed(f"{package}: the source distribution lacks {', '.join(sorted(missing))}")
        with zipfile.ZipFile(wheel(package)) as built:
            modules = {name for name in built.namelist() if name.endswith(".py")}
            metadata = next(name for name in built.namelist() if name.endswith("/METADATA"))
            if str(ROOT) in built.read(metadata).decode():
                raise Failed(f"{package}: the wheel's metadata has a path of this computer")
        wanted = {str(p.relative_to(ROOT / "src" / package)) for p in (ROOT / "src" / package / package).rglob("*.py")}
        if wanted - modules:
            raise Failed(f"{package}: the wheel lacks {', '.join(sorted(wanted - modules)[:5])}")


def metadata() -> None:
    """Check the metadata as a package index does."""
    run([tool("twine"), "check", "--strict", *sorted(OUT.iterdir())])


def installed() -> None:
    """Install all wheels with their libraries into an empty environment, and run smoke tests there."""
    folder = OUT / "environment"
    venv.create(folder, with_pip=True)
    python = folder / "bin" / "python"
    wheels = [f"{package}{extra(package)} @ {wheel(package).as_uri()}" for package in PACKAGES]
    run([python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *wheels])
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | {"PYTHONNOUSERSITE": "1"}
    run([python, "-c", CORNERS], env=clean, cwd=folder)
    run([folder / "bin" / "camera_calibration", "board", "board.pdf", "--paper", "a4"], env=clean, cwd=folder)
    (folder / "program.nc").write_text("G21 G90 G94\nG1 X-10 Y-10 F600\n", encoding="ascii")
    run([folder / "bin" / "gantry_gcode", "run", "program.nc", "--check"], env=clean, cwd=folder)
    run([folder / "bin" / "mock_grbl", "--help"], env=clean, cwd=folder)
    # The other programs import rclpy, which is in the project's environment or in that of Jazzy.
    others = [sysconfig.get_path("purelib"), *os.environ.get("PYTHONPATH", "").split(os.pathsep)]
    with_ros = clean | {"PYTHONPATH": os.pathsep.join(filter(None, others))}
    for name, module in programs():
        if ".nodes." not in module:  # a node takes only ROS arguments
            run([folder / "bin" / name, "--help"], env=with_ros, cwd=folder)
        else:
            run([python, "-c", f"import {module}"], env=with_ros, cwd=folder)
    shutil.rmtree(folder)


def programs() -> list[tuple[str, str]]:
    """Return name and module of each program in the wheels."""
    found: list[tuple[str, str]] = []
    for package in PACKAGES:
        with zipfile.ZipFile(wheel(package)) as built:
            texts = [built.read(name).decode() for name in built.namelist() if name.endswith("entry_points.txt")]
        for name, value in re.findall(r"^(\w+) = (\S+)$", "\n".join(texts), re.MULTILINE):
            found.append((name, EntryPoint(name, value, "console_scripts").module))
    return found


def extra(package: str) -> str:
    """Return the extra with which pip installs a package's libraries."""
    return "[libraries]" if '"libraries"' in (ROOT / "src" / package / "setup.py").read_text() else ""


def wheel(package: str) -> Path:
    return OUT / f"{package}-{VERSION}-py3-none-any.whl"


def tool(name: str) -> Path:
    """Return a program of the environment that runs this script."""
    return Path(sysconfig.get_path("scripts")) / name


CHECKS: tuple[Callable[[], None], ...] = (versions, licences, descriptions, distributions, metadata, installed)


def main() -> int:
    """Run all checks in order; 1 at the first that fails."""
    for check in CHECKS:
        print(f"{check.__name__}: {(check.__doc__ or '').strip().splitlines()[0]}", flush=True)
        try:
            check()
        except (Failed, subprocess.TimeoutExpired) as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
    print(f"release {VERSION}: all checks passed; the distributions are in {OUT.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
