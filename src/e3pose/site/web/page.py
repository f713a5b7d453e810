"""Serve the page and its files from the package."""

from __future__ import annotations

from importlib import resources

from fastapi import APIRouter
from fastapi.responses import Response

FILES = {
    "/": ("e3pose.site.web", "page.html", "text/html"),
    "/view.js": ("e3pose.site.web", "view.js", "text/javascript"),
    "/past.js": ("e3pose.site.web", "past.js", "text/javascript"),
    "/pictures.js": ("e3pose.site.web", "pictures.js", "text/javascript"),
    "/strips.js": ("e3pose.site.web", "strips.js", "text/javascript"),
    "/view.css": ("e3pose.site.web", "view.css", "text/css"),
    "/scene.js": ("e3pose.output.report", "scene.js", "text/javascript"),
}


def make_page() -> APIRouter:
    """Return the routes of the page."""
    page = APIRouter(include_in_schema=False)
    for path, (package, name, kind) in FILES.items():
        body = resources.files(package).joinpath(name).read_bytes()
        page.add_api_route(path, _serve(body, f"{kind}; charset=utf-8"))
    page.add_api_route("/favicon.ico", lambda: Response(status_code=204))
    return page


def _serve(body: bytes, kind: str):  # type: ignore[no-untyped-def]
    def answer() -> Response:
        return Response(body, media_type=kind)

    return answer
