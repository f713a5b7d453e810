"""Run a network: ONNX Runtime on the best provider, LiteRT, OpenCV for TensorFlow graphs."""

from __future__ import annotations

import mmap
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.child_process import call_apart
from e3pose.base.errors import InputError
from e3pose.base.installing import install_command
from e3pose.base.system import num_cores
from e3pose.detectors.weights import ENDINGS, cache_folder
from e3pose.detectors.weights.fetch import file_sha256

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5
GRAPH, NODE = 7, 1  # of a model, of a graph
INPUT, OUTPUT, OPERATOR = 1, 2, 4  # of a node
GRAPH_INPUT, NAME = 11, 1
UNCHANGED = ("Cast", "Identity")  # operators that hand an image on as it is


@contextmanager
def mapped(path: Path) -> Iterator[mmap.mmap]:
    """Yield the bytes of a file without reading all of them."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        yield content


def first_operators(path: Path) -> frozenset[str]:
    """Return the operators that the image goes through first, such as `Conv`.

    Empty where the file is no such network, or does not look at its image.
    """
    with mapped(path) as content:
        try:
            return _first_operators(content)
        except IndexError:
            return frozenset()


def _first_operators(content: mmap.mmap) -> frozenset[str]:
    graph = next(span for number, *span in fields_of(content, 0, len(content)) if number == GRAPH)
    images: set[bytes] = set()
    nodes: list[tuple[set[bytes], set[bytes], str]] = []
    for number, begin, end in fields_of(content, *graph):
        if number == GRAPH_INPUT:
            images.update(content[a:b] for n, a, b in fields_of(content, begin, end) if n == NAME)
        elif number == NODE:
            parts = list(fields_of(content, begin, end))
            read = {content[a:b] for n, a, b in parts if n == INPUT}
            made = {content[a:b] for n, a, b in parts if n == OUTPUT}
            kind = next((content[a:b] for n, a, b in parts if n == OPERATOR), b"")
            nodes.append((read, made, kind.decode(errors="replace")))
    found = set()
    for read, made, operator in nodes:  # in the order in which they run
        if read & images:
            if operator in UNCHANGED:
                images |= made
            else:
                found.add(operator)
    return frozenset(found)


def fields_of(content: mmap.mmap, at: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Yield number, begin and end of each field of a message that holds bytes.

    Args:
        content: the file.
        at: where the message begins.
        end: where it ends.

    Raises:
        IndexError: where this is no such message.
    """
    while at < end:
        key, at = _varint(content, at)
        wire = key & 7
        if wire == VARINT:
            _, at = _varint(content, at)
        elif wire in (FIXED64, FIXED32):
            at += 8 if wire == FIXED64 else 4
        elif wire == BYTES:
            size, at = _varint(content, at)
            if at + size > end:
                raise IndexError
            yield key >> 3, at, at + size
            at += size
        else:
            raise IndexError


def _varint(content: mmap.mmap, at: int) -> tuple[int, int]:
    value = shift = 0
    while shift < 64:
        byte = content[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at
    raise IndexError


# The files beside an ONNX file that hold its weights, and whether they may be read.
#
# Not every version of ONNX Runtime refuses paths that leave the folder.

# Fields that lead from a model to its tensors: numbers of `onnx.proto`, by the message they are in.
INTO = {
    "model": {7: "graph", 20: "training", 25: "function"},
    "training": {1: "graph", 2: "graph"},
    "function": {7: "node"},
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: "tensor", 2: "tensor"},
    "tensor": {13: "entry"},
    "entry": {1: "text", 2: "text"},
}
MAX_DEPTH = 100


