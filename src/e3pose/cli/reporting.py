"""`e3pose report`: the page of a stretch of a live store."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from e3pose.base.atomic import check_output
from e3pose.base.errors import MISSING, InputError
from e3pose.base.quantities import plural
from e3pose.cli.options import as_typed
from e3pose.cli.output import wrote
from e3pose.cli.smoothing import SmoothOptions
from e3pose.settings.resolved import resolve
from e3pose.settings.site_file import load_site

SMOOTH = SmoothOptions()


def report(
    site: Path,
    dest: Path = Path("report.html"),
    /,
    *,
    from_: Annotated[str | None, Parameter(name="--from", allow_leading_hyphen=True)] = None,
    to: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None,
    smooth: SmoothOptions = SMOOTH,
) -> None:
    """Write the report page of any stretch of a live site: 3D player, camera selection, energy.

    Example: `e3pose report site.toml morning.html --from 09:00 --to 09:30`

    The page is that of `e3pose replay --report`, of what the edge stored. It works while the site
    runs. Of several runs in that time, the newest is shown. Videos that the site kept of it, by
    `record = "video"` or `"both"`, are shown beside the player. With `--smooth`, poses also use
    later slots; what was selected is shown as it was.

    Parameters
    ----------
    site
        Site file, or the folder that contains site.toml.
    dest
        The page to write, `.html`.
    from_
        Start, as for `e3pose query`: `2026-11-21T14:00`, `14:00`, `-10min`, or seconds since the
        start of the run. Default: the start of the newest run.
    to
        End, in the same formats. Default: now.
    """
    from e3pose.output.report.stored import write_stretch
    from e3pose.store import Store

    if dest.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"DEST: found {str(dest)!r}, expected a name ending in .html")
    check_output(dest)
    smoothing = smooth.settings()
    table = load_site(site)
    if table.store is None:
        wanted = '[store] path = "poses.db", without which a site keeps nothing'
        raise InputError("", MISSING, wanted, str(table.path))
    store = Store(table.store.place)
    with as_typed({"time": "--from, --to"}, store.where):
        slots = write_stretch(resolve(table), store, dest, from_, to, smoothing)
    wrote(dest, plural(slots, "slot"))
