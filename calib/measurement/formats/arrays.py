"""Arrays in NumPy's archive (.npz) or a MATLAB file: one after the other, rows of as many as most of them have."""

import contextlib
import io
import math
import struct
import sys
import tokenize
import warnings
import zipfile
import zlib
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import scipy

from calib.foundations import rigid
from calib.foundations.errors import MeasurementError
from calib.foundations.files import DAMAGED
from calib.foundations.words import counted, listed, noun, shown
from calib.measurement.cells import MOST_COLUMNS, Rows
from calib.measurement.layout import of_list, refuse_long_name

# Of the archive unpacked.
_LARGEST = 200_000_000
# A megabyte of zeros unpacks to all that is allowed above, and each of them becomes a word.
_MOST_VALUES = 4_000_000
# Of one pose: a matrix of 4 by 4, and a quaternion.
_LARGEST_OF_RECORD, _LONGEST_STANDING = 16, 4
# Beside the matrix of a camera: a figure, the size of an image, and the distortion as OpenCV has it.
_OF_A_LENS = frozenset((1, 2, 4, 5, 8, 12, 14))
# By how much a matrix that was stored in single precision is off a rotation.
_AT_RIGHT_ANGLES = 1e-5
# Focal lengths in px; a rotation has no element above 1.
_SHORTEST = 2.0
# Of MATLAB's kinds those that are matrices of numbers, and its mark of a packed element.
_OF_NUMBERS = frozenset(("double", "single", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))))
_PACKED = 15
_OBJECT = 17
# Its classes of matrices of numbers, the mark of one with imaginary parts, and the types that numbers are stored as.
_MATRICES, _COMPLEX = range(6, 16), 0x800
_STORED_AS = frozenset((1, 2, 3, 4, 5, 6, 7, 9, 12, 13))
# Of an element, what holds its class, dimensions and name.
_HEAD = 300
_MOST_AXES = 3
# Of an array in an archive, what says its kind and shape: some hundred characters. NumPy takes it apart as Python.
_LONGEST_HEADER = 1000


def from_npz(data: bytes, where: str) -> Rows:
    """Return titles and cells of arrays (N,), (N, k) or (N, i, j), and remarks; N is the length that most arrays share.

    The columns of an array ``q`` are ``q_0``, ``q_1``, ..., those of a point (N, 3) ``p_x``, ``p_y``, ``p_z``, those of
    matrices ``T_0_3``. Other arrays, and such as hold neither numbers nor words, are left out, and said.
    """
    held = held_in_npz(data, where)
    arrays = {name: array for name, array in held.items() if array is not None and array.ndim > 0}
    return _as_columns(arrays, list(held), where)


