"""Calls from compiled programs to Python on the host, under a fixed name: JAX keeps such programs between processes.

JAX's own callbacks are known to a program by their place in a list of that process, so that JAX keeps no program that
has one. This one is a handler of XLA's foreign function interface, written with ctypes after `xla/ffi/api/c_api.h`; a
program names by a number which object it calls. Where jaxlib's header has other structs, JAX's own callback is used.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import re
import struct
import threading
import time
import traceback
import weakref
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from math import prod
from pathlib import Path
from typing import Any, Protocol, TypeVar
from weakref import WeakValueDictionary

import jax
import numpy as np
from jax.experimental.buffer_callback import buffer_callback

TARGET = "maax_mjx_host_call"
EXECUTE, METADATA = 3, 1
"""A stage of a call, and a kind of extension, in XLA's enumerations."""
INTERNAL = 13
"""XLA's code of an internal error."""
DTYPES = dict(enumerate(("bool", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f2", "f4", "f8"), start=1))
"""NumPy's types by their number in XLA."""

# A size of a struct and a pointer to extensions come first in every struct.
FRAME = struct.Struct("QQQQiiQQqQQQQqQQQQqQQQ")
"""struct_size, extensions, api, context, stage, padding; and three times struct_size, extensions, size, types, values,
of which attributes have names between types and values."""
BUFFER = struct.Struct("QQiiQqQ")
"""struct_size, extensions, dtype, padding, data, rank, dims."""
EXTENSION = struct.Struct("QiiQQ")
"""struct_size, kind, padding, next; and of metadata, where they are to be written."""
ERROR_CREATE = 48
"""Where XLA's table of functions has the one that makes an error: after sizes, a version and a pointer."""
API_VERSION = 24 - 8
"""Where metadata, and XLA's table of functions, have the two numbers of a version behind their first two fields."""


_HEAD = "size_t struct_size; XLA_FFI_Extension_Base* extension_start; "
KNOWN = {
    "XLA_FFI_Extension_Base": "size_t struct_size; XLA_FFI_Extension_Type type; struct XLA_FFI_Extension_Base* next;",
    "XLA_FFI_Api_Version": f"{_HEAD}int major_version; int minor_version;",
    "XLA_FFI_Buffer": f"{_HEAD}XLA_FFI_DataType dtype; void* data; int64_t rank; int64_t* dims;",
    "XLA_FFI_Scalar": "XLA_FFI_DataType dtype; void* value;",
    "XLA_FFI_Args": f"{_HEAD}int64_t size; XLA_FFI_ArgType* types; void** args;",
    "XLA_FFI_Rets": f"{_HEAD}int64_t size; XLA_FFI_RetType* types; void** rets;",
    "XLA_FFI_Attrs": f"{_HEAD}int64_t size; XLA_FFI_AttrType* types; XLA_FFI_ByteSpan** names; void** attrs;",
    "XLA_FFI_CallFrame": f"{_HEAD}const XLA_FFI_Api* api; XLA_FFI_ExecutionContext* ctx; "
    "XLA_FFI_ExecutionStage stage; XLA_FFI_Args args; XLA_FFI_Rets rets; XLA_FFI_Attrs attrs;",
    "XLA_FFI_Metadata": "size_t struct_size; XLA_FFI_Api_Version api_version;",
    "XLA_FFI_Metadata_Extension": "XLA_FFI_Extension_Base extension_base; XLA_FFI_Metadata* metadata;",
    "XLA_FFI_Error_Create_Args": f"{_HEAD}const char* message; XLA_FFI_Error_Code errc;",
    "XLA_FFI_Api": f"{_HEAD}XLA_FFI_Api_Version api_version; const XLA_FFI_InternalApi* internal_api; "
    "_XLA_FFI_API_STRUCT_FIELD(XLA_FFI_Error_Create);",
}
"""What the structs begin with; they may grow at their ends."""
RENAMED = {
    "XLA_FFI_InternalExtension_Type": "XLA_FFI_Extension_Type",
    "XLA_FFI_InternalExtension": "XLA_FFI_Extension_Base",
    "XLA_FFI_InvokeContext": "XLA_FFI_ExecutionContext",
}
"""What jaxlib 0.11 and later call the same types."""
LATEST = 32
"""Objects that are kept although nobody has them any more: a program may outlive what it was made of."""
QUIET = 0.2
"""Seconds without a call, and without a busy thread, after which programs count as ended."""
PATIENCE = 60.0
"""Seconds after which threads that are still busy count as others' than programs'."""


class Callee(Protocol):
    """What programs call."""

    def called(self, n: int, out: list[np.ndarray], args: list[np.ndarray]) -> None:
        """Fills the arrays `out` from the arrays `args`, all of which are memory of the program."""

    def forget(self) -> None:
        """Frees what can be made again; called when no user is left."""


_callees: WeakValueDictionary[int, Any] = WeakValueDictionary()
_latest: deque[Any] = deque(maxlen=LATEST)
_users: Counter[int] = Counter()


class _Calls:
    """Calls that go on. At the end of Python no more begin: XLA's threads crash when they call what is torn down."""

    def __init__(self) -> None:
        self.ends, self.last, self.open = False, 0.0, 0
        self._counts = threading.Lock()

    @contextlib.contextmanager
    def one(self) -> Iterator[None]:
        """A call."""
        with self._counts:
            self.open += 1
        try:
            if self.ends:
                raise RuntimeError("Python ends, and so does this program")
            yield
        finally:
            with self._counts:
                self.open, self.last = self.open - 1, time.monotonic()

    def end(self) -> None:
        """Refuses calls, so that programs end, and waits until they have."""
        self.ends = True
        for array in jax.live_arrays("cpu"):
            with contextlib.suppress(Exception):  # an array that is deleted, or of a program that was refused a call
                array.block_until_ready()
        # Programs whose results nobody has are known by their calls, and before their first one by a busy thread.
        began = self.last = time.monotonic()
        while self.open or time.monotonic() - self.last < QUIET:
            time.sleep(0.01)
            if time.monotonic() - began < PATIENCE and _computes():
                self.last = time.monotonic()


def _computes() -> bool:
    """Whether a thread of this process that is not Python's runs or waits for a core; on Linux, else False."""
    own = {thread.native_id for thread in threading.enumerate()}
    for status in Path("/proc/self/task").glob("*/stat"):
        with contextlib.suppress(OSError):  # of a thread that has just ended
            state = status.read_text().rpartition(")")[2].split()[0]
            if state == "R" and int(status.parent.name) not in own:
                return True
    return False


_calls = _Calls()


@cache
def _end_before_python() -> None:
    atexit.register(_calls.end)


C = TypeVar("C", bound=Callee)


def shared(number: int, make: Callable[[], C], user: object) -> C:
    """Returns what calls of a number reach, made if there is none yet.

    Args:
        number: what programs know it by, the same in every process.
        make: makes it; whatever it makes for the same number does the same.
        user: an object that uses it.
    """
    callee = _callees.get(number)
    if callee is None:
        callee = _callees[number] = make()
    _latest.append(callee)
    _users[number] += 1
    weakref.finalize(user, _left, number).atexit = False
    return callee


def _left(number: int) -> None:
    _users[number] -= 1
    if not _users[number] and (callee := _callees.get(number)) is not None:
        callee.forget()


def host_call(number: int, n: int, args: Sequence[jax.Array], results: Sequence[jax.ShapeDtypeStruct]) -> Any:
    """Calls a registered object from traced code; under vmap, once with all rows.

    Args:
        number: of the object, see `shared`.
        n: passed on.
        args: arrays.
        results: shapes and types of what comes back.

    Returns:
        A list of arrays.
    """
    _end_before_python()
    if not is_known():
        return _unkept_call(number, n, args, results)
    _register_target()
    call = jax.ffi.ffi_call(TARGET, list(results), vmap_method="broadcast_all")
    return call(*args, number=np.int64(number), n=np.int64(n))


@cache
def is_known() -> bool:
    """Whether the installed jaxlib's structs, as its header has them, are those that the handler reads."""
    path = Path(jax.ffi.include_dir()) / "xla" / "ffi" / "api" / "c_api.h"
    try:
        text = re.sub(r"\s+", " ", re.sub(r"//[^\n]*", "", path.read_text()))
    except OSError:
        return False
    for new, old in RENAMED.items():
        text = re.sub(rf"\b{new}\b", old, text)
    found = dict(re.findall(r"struct (\w+) \{ (.*?) ?\}", text))
    return all(found.get(name, "").startswith(fields) for name, fields in KNOWN.items())


def _unkept_call(number: int, n: int, args: Sequence[jax.Array], results: Sequence[jax.ShapeDtypeStruct]) -> Any:
    """Calls as `host_call` does, through JAX's own callback."""
    callee = _callees[number]

    def call(_: Any, out: Any, *args: Any) -> None:
        with _calls.one():
            callee.called(n, [np.asarray(x) for x in out], [np.asarray(x) for x in args])

    return buffer_callback(call, list(results), vmap_method="broadcast_all")(*args)


@cache
def _register_target() -> None:
    jax.ffi.register_ffi_target(TARGET, jax.ffi.pycapsule(_handler), platform="cpu")


@ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)
def _handler(at: int) -> int | None:
    """XLA's side: `XLA_FFI_Error* handler(XLA_FFI_CallFrame*)`."""
    frame = FRAME.unpack(ctypes.string_at(at, FRAME.size))
    extension, api, stage = frame[1], frame[2], frame[4]
    try:
        while extension:
            _, kind, _, following, metadata = EXTENSION.unpack(ctypes.string_at(extension, EXTENSION.size))
            if kind == METADATA:
                _tell_version(api, metadata)
                return None
            extension = following
        if stage != EXECUTE:
            return None
        (_, _, n_args, _, args), (_, _, n_rets, _, rets), (_, _, n_attrs, _, _, attrs) = (
            frame[6:11], frame[11:16], frame[16:22],
        )  # fmt: skip
        # Attributes come sorted by name: n, number.
        n, number = (_scalar(p) for p in _pointers(attrs, n_attrs))
        callee = _callees.get(number)
        if callee is None:
            raise RuntimeError("the environment of this program is gone; keep it while its programs run")
        with _calls.one():
            callee.called(n, [_array(p) for p in _pointers(rets, n_rets)], [_array(p) for p in _pointers(args, n_args)])
    except BaseException:
        return _error(api, traceback.format_exc())
    return None


def _pointers(at: int, n: int) -> tuple[int, ...]:
    return struct.unpack(f"{n}Q", ctypes.string_at(at, 8 * n)) if n else ()


def _scalar(at: int) -> int:
    """Reads an attribute that is an int64: a type, and a pointer to the value."""
    return ctypes.c_int64.from_address(ctypes.c_void_p.from_address(at + 8).value or 0).value


def _array(at: int) -> np.ndarray:
    """The memory of a buffer as an array."""
    _, _, dtype, _, data, rank, dims = BUFFER.unpack(ctypes.string_at(at, BUFFER.size))
    shape, kind = struct.unpack(f"{rank}q", ctypes.string_at(dims, 8 * rank)), np.dtype(DTYPES[dtype])
    size = prod(shape) * kind.itemsize
    if not size:
        return np.empty(shape, kind)
    return np.ndarray(shape, kind, (ctypes.c_char * size).from_address(data))


def _tell_version(api: int, metadata: int) -> None:
    """Writes that the handler is of the version that XLA has: the structs it reads only ever grew at their ends."""
    ours = ctypes.c_int64.from_address(metadata + 8 + API_VERSION)
    ours.value = ctypes.c_int64.from_address(api + 16 + API_VERSION).value


def _error(api: int, message: str) -> int:
    """Has XLA make an error."""
    text = ctypes.c_char_p(message.encode())
    args = struct.pack("QQQii", 36, 0, ctypes.cast(text, ctypes.c_void_p).value or 0, INTERNAL, 0)
    make = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)(
        ctypes.c_void_p.from_address(api + ERROR_CREATE).value or 0
    )
    return make(ctypes.cast(ctypes.c_char_p(args), ctypes.c_void_p))
