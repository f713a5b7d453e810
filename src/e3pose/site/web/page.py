"""Serve the page and its files from the package."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources

from fastapi import APIRouter
from fastapi.responses import Response

BROWSER = resources.files("e3pose.site.web").joinpath("browser")
FOLDERS = ("", "setup", "vendor")
KINDS = {"html": "text/html", "js": "text/javascript", "css": "text/css"}


def _files() -> dict[str, bytes]:
    """Return the files of the pages by path: browser code, and the report's scene."""
    scene = resources.files("e3pose.output.report").joinpath("scene.js")
    found = {"/": BROWSER.joinpath("page.html").read_bytes(), "/scene.js": scene.read_bytes()}
    for name in FOLDERS:
        folder, at = BROWSER.joinpath(name), f"/{name}/" if name else "/"
        for file in folder.iterdir():
            if file.name.endswith((".js", ".css")):
                found[at + file.name] = file.read_bytes()
    return found


FILES = _files()


def make_page(files: Mapping[str, bytes] = FILES) -> APIRouter:
    """Return the routes of a page.

    Args:
        files: by path; what stands at its address is that of `/`.
    """
    page = APIRouter(include_in_schema=False)
    for path, body in files.items():
        kind = KINDS["html" if path == "/" else path.rpartition(".")[2]]
        page.add_api_route(path, _serve(body, f"{kind}; charset=utf-8"))
    page.add_api_route("/favicon.ico", lambda: Response(status_code=204))
    return page


def _serve(body: bytes, kind: str):  # type: ignore[no-untyped-def]
    def answer() -> Response:
        return Response(body, media_type=kind)

    return answer