def check_external_data(path: Path) -> None:
    """Raise `InputError` where weights are to be read from a file that is not in the folder."""
    with mapped(path) as content:
        try:
            named = sorted(set(_locations(content, 0, len(content), "model", 0)))
        except (IndexError, RecursionError):
            return  # no such file: ONNX Runtime says what is wrong with it
    for location in named:
        name = repr(location[:80])
        parts = PurePosixPath(location).parts + PureWindowsPath(location).parts
        absolute = PurePosixPath(location).is_absolute() or PureWindowsPath(location).is_absolute()
        folder = path.parent.resolve()
        if absolute or ".." in parts or "\0" in location:
            inside = False
        else:
            inside = (folder / location).resolve().is_relative_to(folder)
        if not inside:
            raise InputError(f"{path}: weights: found the file {name}, expected one in its folder")
        if not (folder / location).is_file():
            raise InputError(
                f"{path}: weights: found no file {name} beside it, expected its weights"
            )


def _locations(content: mmap.mmap, begin: int, end: int, kind: str, depth: int) -> Iterator[str]:
    """Yield the locations of the tensors in a message from byte `begin` to `end`."""
    if depth > MAX_DEPTH:
        raise RecursionError
    if kind == "entry":
        fields = {number: content[a:b] for number, a, b in fields_of(content, begin, end)}
        if fields.get(1) == b"location":
            yield fields.get(2, b"").decode(errors="replace")
        return
    for number, first, stop in fields_of(content, begin, end):
        inner = INTO[kind].get(number)
        if inner is not None:
            yield from _locations(content, first, stop, inner, depth + 1)


# Best first; `auto` takes every one that this installation of ONNX Runtime has, in this order.
PROVIDERS = {
    "tensorrt": "TensorrtExecutionProvider",
    "cuda": "CUDAExecutionProvider",
    "openvino": "OpenVINOExecutionProvider",
    "coreml": "CoreMLExecutionProvider",
    "cpu": "CPUExecutionProvider",
}
FLOATS = {"float": np.float32, "float16": np.float16}  # element types of an image's input
SIZES = {"int64": np.int64, "int32": np.int32, "float": np.float32}  # likewise of a size
SUFFIXES = ".onnx, .tflite or .pb"
MAX_MODEL_BYTES = 2**31  # protobuf's own limit
# Of a network that is tried: time, memory, and the sides of its input that are free.
TRY_S, TRY_BYTES, TRY_SIDE = 120.0, 8 * 10**9, 64
DTYPES: dict[str, type[np.generic]] = {"float16": np.float16, "uint8": np.uint8, "int32": np.int32}
SIZE_INPUT = "orig_target_sizes"  # `(1, 2)` width and height in which a network answers
ERRORS_ONLY = 3  # ONNX Runtime's log severity


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """A loaded network file with one image as its input.

    Attributes:
        path: the file, for messages.
        provider: where it runs: a key of `PROVIDERS`, `litert`, or `opencv`.
        threads: of the CPU that a run takes, where others may go on beside it; None where one goes
            on at a time, on a device or with all threads of a library.
        input_shape: the input's declared shape, None where it is free.
        input_dtype: the input's element type: `float`, `float16`, `int32`, ...
        output_names: what the file calls each output.
        output_shapes: the declared shape of each output, None where it is free or unknown.
        run: returns the outputs for one input tensor, in the file's order. A network that asks for
            the size to answer in (`SIZE_INPUT`) is told that of the tensor. It raises `InputError`
            for a tensor of a shape with which the network does not run.
    """

    path: Path
    provider: str
    threads: int | None
    input_shape: tuple[int | None, ...]
    input_dtype: str
    output_names: tuple[str, ...]
    output_shapes: tuple[tuple[int | None, ...], ...]
    run: Callable[[NDArray[Any]], list[NDArray[Any]]]


def check_image_input(network: Network, name: str, dtypes: Collection[str] = FLOATS) -> None:
    """Raise `InputError` for a network that takes anything but one image of three channels.

    Args:
        network: of the file that was opened.
        name: of the detector, for the message.
        dtypes: what the image may be made of.
    """
    shape = network.input_shape
    if len(shape) != 4 or shape[1] not in (3, None) or network.input_dtype not in dtypes:
        raise InputError(
            f"{network.path}: input: found {network.input_dtype} {list(shape)}, expected float "
            f"[1, 3, height, width] for {name}"
        )


