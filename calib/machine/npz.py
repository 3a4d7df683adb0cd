"""Arrays out of npz files that anybody may have written: nothing in them is ever executed, and no promise believed."""

import io
import math
import re
import zipfile
import zlib
from collections.abc import Collection, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

LARGEST_FILE: Final = 100_000_000
_ENTRY = b"PK\x01\x02"  # begins an entry of a zip's directory; numbers may look like it now and then
_MOST_ENTRIES = 1000
# Numbers of a shape are parted by commas: else a row of digits could be read in endlessly many ways.
_HEADER = re.compile(
    rb"\x93NUMPY\x01\x00..\{'descr': '(?P<dtype>[<|](?:[if][248]|i1|b1|U[1-9][0-9]{0,4}))', 'fortran_order': False, "
    rb"'shape': \((?P<shape>(?:[0-9]{1,12}, ?)*(?:[0-9]{1,12})?)\), \} *\n",
    re.DOTALL,
)
_LONGEST_HEADER = 1000
_HALVES, _LAST_CHARACTER = (0xD800, 0xDFFF), 0x10FFFF
_LARGEST_NUMBER = 1e6


class NotReadableError(ValueError):
    """What is wrong with the contents of a file."""


def arrays_of(data: bytes, keys: Sequence[str], allowed: Collection[str] = ()) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of an npz file that holds these keys and nothing else: integers, numbers, truths, texts.

    ``allowed``: keys that it may hold beside them.
    Raises NotReadableError with the reason.
    """
    if data.count(_ENTRY) > _MOST_ENTRIES:  # before the archive's own list of them takes memory
        raise NotReadableError(f"it must hold {', '.join(keys)} and nothing else")
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = archive.infolist()
            optional = {f"{key}.npy" for key in allowed}
            names = sorted(entry.filename for entry in entries)
            if len(set(names)) < len(names) or sorted({*names} - optional) != sorted(f"{key}.npy" for key in keys):
                raise NotReadableError(f"it must hold {', '.join(keys)} and nothing else")
            if sum(entry.file_size for entry in entries) > LARGEST_FILE:
                raise NotReadableError(f"it unpacks to more than {LARGEST_FILE} bytes")
            if any(entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for entry in entries):
                raise NotReadableError("it is packed in a way that npz files are not")
            return {entry.filename.removesuffix(".npy"): _array(archive.read(entry)) for entry in entries}
    except (zipfile.BadZipFile, zlib.error, ValueError, RuntimeError, EOFError, KeyError, OSError) as e:
        if isinstance(e, NotReadableError):
            raise
        raise NotReadableError("it is not a readable npz file") from e


def _array(data: bytes) -> npt.NDArray[Any]:
    """Return the array of an npy file whose header promises neither objects nor more than there is."""
    # The header is a Python literal; only the one spelling that numpy writes is taken, and nothing is evaluated.
    header = _HEADER.match(data[:_LONGEST_HEADER])
    if header is None:
        raise NotReadableError("an array is not what its header says, or holds no numbers")
    dtype = np.dtype(header["dtype"].decode())
    shape = tuple(int(n) for n in header["shape"].split(b",") if n.strip())
    size = math.prod(shape) * dtype.itemsize
    if header.end() != 10 + int.from_bytes(data[8:10], "little") or size != len(data) - header.end():
        raise NotReadableError("an array is not what its header says, or holds no numbers")
    if not size:
        return np.zeros(shape, dtype)
    array = np.frombuffer(data, dtype=dtype, offset=header.end()).reshape(shape)
    if dtype.kind == "U":
        points = np.frombuffer(data, dtype="<u4", offset=header.end())
        if (((points >= _HALVES[0]) & (points <= _HALVES[1])) | (points > _LAST_CHARACTER)).any():
            raise NotReadableError("a text has a character that is none")
    if dtype.kind == "f" and (np.abs(array) > _LARGEST_NUMBER).any():
        raise NotReadableError(f"a number is beyond {_LARGEST_NUMBER:g}, in metres and radians")
    return array
