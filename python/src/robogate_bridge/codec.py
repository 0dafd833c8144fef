"""Encodes, checks and decodes headers. Contains the limits of the protocol."""

from math import isfinite

import msgpack

VERSION = 3
MAX_HEADER = 4 << 20
MAX_MESSAGE = 64 << 20
MAX_NESTING = 16
MAX_STRING = 4096
MAX_ENTRIES = 65_536
MAX_ACTIONS = 256
MAX_JOINTS = 32
MAX_CAMERAS = 16
MAX_PARAMETERS = 256
MAX_NUMBERS = 4096
MAX_TICKS = 1_000_000
MAX_SIGHTS = 4096
MAX_PIXELS = 4096
MAX_NUMBER = 2**64 - 1


class Malformed(ValueError):
    """Bytes that are not a valid header."""


def encode(header):
    """Encodes a header."""
    data = msgpack.packb(header, use_bin_type=True)
    if len(data) > MAX_HEADER:
        raise Malformed(f"the header has {len(data)} bytes; at most {MAX_HEADER} are allowed")
    return data


def decode(data):
    """Decodes a header and checks it against the limits."""
    if len(data) > MAX_HEADER:
        raise Malformed(f"the header has {len(data)} bytes; at most {MAX_HEADER} are allowed")
    try:
        header = msgpack.unpackb(
            data,
            raw=False,
            strict_map_key=True,
            max_str_len=MAX_STRING,
            max_bin_len=0,
            max_ext_len=0,
            max_array_len=MAX_ENTRIES,
            max_map_len=MAX_ENTRIES,
        )
    except Exception as why:  # the errors of msgpack have no common base class
        raise Malformed(f"the header is not MessagePack within the limits: {why}") from why
    if not isinstance(header, dict):
        raise Malformed("the header is not a map")
    _look(header, 1, "")
    return header


def _look(value, depth, where):
    if isinstance(value, float):
        if not isfinite(value):
            raise Malformed(f"{where or 'a number'} is not finite")
    elif isinstance(value, dict):
        if depth > MAX_NESTING:
            raise Malformed(f"{where} is nested more than {MAX_NESTING} levels deep")
        for key, item in value.items():
            if not isinstance(key, str):
                raise Malformed(f"a key of {where or 'the header'} is not a string")
            if not isinstance(item, (str, int)):
                _look(item, depth + 1, f"{where}.{key}" if where else key)
    elif isinstance(value, list):
        if depth > MAX_NESTING:
            raise Malformed(f"{where} is nested more than {MAX_NESTING} levels deep")
        for i, item in enumerate(value):
            if not isinstance(item, (str, int)):
                _look(item, depth + 1, f"{where}[{i}]")
    elif isinstance(value, (bytes, msgpack.ExtType, msgpack.Timestamp)):
        raise Malformed(f"{where} is binary")