def choose_providers(
    provider: str, available: Sequence[str], engine_cache: Path
) -> list[str | tuple[str, dict[str, Any]]]:
    """Return the providers to request from ONNX Runtime.

    Args:
        provider: `auto` or a key of `PROVIDERS`.
        available: the providers this installation has.
        engine_cache: folder for what TensorRT and OpenVINO build, in minutes and seconds, for one
            device and version.

    Raises:
        InputError: when the provider is unknown or not installed.
    """
    if provider != "auto" and provider not in PROVIDERS:
        raise InputError(f"provider: found {provider!r}, expected auto, {', '.join(PROVIDERS)}")
    wanted = list(PROVIDERS) if provider == "auto" else [provider]
    present = [name for name in wanted if PROVIDERS[name] in available]
    if not present:
        have = [name for name, full in PROVIDERS.items() if full in available]
        raise InputError(
            f"provider: {provider} is not in this ONNX Runtime, which has {', '.join(have)}; "
            "onnxruntime-gpu brings cuda and tensorrt, onnxruntime-openvino brings openvino"
        )
    options: dict[str, dict[str, Any]] = {
        "tensorrt": {
            "trt_fp16_enable": True,
            "trt_engine_cache_enable": True,
            "trt_engine_cache_path": str(engine_cache),
        },
        "openvino": {"cache_dir": str(engine_cache)},
    }
    # TensorRT hands what it cannot do to the next provider, so a forced one keeps CUDA behind it.
    if present == ["tensorrt"] and PROVIDERS["cuda"] in available:
        present.append("cuda")
    return [
        (PROVIDERS[name], options[name]) if name in options else PROVIDERS[name] for name in present
    ]


def check_threads(threads: int | None) -> None:
    """Raise `InputError` for a number of CPU threads that cannot be; None is all cores."""
    if threads is not None and not 1 <= threads <= 1024:
        raise InputError(f"threads: found {threads}, expected 1 to 1024")


