"""The files of the page: viser's document with the page's own modules in it, and these modules.

viser serves one document, which brings its code inside and starts it as a script without a name. The page's modules are
put into that document, and every script in it gets a nonce, so that no other script runs (Content-Security-Policy).
Tests open the page in a browser, which reports all that its policy refuses.
"""

from __future__ import annotations

import gzip
import http
import secrets
from pathlib import Path

import viser
from websockets.datastructures import Headers
from websockets.http11 import Response

PREFIX = "/slidectl/"
_WEB = Path(__file__).parent / "web"
_KINDS = {".js": "text/javascript; charset=utf-8", ".css": "text/css; charset=utf-8"}
_DOCUMENT = Path(viser.__file__).parent / "client" / "build" / "index.html"
_SCRIPT = "<script data-p="
_MADE = 'e.type="module";e.textContent=code;'
"""Where viser's script makes the script of its code."""
_TITLE = "<title>Viser</title>"
_HEAD = """<title>slidectl</title>
<meta name="color-scheme" content="light dark" />
<link rel="stylesheet" href="{prefix}vendor/uPlot.min.css" />
<link rel="stylesheet" href="{prefix}style.css" />
<script type="importmap" nonce="{nonce}">{{"imports": {{"preact": "{prefix}vendor/preact.module.js",
"preact/hooks": "{prefix}vendor/hooks.module.js", "uplot": "{prefix}vendor/uPlot.esm.js"}}}}</script>
<script type="module" nonce="{nonce}" src="{prefix}app.js"></script>"""
# viser's styles are made by scripts, its decoder is WebAssembly with functions that it makes of texts (embind, hence
# unsafe-eval), and its pictures and workers are blobs.
_POLICY = (
    "default-src 'none'; script-src 'self' 'nonce-{nonce}' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self' data: blob:; worker-src blob:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
)


class PageFiles:
    """Answers requests for the files. They are read once."""

    def __init__(self) -> None:
        document = _DOCUMENT.read_text("utf-8")
        for mark in (_SCRIPT, _MADE, _TITLE):
            if document.count(mark) != 1:
                raise RuntimeError(f"viser {viser.__version__} has another document than the page knows")
        # The parts of the document, between which the nonce is: the script's code has any characters.
        head, body = document.split(_SCRIPT)
        self._head = head
        self._body = "data-p=" + body.replace(_MADE, f'e.nonce="{{}}";{_MADE}'.replace("{}", "\0"))
        self._files = {
            PREFIX + path.relative_to(_WEB).as_posix(): (_KINDS[path.suffix], path.read_bytes())
            for path in _WEB.rglob("*")
            if path.suffix in _KINDS
        }
        self._packed = {path: gzip.compress(body, mtime=0) for path, (_, body) in self._files.items()}

    def answer(self, path: str, encodings: str) -> Response | None:
        """The response to a request for the document or a module; None for any other path.

        `encodings` are those that the browser accepts. The document, whose code is packed, is sent as it is.
        """
        if path in ("/", "/index.html"):
            nonce = secrets.token_urlsafe(18)
            head = self._head.replace(_TITLE, _HEAD.format(prefix=PREFIX, nonce=nonce))
            text = f'{head}<script nonce="{nonce}" {self._body.replace(chr(0), nonce)}'
            policy = {"Content-Security-Policy": _POLICY.format(nonce=nonce)}
            return _response("text/html; charset=utf-8", text.encode("utf-8"), policy)
        if path not in self._files:
            return None
        kind, body = self._files[path]
        if "gzip" in encodings:
            return _response(kind, self._packed[path], {"Content-Encoding": "gzip"})
        return _response(kind, body, {})


def _response(kind: str, body: bytes, more: dict[str, str]) -> Response:
    headers = {"Content-Type": kind, "Content-Length": str(len(body)), "X-Content-Type-Options": "nosniff", **more}
    return Response(http.HTTPStatus.OK, "OK", Headers(headers), body)