def held_in_npz(data: bytes, where: str) -> Mapping[str, npt.NDArray[np.generic] | None]:
    """Return the arrays of an archive, with at most three dimensions; None for what holds neither numbers nor words.

    Raises MeasurementError where it cannot be read, or unpacks to more than 200 MB.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(member.file_size for member in archive.infolist())
        if size > _LARGEST:
            raise MeasurementError(f"{where}: unpacks to more than {_LARGEST} bytes.")
        with np.load(io.BytesIO(data), allow_pickle=False, max_header_size=_LONGEST_HEADER) as held:
            return {name: _readable(held, name) for name in dict.fromkeys(held.files)}
    except MeasurementError:
        raise
    except (zipfile.BadZipFile, tokenize.TokenError, *DAMAGED) as e:
        raise MeasurementError(f"{where}: is no archive of arrays that can be read.") from e


def from_mat(data: bytes, where: str) -> Rows:
    """Return titles and cells of the matrices of a MATLAB file, as :func:`from_npz` does; not of cells and structs.

    Of matrices along a third dimension, as of placements (4, 4, N), this counts the rows. MATLAB 7.3 writes HDF5, which
    is refused.
    """
    if len(data) > _LARGEST or _unpacked(data) > _LARGEST:
        raise MeasurementError(f"{where}: unpacks to more than {_LARGEST} bytes.")
    data, objects = _without_objects(data)
    try:
        with warnings.catch_warnings(action="ignore"):  # of names that come twice, and what it passes over
            held = scipy.io.whosmat(file := cast(Any, io.BytesIO(data)))
            names = list(dict.fromkeys(name for name, *_ in held))
            plain = [name for name, _, kind in held if kind in _OF_NUMBERS]
            numbers = frozenset(plain)
            if sum(math.prod(shape) for name, shape, _ in held if name in numbers) > _MOST_VALUES:
                raise MeasurementError(f"{where}: has more than {_MOST_VALUES} values.")
            if not all(_is_typed(kind, inside, _order(data)) for kind, _, inside in _elements(data)):
                raise MeasurementError(f"{where}: is no file of MATLAB that can be read.")
            read = scipy.io.loadmat(file, variable_names=plain) if plain else {}
    except MeasurementError:
        raise
    except NotImplementedError as e:
        raise MeasurementError(
            f"{where}: is of MATLAB 7.3, which is not read; save it there with the option -v7."
        ) from e
    except (scipy.io.matlab.MatReadError, *DAMAGED) as e:
        raise MeasurementError(f"{where}: is no file of MATLAB that can be read.") from e
    arrays = {}
    for name in plain:
        array = np.asarray(read.get(name, ()))
        if array.dtype.kind in "iuf" and array.ndim in (2, 3) and array.size:
            arrays[name] = np.moveaxis(array, 2, 0) if array.ndim == 3 else array.ravel() if 1 in array.shape else array
    structs = [name for name, _, kind in held if kind == "struct"]
    # A rate, or the matrix of a camera, beside these is not what was measured.
    has_rows = any(array.size > 1 for array in arrays.values()) and not _only_a_lens(arrays)
    if structs and not has_rows and not objects:
        raise MeasurementError(
            f"{where}: {listed(structs)} {noun(len(structs), 'is a struct', 'are structs')} of MATLAB, and not read; "
            f"write {noun(len(structs), 'it', 'each')} there as text: writetable(struct2table({structs[0]}), "
            f"'{structs[0]}.csv')."
        )
    if objects and not has_rows:
        raise MeasurementError(
            f"{where}: {listed(objects)} {noun(len(objects), 'is an object', 'are objects')} of MATLAB, such as a "
            f"table, and not read; save {noun(len(objects), 'it', 'them')} there as matrices, as table2array makes "
            "them, or by writetable as text."
        )
    return _as_columns(arrays, [*names, *objects], where)


def _unpacked(data: bytes) -> int:
    """Return how many bytes the packed elements of a MATLAB file have together, as far as it matters."""
    size = 0
    for kind, _, inside in _elements(data):
        if kind == _PACKED:
            size += len(_beginning(inside, _LARGEST + 1 - size))
        if size > _LARGEST:
            break
    return size


def _elements(data: bytes) -> Iterator[tuple[int, memoryview, memoryview]]:
    """Yield the elements of a MATLAB file: the kind of each, all its bytes, and those inside; of MATLAB 4 none."""
    view, at = memoryview(data), 128
    if 0 in data[:4]:
        return
    while at + 8 <= len(view):
        kind, count = struct.unpack_from(f"{_order(data)}II", view, at)
        yield kind, view[at : at + 8 + count], view[at + 8 : at + 8 + count]
        at += 8 + count


def _order(data: bytes) -> str:
    return "<" if data[126:128] == b"IM" else ">"


def _beginning(packed: memoryview, most: int) -> bytes:
    with contextlib.suppress(zlib.error):  # what is damaged is said where it is read
        return zlib.decompressobj().decompress(packed, most)
    return b""


def _inside(kind: int, inside: memoryview, most: int) -> bytes:
    """Return what is inside an element, unpacked: as many bytes of it at most."""
    return _beginning(inside, 8 + most)[8:] if kind == _PACKED else bytes(inside[:most])


def _without_objects(data: bytes) -> tuple[bytes, list[str]]:
    """Return a MATLAB file without objects and what has no name, where these keep their values; and their names.

    SciPy lists nothing of a file that has an object, such as a table.
    """
    names: list[str] = []
    others: list[memoryview] = []
    for kind, whole, inside in _elements(data):
        is_object, name = _class_and_name(_inside(kind, inside, _HEAD), _order(data))
        if is_object:
            names.append(name or "?")
        elif name != "":
            others.append(whole)
    return (b"".join([data[:128], *others]), names) if names else (data, [])


def _class_and_name(head: bytes, order: str) -> tuple[bool, str | None]:
    """Return whether a matrix is an object, and its name; None where it cannot be told."""
    try:
        is_object = struct.unpack_from(f"{order}I", head, 8)[0] & 0xFF == _OBJECT
        at = 16
        if not is_object:  # dimensions come before the name
            *_, at = _tag(head, at, order)
        _, begin, size, _ = _tag(head, at, order)
    except struct.error:
        return False, None
    return is_object, head[begin : begin + size].decode("latin-1")


def _tag(data: bytes, at: int, order: str) -> tuple[int, int, int, int]:
    """Return of the element at a byte its type, where its bytes begin, how many they are, and where the next one is."""
    word, size = struct.unpack_from(f"{order}II", data, at)
    # Few bytes are packed into one word of their own.
    if word >> 16:
        return word & 0xFFFF, at + 4, word >> 16, at + 8
    return word, at + 8, size, at + 8 + -(-size // 8) * 8


def _is_typed(kind: int, inside: memoryview, order: str) -> bool:
    """Return whether the numbers of an element, if they are what it holds, are stored as a type of numbers.

    SciPy looks up the type in a table without an end, and takes what is there for memory of its own.
    """
    head = _inside(kind, inside, _HEAD)
    try:
        (flags,) = struct.unpack_from(f"{order}I", head, 8)
        if flags & 0xFF not in _MATRICES:
            return True
        at = 16
        for _ in range(2):  # dimensions and name
            *_, at = _tag(head, at, order)
        stored, _, _, after = _tag(head, at, order)
        if flags & _COMPLEX and stored in _STORED_AS:
            stored, *_ = _tag(_inside(kind, inside, _LARGEST), after, order)
    except struct.error:
        return False
    return stored in _STORED_AS


def _as_columns(arrays: Mapping[str, npt.NDArray[np.generic]], names: Sequence[str], where: str) -> Rows:
    if lens := _only_a_lens(arrays):
        raise MeasurementError(
            f"{where}: {shown(lens)} is the matrix of a camera, with nothing that was measured beside it; a job takes "
            "the numbers of a lens as fx, fy, cx, cy, k1 and so on, or an .npz, or the YAML of OpenCV, ROS or Kalibr, "
            "as lens_file."
        )
    if _are_one_record(arrays.values()):
        return _as_record(arrays, names, where)
    arrays, turned = _upright({name: _without_single_axis(array) for name, array in arrays.items()})
    counts = Counter(len(array) for array in arrays.values())
    if not counts:
        raise MeasurementError(f"{where}: holds no arrays of numbers or words, with a row for every measurement.")
    rows = max(counts, key=lambda count: (counts[count], count))
    taken = {name: array for name, array in arrays.items() if len(array) == rows}
    width = sum(array.size // rows for array in taken.values())
    if width > MOST_COLUMNS:
        raise MeasurementError(f"{where}: has {width} columns; allowed are {MOST_COLUMNS}.")
    if width * rows > _MOST_VALUES:
        raise MeasurementError(f"{where}: has {width * rows} values; allowed are {_MOST_VALUES}.")
    for name in taken:
        refuse_long_name(name, where)
    columns = [column for name, array in taken.items() for column in _columns(name, array)]
    left = [name for name in names if name not in taken]
    what = "is no array" if len(left) == 1 else "are no arrays"
    said = [f"the columns of {listed(turned)} are the rows"] if turned and turned[0] in taken else []
    said += [f"{listed(left)} {what} of numbers or words with {counted(rows, 'row')}, and left out"] if left else []
    return [title for title, _ in columns], list(zip(*(cells for _, cells in columns), strict=True)), tuple(said)


def _upright(
    arrays: Mapping[str, npt.NDArray[np.generic]],
) -> tuple[Mapping[str, npt.NDArray[np.generic]], list[str]]:
    """Return arrays with a row for every measurement, and the names of those that had a column for each.

    As of readings (6, N) beside points (3, N), or times (N,): more arrays have N rows then than matrices are as long as
    they are, none of these has N already, and N is twice as long as any other or more. Limits (2, 6) of joints are not
    turned beside readings (N, 6), nor a few rows for each of two runs, nor images.
    """
    lengths = Counter(len(array) for array in arrays.values() if array.ndim > 1)
    most = max(lengths.values(), default=0)
    wide = {name: array.shape[1] for name, array in arrays.items() if array.ndim == 2 and array.shape[1] > len(array)}
    for count in dict.fromkeys(wide.values()):
        lying = [name for name, own in wide.items() if own == count]
        beside = [array for array in arrays.values() if len(array) == count]
        longest = max(length for length in lengths if length != count)
        if count >= 2 * longest and all(array.ndim != 2 for array in beside) and len(lying) + len(beside) > most:
            return {name: array.T if name in lying else array for name, array in arrays.items()}, lying
    return arrays, []


def _only_a_lens(arrays: Mapping[str, npt.NDArray[np.generic]]) -> str | None:
    """Return the name of a camera's matrix where all else is the distortion, the size of an image, or a figure."""
    matrices = [name for name, array in arrays.items() if _is_of_a_camera(array)]
    others = [array for name, array in arrays.items() if name not in matrices[:1]]
    fits = all(array.size in _OF_A_LENS and array.size == max(array.shape) for array in others)
    return matrices[0] if matrices and fits else None