def load_network(
    path: Path, provider: str = "auto", threads: int | None = None, known: bool = False
) -> Network:
    """Load an `.onnx` file, a `.tflite` file or a frozen TensorFlow `.pb` graph.

    Args:
        path: the network.
        provider: `auto` or a key of `PROVIDERS`; for a `.tflite` the library of a delegate, such as
            `libedgetpu.so.1`; a `.pb` runs on the CPU only.
        threads: CPU threads; None lets the library use all cores.
        known: whether it is one of the catalogue's, by its hash; others are tried once in a
            process of their own, as a graph may compute without an end already while it is loaded.

    Raises:
        InputError: when the file is not a network, or the provider cannot be had.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file, expected a network in {SUFFIXES}")
    size = path.stat().st_size
    if not 0 < size <= MAX_MODEL_BYTES:
        raise InputError(
            f"{path}: found {size} bytes, expected a network of 1 to {MAX_MODEL_BYTES}"
        )
    check_threads(threads)
    if path.suffix == ".onnx":
        check_external_data(path)
    if path.suffix == ".tflite" and find_spec("ai_edge_litert") is None:
        expected = f"`{install_command('litert')}`"
        raise InputError(str(path), "a network for LiteRT, which is not installed", expected)
    if not known and path.suffix in ENDINGS:
        _check_bounds(path)
    if path.suffix == ".onnx":
        return _load_onnx(path, provider, threads)
    if path.suffix == ".tflite":
        return _load_litert(path, provider, threads)
    if path.suffix == ".pb":
        if provider not in ("auto", "cpu"):
            raise InputError(
                f"{path}: provider: a TensorFlow graph runs on the cpu only, found {provider!r}; "
                "use an .onnx file of the network"
            )
        return _load_tensorflow(path, threads)
    raise InputError(f"{path}: found suffix {path.suffix!r}, expected a network in {SUFFIXES}")


def _check_bounds(path: Path) -> None:
    """Raise `InputError` for a network that takes too much to load and run once."""
    tried = cache_folder() / "tried-networks" / file_sha256(path)
    if tried.exists():
        return
    try:
        call_apart(_try, path, limit_s=TRY_S, most_memory=TRY_BYTES)
    except InputError as error:
        why = str(error).removeprefix(f"{path}: ")
        wanted = f"a network that loads and runs within {TRY_S:g} s and {TRY_BYTES / 1e9:g} GB"
        raise InputError(f"{path}: {why}; expected {wanted}") from None
    with suppress(OSError):  # tried again next time
        tried.parent.mkdir(parents=True, exist_ok=True)
        tried.touch()


def _try(path: Path) -> None:
    network = load_network(path, "cpu", 1, known=True)
    shape = [TRY_SIDE if side is None else side for side in network.input_shape]
    try:
        network.run(np.zeros(shape, DTYPES.get(network.input_dtype, np.float32)))
    except InputError as error:  # its detector may give it another size where one is free
        if None not in network.input_shape or "allocate" in str(error.__context__):
            raise


def _load_onnx(path: Path, provider: str, threads: int | None) -> Network:
    import onnxruntime

    engine_cache = cache_folder() / "engines"
    providers = choose_providers(provider, onnxruntime.get_available_providers(), engine_cache)
    if any(isinstance(entry, tuple) for entry in providers):
        engine_cache.mkdir(parents=True, exist_ok=True)
    options = onnxruntime.SessionOptions()
    options.log_severity_level = ERRORS_ONLY
    options.intra_op_num_threads = threads or 0
    # Threads that wait in a loop take a core from decoding, and joules from a battery.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    try:
        session = onnxruntime.InferenceSession(str(path), options, providers=providers)
    except Exception as error:
        raise InputError(f"{path}: not a network ONNX Runtime can load: {_brief(error)}") from None
    # ONNX Runtime falls back without a word when a provider's own libraries are missing.
    if provider != "auto" and session.get_providers()[0] != PROVIDERS[provider]:
        raise InputError(
            f"provider: {provider} did not start, ONNX Runtime fell back to "
            f"{session.get_providers()[0]}; are its libraries installed?"
        )
    inputs = [each for each in session.get_inputs() if each.name != SIZE_INPUT]
    sizes = [_element(each) for each in session.get_inputs() if each.name == SIZE_INPUT]
    if len(inputs) != 1:
        raise InputError(f"{path}: found {len(inputs)} inputs, expected a network with one image")
    if sizes and sizes[0] not in SIZES:
        raise InputError(f"{path}: {SIZE_INPUT}", sizes[0], " or ".join(SIZES))

    def run(tensor: NDArray[Any]) -> list[NDArray[Any]]:
        fed = {inputs[0].name: tensor}
        if sizes:
            fed[SIZE_INPUT] = np.array([tensor.shape[:1:-1]], dtype=SIZES[sizes[0]])
        try:
            return [np.asarray(output) for output in session.run(None, fed)]
        except Exception as error:  # ONNX Runtime's errors share no base but Exception
            raise InputError(
                f"{path}: input {inputs[0].name}: shape {tensor.shape} does not run: "
                f"{_brief(error)}"
            ) from None

    runs_on = next((n for n, full in PROVIDERS.items() if full == session.get_providers()[0]), "")
    return Network(
        path,
        runs_on,
        (threads or num_cores()) if runs_on == "cpu" else None,
        _shape(inputs[0].shape),
        _element(inputs[0]),
        tuple(output.name for output in session.get_outputs()),
        tuple(_shape(output.shape) for output in session.get_outputs()),
        run,
    )


def _load_litert(path: Path, provider: str, threads: int | None) -> Network:
    """Load a network for LiteRT; an image of floats is fed as to ONNX, channels first."""
    from ai_edge_litert.interpreter import Interpreter, load_delegate

    if provider not in ("auto", "cpu") and ".so" not in provider:
        raise InputError("provider", repr(provider[:80]), "cpu, or a delegate's library (.so)")
    try:
        delegates = [load_delegate(provider)] if ".so" in provider else None
        running = Interpreter(str(path), experimental_delegates=delegates, num_threads=threads)
        running.allocate_tensors()
    except (ValueError, RuntimeError, OSError) as error:
        raise InputError(f"{path}: not a network LiteRT can load: {_brief(error)}") from None
    inputs, outputs = running.get_input_details(), running.get_output_details()
    if len(inputs) != 1:
        raise InputError(f"{path}: found {len(inputs)} inputs, expected a network with one image")
    dtype = np.dtype(inputs[0]["dtype"])
    shape = _signature(inputs[0])
    turned = len(shape) == 4 and shape[3] == 3 and dtype.kind == "f"
    if turned:
        shape = (shape[0], 3, *shape[1:3])

    def run(tensor: NDArray[Any]) -> list[NDArray[Any]]:
        fed = tensor.transpose(0, 2, 3, 1) if turned else tensor
        try:
            if fed.shape != tuple(running.get_input_details()[0]["shape"]):
                running.resize_tensor_input(inputs[0]["index"], fed.shape)
                running.allocate_tensors()
            running.set_tensor(inputs[0]["index"], np.ascontiguousarray(fed, dtype))
            running.invoke()
        except (ValueError, RuntimeError) as error:
            raise InputError(f"{path}: shape {fed.shape} does not run: {_brief(error)}") from error
        return [_floats(running.get_tensor(each["index"]), each) for each in outputs]

    element = {"f4": "float", "f2": "float16", "i4": "int32"}.get(dtype.str[1:], dtype.name)
    names = tuple(str(each["name"]) for each in outputs)
    shapes = tuple(_signature(each) for each in outputs)
    return Network(path, "litert", None, shape, element, names, shapes, run)


def _signature(details: Mapping[str, Any]) -> tuple[int | None, ...]:
    """Return the shape of a tensor of LiteRT, None where it is free."""
    return tuple(int(side) if side > 0 else None for side in details["shape_signature"])


def _floats(values: NDArray[Any], details: Mapping[str, Any]) -> NDArray[Any]:
    """Return an output of LiteRT; whole numbers that stand for floats become these."""
    scale, zero = details["quantization"]
    return (values.astype(np.float32) - zero) * scale if scale else values


def _load_tensorflow(path: Path, threads: int | None) -> Network:
    import cv2

    try:
        net = cv2.dnn.readNetFromTensorflow(str(path))
    except cv2.error as error:
        raise InputError(
            f"{path}: not a TensorFlow graph OpenCV can load: {_brief(error)}"
        ) from None
    if net.empty() or len(net.getUnconnectedOutLayersNames()) != 1:
        raise InputError(f"{path}: found no network, expected a graph with one output")
    cv2.setNumThreads(threads or -1)  # OpenCV has one pool for the whole process; -1: all cores

    def run(tensor: NDArray[Any]) -> list[NDArray[Any]]:
        try:
            net.setInput(tensor)
            return [np.asarray(net.forward())]
        except cv2.error as error:
            raise InputError(
                f"{path}: shape {tensor.shape} does not run: {_brief(error)}"
            ) from None

    free = (None, None)
    return Network(path, "opencv", None, (1, 3, *free), "float", ("",), ((*free, *free),), run)


def _element(declared: Any) -> str:
    return str(declared.type).removeprefix("tensor(").removesuffix(")")


def _shape(declared: Sequence[Any]) -> tuple[int | None, ...]:
    return tuple(side if isinstance(side, int) else None for side in declared)


def _brief(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text if len(text) <= 160 else text[:157] + "..."
