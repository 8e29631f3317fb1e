"""A page on this host that shows several robots and sends no orders: pictures, states, links to their own pages."""

from __future__ import annotations

import html
import json
import secrets
import threading
from collections.abc import Callable, Mapping, Sequence
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Beds</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
body {{ font: 16px/1.4 system-ui, sans-serif; margin: 1rem; background: #10161c; color: #e8eef4 }}
main {{ display: grid; grid-template-columns: repeat(auto-fit, minmax(22rem, 1fr)); gap: 1rem }}
section {{ background: #1a232c; border-radius: .5rem; padding: 1rem }}
img {{ width: 100%; aspect-ratio: 16/9; object-fit: contain; background: #000 }}
h2 {{ margin: 0 0 .5rem }} dt {{ color: #9fb3c8; float: left; clear: left; width: 7rem }} dd {{ margin: 0 0 0 7.5rem }}
.old {{ color: #ffb454 }} a {{ color: #7cc4ff }}
</style></head><body><h1>Beds</h1><p>For watching. Each bed is operated on its own page.</p><main>{beds}</main>
<script>
async function show() {{
  try {{
    const beds = await (await fetch("state")).json();
    for (const [name, bed] of Object.entries(beds)) {{
      const part = document.getElementById(name);
      for (const [what, text] of Object.entries(bed.states))
        part.querySelector("." + what).textContent = text || "nothing heard";
      const old = bed.age_s === null || bed.age_s > 2;
      const note = part.querySelector(".age");
      note.textContent = "live";
      if (old) note.textContent = bed.age_s === null ? "no picture yet" : `${{bed.age_s.toFixed(0)}} s old`;
      note.classList.toggle("old", old);
      if (!old) part.querySelector("img").src = name + ".jpg?" + Date.now();
    }}
  }} catch (error) {{
    for (const note of document.querySelectorAll(".age")) {{
      note.textContent = "this page's server is gone";
      note.classList.add("old");
    }}
  }}
  setTimeout(show, 1000);
}}
show();
</script></body></html>
"""
_BED = """<section id="{name}"><h2>{name}</h2><img alt="left camera of {name}"><dl><dt>picture</dt><dd class="age"></dd>
{states}</dl>{link}</section>"""
_STATE = '<dt>{what}</dt><dd class="{what}"></dd>'
_POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src 'self'; connect-src 'self'"
)


class BedsServer:
    """Serves the page in its own threads, on loopback only, below an address that cannot be guessed.

    Parameters
    ----------
    port
        TCP port; 0 chooses a free one.
    links
        Address of each bed's own page, or an empty text.
    whats
        Names of the displayed states.
    state
        Returns for each bed ``{"states": {...}, "age_s": seconds or None}``.
    picture
        Returns a bed's newest picture as JPEG, empty if there is none.

    Raises
    ------
    OSError
        If the port is taken.
    """

    def __init__(
        self,
        port: int,
        links: Mapping[str, str],
        whats: Sequence[str],
        state: Callable[[], Mapping[str, object]],
        picture: Callable[[str], bytes],
    ) -> None:
        secret = secrets.token_urlsafe(16)
        states = "\n".join(_STATE.format(what=what) for what in whats)
        page = _PAGE.format(
            beds="".join(_BED.format(name=html.escape(n), states=states, link=_link(u)) for n, u in links.items())
        ).encode()

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                path = self.path.partition("?")[0]
                name = path.rpartition("/")[2]
                if not secrets.compare_digest(path.rpartition("/")[0].encode(), f"/{secret}".encode()):
                    self.send_error(HTTPStatus.NOT_FOUND)
                elif not name:
                    self._answer("text/html; charset=utf-8", page)
                elif name == "state":
                    self._answer("application/json", json.dumps(state()).encode())
                elif name.removesuffix(".jpg") in links and (data := picture(name.removesuffix(".jpg"))):
                    self._answer("image/jpeg", data)
                else:
                    self.send_error(HTTPStatus.NOT_FOUND)

            def _answer(self, kind: str, data: bytes) -> None:
                self.send_response(HTTPStatus.OK)
                self.send_header("Content-Type", kind)
                self.send_header("Content-Length", str(len(data)))
                self.send_header("Cache-Control", "no-store")
                self.send_header("Content-Security-Policy", _POLICY)
                self.end_headers()
                self.wfile.write(data)

            def log_message(self, format: str, *arguments: object) -> None:
                """Print no requests on the terminal."""

        self._server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
        self._server.daemon_threads = True
        self.address = f"http://127.0.0.1:{self._server.server_address[1]}/{secret}/"
        self._thread = threading.Thread(target=self._server.serve_forever, name="beds page", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def _link(url: str) -> str:
    return f'<p><a href="{html.escape(url, quote=True)}">operate this bed</a></p>' if url else ""
