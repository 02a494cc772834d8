"""Read PCD files: ascii, binary and binary_compressed (LZF)."""

from __future__ import annotations

import io

import numpy as np

from fullturn.errors import ReadError, one_line
from fullturn.io.raw import Raw
from fullturn.io.text import three_numbers

_KEYS = {"VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS"}
_KINDS = {"F": "f", "I": "i", "U": "u"}


def read_pcd(data: bytes, name: str) -> Raw:
    """Points of a PCD file, in its own order and precision.

    Raises:
        ReadError: not a PCD file, a damaged header, fewer data than the header promises.
    """
    header, encoding, body = _read_header(data, name)
    try:
        fields = [field.lower() for field in header["FIELDS"]]
        counts = [int(c) for c in header.get("COUNT", ["1"] * len(fields))]
        dtypes = [
            np.dtype(f"<{_KINDS[kind]}{size}")
            for kind, size in zip(header["TYPE"], header["SIZE"], strict=True)
        ]
        total = int(header["POINTS"][0]) if "POINTS" in header else _area(header)
        if not len(fields) == len(counts) == len(dtypes) or total < 0 or min(counts) < 1:
            raise ValueError("FIELDS, SIZE, TYPE and COUNT differ in length or hold no count")
        where = [fields.index(axis) for axis in "xyz"]
        if any(counts[i] != 1 for i in where):
            raise ValueError("x, y and z must be single numbers")
    except (KeyError, ValueError, IndexError, TypeError, OverflowError) as error:
        raise ReadError(
            f"{name}: expected a PCD header with FIELDS x y z, SIZE, TYPE and POINTS; found "
            f"a problem with {one_line(error)}; the file is damaged"
        ) from error
    notes: tuple[str, ...] = ()
    if header.get("VIEWPOINT") and three_numbers(" ".join(header["VIEWPOINT"][:3])) != (0, 0, 0):
        notes = (
            f"{name}: its VIEWPOINT isn't used, for files mean several things by it; where the "
            "sensor stood can be told as a viewpoint",
        )
    sizes = [dtype.itemsize * count for dtype, count in zip(dtypes, counts, strict=True)]
    starts = np.cumsum([0, *sizes])
    size = total * int(starts[-1])
    if encoding == "ascii":
        return Raw(_ascii(data[body:], total, where, counts, name), notes=notes)
    if encoding == "binary":
        block = data[body : body + size]
        if len(block) < size:
            raise _truncated(name, total)
        rows = np.frombuffer(block, np.uint8).reshape(total, int(starts[-1]))
        columns = [
            np.ascontiguousarray(rows[:, starts[i] : starts[i + 1]]).view(dtypes[i])[:, 0]
            for i in where
        ]
    else:
        block = _decompress(data[body:], size, name, total)
        # Compressed files hold one field after the other.
        columns = [np.frombuffer(block, dtypes[i], total, total * int(starts[i])) for i in where]
    return Raw(np.column_stack(columns), notes=notes)


def lzf_decompress(data: bytes, size: int) -> bytes:
    """Undo LZF compression (Marc Lehmann's liblzf format) to exactly `size` bytes.

    A control byte below 32 starts a run of that many literals plus one; otherwise its high three
    bits are a length and the rest the high bits of a distance to copy from.

    >>> lzf_decompress(bytes([2]) + b"abc" + bytes([0x20, 2]), 6)
    b'abcabc'

    Raises:
        ValueError: the data are damaged.
    """
    out = bytearray()
    at, end = 0, len(data)
    while at < end and len(out) <= size:
        control = data[at]
        at += 1
        if control < 32:
            out += data[at : at + control + 1]
            at += control + 1
            continue
        length = control >> 5
        if length == 7:
            length += data[at] if at < end else 0
            at += 1
        if at >= end:
            raise ValueError("the compressed data end inside a reference")
        start = len(out) - ((control & 31) << 8) - data[at] - 1
        at += 1
        length += 2
        if start < 0:
            raise ValueError("a reference points before the data")
        chunk = out[start : start + length]
        # A reference may run into what it writes: the chunk then repeats.
        while len(chunk) < length:
            chunk += chunk[: length - len(chunk)]
        out += chunk
    if at > end or len(out) != size:
        raise ValueError(f"{size} bytes were expected, {len(out)} came")
    return bytes(out)


def _read_header(data: bytes, name: str) -> tuple[dict[str, list[str]], str, int]:
    header: dict[str, list[str]] = {}
    at = 0
    while at < len(data) and len(header) <= len(_KEYS):
        end = data.find(b"\n", at)
        line = data[at : end if end >= 0 else len(data)]
        words = line[:4096].decode("latin-1").split()
        at = end + 1 if end >= 0 else len(data)
        if not words or words[0].startswith("#"):
            continue
        key = words[0].upper()
        if key == "DATA" and len(words) == 2:
            encoding = words[1].lower()
            if encoding in ("ascii", "binary", "binary_compressed"):
                return header, encoding, at
        if key == "COLUMNS":  # the older name
            key = "FIELDS"
        if key not in _KEYS:
            raise ReadError(
                f"{name}: expected a PCD header line, found {one_line(repr(line[:20]))}; "
                "check the file or its suffix"
            )
        header[key] = words[1:]
    raise ReadError(f"{name}: the PCD header has no DATA line; the file is truncated")


def _area(header: dict[str, list[str]]) -> int:
    return int(header["WIDTH"][0]) * int(header.get("HEIGHT", ["1"])[0])


def _ascii(body: bytes, total: int, where: list[int], counts: list[int], name: str) -> np.ndarray:
    starts = [int(sum(counts[:i])) for i in where]
    lines = [line for line in body.splitlines() if line.strip()]
    if len(lines) < total:
        raise _truncated(name, total)
    if total == 0:
        return np.zeros((0, 3))
    try:
        text = io.StringIO(b"\n".join(lines[:total]).decode("latin-1"))
        return np.loadtxt(text, usecols=starts, ndmin=2, comments=None)
    except (ValueError, IndexError, OverflowError) as error:
        raise ReadError(
            f"{name}: cannot read the PCD points: {one_line(error)}; it is damaged or truncated"
        ) from error


def _decompress(body: bytes, size: int, name: str, total: int) -> bytes:
    if len(body) < 8:
        raise _truncated(name, total)
    packed, unpacked = (int(n) for n in np.frombuffer(body, "<u4", 2))
    if len(body) < 8 + packed or unpacked != size:
        raise _truncated(name, total)
    try:
        return lzf_decompress(body[8 : 8 + packed], size)
    except ValueError as error:
        raise ReadError(f"{name}: the compressed PCD data are damaged: {error}") from error


def _truncated(name: str, total: int) -> ReadError:
    return ReadError(
        f"{name}: expected {total} points in the PCD file, its data have another length; "
        "it is truncated or damaged, so save or copy it again"
    )
