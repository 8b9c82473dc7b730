"""Arrays out of npz files that others made: no pickle, nothing allocated that the file holds not.

``numpy.load`` believes a member's header and inflates whatever is compressed: a megabyte of such a
file fills the memory of a machine.
"""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections.abc import Iterable
from math import prod
from typing import Any

import numpy as np
from numpy.lib import format as npy

SUFFIX = ".npy"
MAX_DIRECTORY = 2**18
"""Bytes of the list of members, 3,000 of them: a list of 150,000 is read for three seconds"""
_END = struct.Struct("<4s4H2LH")
"""A zip file's last record: its signature, four counts, the list's size and place, a comment's"""
_LARGE = b"PK\x06\x07"
"""Before it, where the list's size is told elsewhere"""


def read_npz(
    content: bytes,
    names: Iterable[str] | None = None,
    *,
    most_bytes: int,
    compressed: bool = False,
) -> dict[str, Any]:
    """Arrays by their names; of all members, or of those that must be there.

    Parameters
    ----------
    most_bytes : int
        Of all of them together.
    compressed : bool
        Whether members may be deflated.

    Raises
    ------
    ValueError
        If this is no such file, or a member is not exactly as large as its header says.
    """
    kinds = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED} if compressed else {zipfile.ZIP_STORED}
    _check_directory(content)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            if names is None:
                entries = archive.infolist()
            else:
                entries = [archive.getinfo(name + SUFFIX) for name in names]
            if sum(entry.file_size for entry in entries) > most_bytes:
                raise ValueError(f"the arrays have more than {most_bytes} bytes")
            if not all(entry.compress_type in kinds for entry in entries):
                raise ValueError("an array is compressed")
            return {
                entry.filename.removesuffix(SUFFIX): _array(archive.read(entry))
                for entry in entries
            }
    # RuntimeError: an encrypted member.
    except (zipfile.BadZipFile, zlib.error, KeyError, EOFError, RuntimeError) as error:
        raise ValueError(f"no npz file: {error}") from error


def _check_directory(content: bytes) -> None:
    """Raise ValueError where listing the members would take long, or the file ends otherwise."""
    if len(content) < _END.size:
        raise ValueError("no npz file: it is too short")
    signature, *_, size, _, comment = _END.unpack(content[-_END.size :])
    if signature != b"PK\x05\x06" or comment or size > MAX_DIRECTORY or _LARGE in content[-42:-38]:
        raise ValueError("no npz file: it ends with no list of few members")


def _array(member: bytes) -> Any:
    data = io.BytesIO(member)
    if npy.read_magic(data) != (1, 0):
        raise ValueError("an array has another header")
    shape, fortran, dtype = npy.read_array_header_1_0(data)
    if dtype.hasobject or len(member) - data.tell() != prod(shape) * dtype.itemsize:
        raise ValueError(f"an array of {dtype} and shape {shape} has another size")
    values = np.frombuffer(member, dtype, offset=data.tell())
    return values.reshape(shape, order="F" if fortran else "C")
