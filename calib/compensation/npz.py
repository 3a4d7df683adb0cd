"""Arrays out of npz files that anybody may have written: nothing in them is ever executed, and no promise believed."""

import io
import zipfile
import zlib
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

LARGEST_FILE: Final = 1_000_000_000


class NotReadableError(ValueError):
    """What is wrong with the contents of a file."""


def arrays_of(data: bytes, keys: Sequence[str]) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of an npz file that holds these keys and nothing else: integers, numbers, truths, texts.

    Raises NotReadableError with the reason.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = archive.infolist()
            if sorted(entry.filename for entry in entries) != sorted(f"{key}.npy" for key in keys):
                raise NotReadableError(f"it must hold {', '.join(keys)} and nothing else")
            if sum(entry.file_size for entry in entries) > LARGEST_FILE:
                raise NotReadableError(f"it unpacks to more than {LARGEST_FILE} bytes")
            return {entry.filename.removesuffix(".npy"): _array(archive.read(entry)) for entry in entries}
    except (zipfile.BadZipFile, zlib.error, ValueError, RuntimeError, EOFError, KeyError, OSError) as e:
        if isinstance(e, NotReadableError):
            raise
        raise NotReadableError("it is not a readable npz file") from e


def _array(data: bytes) -> npt.NDArray[Any]:
    """Return the array of an npy file whose header promises neither objects nor more than there is."""
    stream = io.BytesIO(data)
    if np.lib.format.read_magic(stream) != (1, 0):
        raise NotReadableError("its arrays are of another version")
    shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
    size = dtype.itemsize
    for n in shape:
        size *= n
    if dtype.kind not in "ifbU" or fortran or size != len(data) - stream.tell():
        raise NotReadableError("an array is not what its header says, or holds no numbers")
    return np.frombuffer(data, dtype=dtype, offset=stream.tell(), count=-1).reshape(shape) if size else np.zeros(shape)