def _is_of_a_camera(array: npt.NDArray[np.generic]) -> bool:
    """Return whether a matrix is fx, 0, cx; 0, fy, cy; 0, 0, 1, in px."""
    if array.shape != (3, 3) or array.dtype.kind not in "iuf":
        return False
    K = array.astype(np.float64)
    return bool(np.all(K[[1, 2, 2, 2], [0, 0, 1, 2]] == (0.0, 0.0, 0.0, 1.0)) and min(K[0, 0], K[1, 1]) > _SHORTEST)


def _are_one_record(arrays: Collection[npt.NDArray[np.generic]]) -> bool:
    """Return whether small arrays are the vectors and matrices of one pose, and no columns.

    They are if their lengths differ and no two share one that is longer than a quaternion; if they are vectors that
    stand (3, 1), as OpenCV has them, alone or beside matrices; or if one of them is the matrix of a rotation.
    """
    if not arrays or any(array.ndim > 2 or array.size > _LARGEST_OF_RECORD for array in arrays):
        return False
    lengths = Counter(map(len, arrays))
    if len(lengths) > 1:
        return all(count == 1 for length, count in lengths.items() if length > _LONGEST_STANDING)
    if any(map(_is_rotation, arrays)):
        return all(array.shape in ((3, 3), (3,), (3, 1)) for array in arrays)
    standing = [array for array in arrays if array.shape[1:] == (1,)]
    others = [array for array in arrays if array.shape[1:] != (1,)]
    return bool(standing) and max(lengths) in (3, 4) and all(array.shape[1:] in ((3,), (4,)) for array in others)


