"""Write the version of the file VERSION into the package.xml of every package; setup.py reads it from there.

A package that stands alone, as in a ROS workspace, has no VERSION: therefore each has its copy.
"""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
_ELEMENT = re.compile(r"<version>[^<]*</version>")


def main() -> None:
    """Update the packages, and print those that changed."""
    version = (ROOT / "VERSION").read_text(encoding="ascii").strip()
    if not re.fullmatch(r"\d+\.\d+\.\d+", version):
        raise SystemExit(f"VERSION is {version!r}: expected three numbers, for example 1.0.0")
    for path in sorted(ROOT.glob("src/*/package.xml")):
        old = path.read_text(encoding="utf-8")
        new = _ELEMENT.sub(f"<version>{version}</version>", old, count=1)
        if new != old:
            path.write_text(new, encoding="utf-8")
            print(f"{path.relative_to(ROOT)}: {version}")


if __name__ == "__main__":
    main()
