"""Hooks of MkDocs: source files that pages link to become part of the site, and each room of the code gets an API page.

Pages link to files outside of docs/ by their path in the project, as a person who reads them there expects. The site
has these files below ``project/``, and links are rewritten to them. A link to a folder becomes plain text.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[2]
OUTSIDE = "project"
SHIM = "assets/javascripts/iframe-worker.js"
"""Script with which the search runs from the file system; by default the theme loads it from the network."""
PAGES = ("CHANGELOG.md", "CONTRIBUTING.md", *sorted(str(p.relative_to(ROOT)) for p in ROOT.glob("src/*/README.md")))
"""Documents outside of docs/ that are pages of the site."""
_LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")
_BLOCK = re.compile(r"(^ *```.*?^ *```)", re.DOTALL | re.MULTILINE)


def rooms() -> dict[str, list[str]]:
    """Return the modules that have API pages, by package: each package's own rooms, one page for each."""
    found: dict[str, list[str]] = {}
    for description in sorted(ROOT.glob("src/*/package.xml")):
        package = description.parent
        folders = sorted({path.parent for path in package.glob(f"{package.name}/**/*.py")})
        found[package.name] = [".".join(folder.relative_to(package).parts) for folder in folders]
    return found


def modules_of(room: str) -> list[str]:
    """Return the modules directly in a room."""
    package = room.partition(".")[0]
    folder = ROOT / "src" / package / room.replace(".", "/")
    return [f"{room}.{path.stem}" for path in sorted(folder.glob("*.py")) if path.stem not in ("__init__", "__main__")]


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add the pages outside of docs/ and the API pages to the navigation."""
    nav: list[Any] = config.nav or []
    nav.append({"Project": [f"{OUTSIDE}/{name}" for name in PAGES]})
    nav.append({"API": [{package: [f"api/{room}.md" for room in names]} for package, names in rooms().items()]})
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the API pages and the files outside of docs/ that pages link to."""
    for names in rooms().values():
        for room in names:
            files.append(File.generated(config, f"api/{room}.md", content=_api_page(room)))
    files.append(File.generated(config, SHIM, abs_src_path=str(Path(__file__).with_name("iframe-worker.js"))))
    linked = set(PAGES)
    for page in [*(ROOT / "docs").rglob("*.md"), *(ROOT / name for name in PAGES)]:
        for part in _BLOCK.split(page.read_text(encoding="utf-8"))[::2]:
            for _, _, target in _LINK.findall(part):
                path = _project_path(page, target.partition("#")[0])
                if path is not None and not path.startswith("docs/") and (ROOT / path).is_file():
                    linked.add(path)
    for name in sorted(linked):
        shown = name if name in PAGES or not name.endswith(".md") else f"{name}.txt"
        files.append(File.generated(config, f"{OUTSIDE}/{shown}", abs_src_path=str(ROOT / name)))
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Rewrite links that lead out of docs/, or into it from outside."""
    uri = page.file.src_uri
    if uri.startswith("api/"):
        return markdown
    outside = uri.startswith(f"{OUTSIDE}/")
    source = ROOT / uri.removeprefix(f"{OUTSIDE}/") if outside else ROOT / "docs" / uri

    def replaced(match: re.Match[str]) -> str:
        name, _, anchor = match[3].partition("#")
        path = _project_path(source, name)
        if path is None or (path.startswith("docs/") and not outside):
            return match[0]
        if not (ROOT / path).is_file():
            return match[2] if (ROOT / path).is_dir() else match[0]
        inside = path.removeprefix("docs/") if path.startswith("docs/") else f"{OUTSIDE}/{path}"
        target = posixpath.relpath(inside, posixpath.dirname(uri) or ".")
        return f"{match[1]}[{match[2]}]({target}{'#' + anchor if anchor else ''})"

    parts = _BLOCK.split(markdown)
    return "".join(part if index % 2 else _LINK.sub(replaced, part) for index, part in enumerate(parts))


def _project_path(page: Path, target: str) -> str | None:
    """Return the path in the project that a link leads to; None for addresses and anchors."""
    if not target or "://" in target or target.startswith("mailto:"):
        return None
    path = (page.parent / target).resolve()
    return path.relative_to(ROOT).as_posix() if path.is_relative_to(ROOT) else None


def _api_page(room: str) -> str:
    blocks = [f"::: {room}\n    options: {{show_submodules: false, members: false}}\n"]
    blocks += [f"::: {module}\n    options: {{heading_level: 2}}\n" for module in modules_of(room)]
    return f"---\ntitle: {room}\n---\n\n" + "\n".join(blocks)
