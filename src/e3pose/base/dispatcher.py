"""Compile callees of a kernel into it: optimised once, without an entry from Python.

numba makes every function a library of its own, with machine code and two entries from outside,
and optimises all that it calls once more in each caller. A slot is one call into a tree of a
hundred functions, six calls deep: their code would be optimised and generated at every depth. Here
a function that a kernel calls stays unoptimised code without an entry, until the kernel at the root
is linked, optimised and generated as a whole. Only that one is kept on disk.

This looks inside of numba. `dispatcher_of` takes plain numba where that has changed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import llvmlite.binding as llvm
import numba
from numba import types
from numba.core import config, cpu, event
from numba.core.caching import NullCache
from numba.core.codegen import JITCodeLibrary, get_host_cpu_features
from numba.core.compiler import Flags, compile_extra
from numba.core.registry import CPUDispatcher

from e3pose.base.compiling import COMPILING, Compiling
from e3pose.base.kernel_cache import KernelCache

# Of the fast-math flags only `contract` is safe: it fuses a product and a sum, with one rounding
# where the reference has two. Reordering or ignoring NaN would break the agreement.
OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": {"contract"}}
# LLVM fills half of each vector register, as older processors slow down for whole ones. Those that
# know half precision do not: a product of the network takes 0.7 of the time, to the same bit.
if config.CPU_FEATURES is None and "+avx512fp16" in get_host_cpu_features().split(","):
    config.CPU_FEATURES = f"{get_host_cpu_features()},-prefer-256-bit"


class Part(JITCodeLibrary):  # type: ignore[misc]
    """Code that is linked into a kernel, and neither optimised nor run before."""

    _final_module: Any

    def _optimize_functions(self, ll_module: Any) -> None:
        """Leave that to the kernel."""
        ll_module.data_layout = self._codegen._data_layout

    def finalize(self) -> None:
        """End it without machine code, and pack it: LLVM's form takes several times the memory."""
        self._raise_if_finalized()
        for function in self._final_module.functions:
            if function.linkage == llvm.Linkage.external and not function.is_declaration:
                function.linkage = llvm.Linkage.linkonce_odr
        self._packed = self._final_module.as_bitcode()
        self._final_module = None
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return none: there is no machine code."""
        return 0

    def _get_module_for_linking(self) -> Any:
        """Return the code unpacked, which is the caller's."""
        return llvm.parse_bitcode(self._packed)


class Whole(JITCodeLibrary):  # type: ignore[misc]
    """A library with all the parts that it calls, directly or not."""

    _linking_libraries: list[Any]

    def finalize(self) -> None:
        """Link all parts, optimise, and make machine code."""
        self._linking_libraries = list(_with_parts(self._linking_libraries))
        super().finalize()

    def _optimize_final_module(self) -> None:
        if any(isinstance(library, Part) for library in self._linking_libraries):
            for function in self._final_module.functions:
                if function.linkage == llvm.Linkage.linkonce_odr and not function.is_declaration:
                    function.linkage = llvm.Linkage.internal  # may lose arguments, or go
        super()._optimize_final_module()

    def serialize_using_object_code(self) -> tuple[str, str, tuple[bytes, bytes]]:
        """Keep machine code and only the names of its parts: reading all of them takes long."""
        self._ensure_finalized()
        names = "".join(
            f'define void @"{function.name}"() {{ ret void }}\n'
            for function in self.get_defined_functions()
        )
        named = llvm.parse_assembly(f"{self._codegen._create_empty_module(self._name)}\n{names}")
        return self._name, "object", (self._get_compiled_object(), named.as_bitcode())


def _with_parts(libraries: list[Any]) -> Iterator[Any]:
    """Yield libraries and the libraries that their parts call, each once."""
    found: dict[Any, None] = {}
    left = list(reversed(libraries))
    while left:
        library = left.pop()
        if library in found:
            continue
        found[library] = None
        if isinstance(library, Part):
            left += reversed(library._linking_libraries)
    yield from found


class _NoEntry:
    """Stands for the entry of a part; keeps its library and its environment."""

    def __init__(self, *kept: Any) -> None:
        self.kept = kept


