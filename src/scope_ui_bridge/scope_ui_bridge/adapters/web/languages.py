"""Languages of the page: a Fluent file for each, found by its name, and the English of the graph's programs."""

from __future__ import annotations

from pathlib import Path

from aiohttp import web

import icu_common

PAGE = Path(__file__).resolve().parents[2] / "page"
MESSAGES = Path(icu_common.__file__).resolve().parent / "messages"


def names() -> list[str]:
    """Return the languages by their codes, English first."""
    found = sorted(file.stem for file in (PAGE / "language").glob("*.ftl"))
    return sorted(found, key=lambda name: name != "en")


def add_routes(router: web.UrlDispatcher) -> None:
    """Register the list of languages, and the sentences that are not in the page's folder."""

    async def listed(request: web.Request) -> web.StreamResponse:
        return web.json_response(names())

    router.add_get("/languages", listed)
    router.add_static("/messages/", MESSAGES, follow_symlinks=False)