def _is_rotation(array: npt.NDArray[np.generic]) -> bool:
    """Return whether a matrix is that of a rotation: three rows of other columns are not at right angles by chance."""
    numbers = array.shape == (3, 3) and array.dtype.kind in "iuf"
    return numbers and bool(rigid.are_rotations(array[None].astype(np.float64), _AT_RIGHT_ANGLES)[0])


def _as_record(arrays: Mapping[str, npt.NDArray[np.generic]], names: Sequence[str], where: str) -> Rows:
    """Return titles and cells of arrays that are one row."""
    for name in arrays:
        refuse_long_name(name, where)
    every = {name: _without_single_axis(array[np.newaxis]) for name, array in arrays.items()}
    columns = [column for name, array in every.items() for column in _columns(name, array)]
    left = [name for name in names if name not in arrays]
    said = ["the arrays are those of one pose, and one row"]
    said += [f"{listed(left)} {'is' if len(left) == 1 else 'are'} left out"] if left else []
    return [title for title, _ in columns], [[cells[0] for _, cells in columns]], tuple(said)


def _without_single_axis(array: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
    """Return rows of vectors that stand (N, 3, 1), or lie (N, 1, 3), as rows (N, 3)."""
    return array.reshape(len(array), -1) if array.ndim == 3 and 1 in array.shape[1:] else array


def _readable(held: "np.lib.npyio.NpzFile", name: str) -> npt.NDArray[np.generic] | None:
    """Return an array of numbers or words; None for one of objects, which would run code of the file, and others."""
    try:
        array = np.asarray(held[name])
    except ValueError:
        return None
    if array.dtype.kind not in "iufU" or array.ndim > _MOST_AXES or not array.size or not _are_words(array):
        return None
    return array


def _are_words(array: npt.NDArray[np.generic]) -> bool:
    """Return whether words are of characters: of other numbers NumPy makes strings that Python cannot have."""
    if array.dtype.kind != "U" or not array.dtype.itemsize:
        return True
    numbers = np.frombuffer(array.astype(array.dtype.newbyteorder("=")).tobytes(), dtype=np.uint32)
    return bool(numbers.max() <= sys.maxunicode)


def _columns(name: str, array: npt.NDArray[np.generic]) -> Iterator[tuple[str, list[str]]]:
    if array.ndim == 1:
        yield name, _cells(array)
    elif array.ndim == 2:
        count = array.shape[1]
        titles = of_list(name, count) if array.dtype.kind == "f" else [f"{name}_{k}" for k in range(count)]
        for k, title in enumerate(titles):
            yield title, _cells(array[:, k])
    else:
        for i, j in np.ndindex(array.shape[1], array.shape[2]):
            yield f"{name}_{i}_{j}", _cells(array[:, i, j])


def _cells(values: npt.NDArray[np.generic]) -> list[str]:
    cells: Iterable[str] = map(str, values.tolist())
    if values.dtype.kind == "U":
        cells = (" ".join(cell.split())[:200] for cell in cells)
    # Small archives hold large arrays of few values: each is one text, however often it comes.
    return ["" if cell == "nan" else sys.intern(cell) for cell in cells]
