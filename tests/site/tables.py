"""Site files for tests of the programs that read them."""

from __future__ import annotations

from pathlib import Path

from e3pose.model.camera import Rig
from e3pose.recording.calibration import save_rig
from e3pose.settings.resolved import ResolvedSite, resolve
from e3pose.settings.site_file import SiteTable, load_site

HEAD = """format = "e3pose-site"
version = 1
name = "lab"
calibration = "rig.toml"
fps = 20
"""


def write_site(folder: Path, more: str = "") -> SiteTable:
    """Write a site file to a folder; return what it says.

    Args:
        folder: to write to.
        more: keys and tables after those that every site has.
    """
    path = folder / "site.toml"
    path.write_text(HEAD + more)
    return load_site(path)


def resolved_site(folder: Path, rig: Rig, more: str = "") -> ResolvedSite:
    """Write a site file and a calibration to a folder; return all that they say."""
    if not (folder / "rig.toml").exists():
        save_rig(rig, folder / "rig.toml")
    return resolve(write_site(folder, more), placed=False)