class KernelDispatcher(CPUDispatcher):  # type: ignore[misc]
    """Compiles a function for Python as a whole, and for other kernels as a part of them."""

    _cache: Any

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._as_part = False
        self._compiler._compile_core = self._compile_core
        self.targetctx.codegen()._library_class = Whole  # may link parts

    def _compile_core(self, args: Any, return_type: Any) -> Any:
        """Compile one signature into a library of the right kind."""
        flags = Flags()
        self.targetdescr.options.parse_as_flags(flags, self.targetoptions)
        flags.no_cfunc_wrapper = True
        if self._as_part:
            flags.no_cpython_wrapper = True
        kind = Part if self._as_part else Whole
        library = kind(self.targetctx.codegen(), self.py_func.__qualname__)
        library.enable_object_caching()
        made = compile_extra(
            self.targetdescr.typing_context,
            self.targetdescr.target_context,
            self.py_func,
            args=args,
            return_type=return_type,
            flags=flags,
            locals=self.locals,
            library=library,
            pipeline_class=self._compiler.pipeline_class,
        )
        made.fndesc.typemap = made.fndesc.calltypes = None  # the whole source with its types
        return made._replace(type_annotation="")

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Compile as a part: another kernel calls it.

        numba would compile it once more for each constant in a call.
        """
        args = tuple(types.unliteral(arg) for arg in args)
        kws = {name: types.unliteral(arg) for name, arg in dict(kws).items()}
        before, self._as_part = self._as_part, True
        try:
            return super().get_call_template(args, kws)
        finally:
            self._as_part = before

    def compile(self, sig: Any) -> Any:
        """Compile as a part, or as a whole, and return the entry."""
        key = tuple(sig)
        known = self.overloads.get(key)
        if self._as_part:
            if known is not None and known.metadata is None:
                del self.overloads[key]  # loaded, with machine code alone
            cache, self._cache = self._cache, NullCache()
            try:
                return super().compile(sig)
            finally:
                self._cache = cache
        if known is not None and isinstance(known.entry_point, _NoEntry):
            del self.overloads[key]  # compiled as a part of another one so far
        entry = super().compile(sig)
        made = self.overloads[key]
        if made.metadata is not None:  # compiled now, not loaded
            for environment in made._find_referenced_environments():
                made.library.codegen.set_env(environment.env_name, environment)
        return entry

    def add_overload(self, cres: Any) -> None:
        """Keep a part from Python, which would call it without an entry."""
        if isinstance(cres.entry_point, _NoEntry):
            self.overloads[tuple(cres.signature.args)] = cres
        else:
            super().add_overload(cres)


_get_executable = cpu.CPUContext.get_executable


def _executable(self: Any, library: Any, fndesc: Any, env: Any) -> Any:
    if isinstance(library, Part):
        return _NoEntry(library, env)
    return _get_executable(self, library, fndesc, env)


cpu.CPUContext.get_executable = _executable

_get_call_type = types.BaseFunction.get_call_type
_known: dict[tuple[int, int, Any], tuple[Any, Any]] = {}


def _call_type(self: Any, context: Any, args: Any, kws: Any) -> Any:
    """Find the form of an operator or a function of numba's own once for the types of its call.

    numba would try all its forms again at each plus sign, a fifth of the time of all compiling.
    """
    if kws:
        return _get_call_type(self, context, args, kws)
    key = id(self), id(context), tuple(args)
    if key not in _known:  # with what has the ids, so that nothing else gets them
        _known[key] = _get_call_type(self, context, args, kws), (self, context)
    return _known[key][0]


types.BaseFunction.get_call_type = _call_type


def dispatcher_of(function: Callable[..., Any]) -> Any:
    """Return the dispatcher of a function; its code is kept on disk where that can be written."""
    try:
        made = KernelDispatcher(function, targetoptions={**OPTIONS, "nopython": True})
    except AttributeError:  # another numba: compile each time
        return numba.njit(**OPTIONS)(function)
    with suppress(RuntimeError, OSError):  # nowhere to write, or no files to stamp
        made._cache = KernelCache(function)
    return made


def is_kept(dispatcher: Any) -> bool | None:
    """Return whether a compiled form is on disk; None where none can be kept."""
    kept = getattr(dispatcher, "_cache", None)
    return kept.is_filled() if isinstance(kept, KernelCache) else None


event.Listener.register(Compiling)
event.register("numba:compile", COMPILING)
