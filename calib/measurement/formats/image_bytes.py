"""What the bytes of an image say before it is unpacked: how many pixels it has, which way up, in how many passes."""

import contextlib
import re
import struct
from collections.abc import Iterator
from typing import NamedTuple

# TIFF and BigTIFF by their first bytes: byte order, type of an offset and of the number of entries, bytes of an entry.
_TIFF = {b"II*\0": ("<", "I", "H", 12), b"MM\0*": (">", "I", "H", 12)}
_TIFF |= {b"II+\0": ("<", "Q", "Q", 20), b"MM\0+": (">", "Q", "Q", 20)}
_WIDTH, _HEIGHT, _ORIENTATION = 256, 257, 274
# Whole numbers by the number of their type.
_TYPES = {1: "B", 3: "H", 4: "I", 16: "Q"}
# The first bytes of a JPEG, and of its image; bytes that may stand between its segments: no segment is as short.
_JPEG, _SCAN, _MOST_PADS, _MOST_SEGMENTS = b"\xff\xd8", b"\xff\xda", 3, 1000
# A marker as libjpeg finds the next one; markers of no segment, and of those that say the size.
_MARKER = re.compile(rb"\xff+([^\x00\xff])", re.DOTALL)
_ALONE, _FRAMES = {0x01, *range(0xD0, 0xD9)}, {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
# A photograph comes in a dozen passes at most; a film behind it has these two bytes once in 65 536 by chance.
_FEW_PASSES, _BYTES_OF_A_PASS = 100, 10_000
_PNG, _BMP = b"\x89PNG\r\n\x1a\n", b"BM"
_PNM = re.compile(rb"P[1-6](?:\s|#[^\n\r]*[\n\r])+([0-9]{1,9})(?:\s|#[^\n\r]*[\n\r])+([0-9]{1,9})\s")
_LONGEST_PNM = 10_000


class _Entry(NamedTuple):
    tag: int
    order: str
    kind: int
    place: int  # where its value is


def pixels_of(data: bytes) -> tuple[int, int] | None:
    """Return width and height that a PNG, JPEG, BMP, TIFF, WebP or PGM says it has, and None for anything else.

    OpenCV reads other kinds as well, of which some bytes unpack to gigabytes.
    """
    with contextlib.suppress(struct.error, OverflowError):  # damaged
        if data.startswith(_PNG):
            return _pair(">II", data, 16)
        if data.startswith(_JPEG):
            return _of_jpeg(data)
        if data.startswith(_BMP):
            old = struct.unpack_from("<I", data, 14) == (12,)
            return _pair("<HH" if old else "<ii", data, 18)
        if data[:4] in _TIFF:
            return _of_tiff(data)
        if data.startswith(b"RIFF") and data[8:12] == b"WEBP":
            return _of_webp(data)
        if found := _PNM.match(data[:_LONGEST_PNM]):
            return int(found[1]), int(found[2])
    return None


def many_passes(data: bytes) -> bool:
    """Return whether a JPEG goes over its pixels more often than any photograph, each time for a few bytes."""
    return data.startswith(_JPEG) and data.count(_SCAN) > max(_FEW_PASSES, len(data) // _BYTES_OF_A_PASS)


def unpadded(data: bytes) -> bytes:
    """Return a JPEG without the bytes that some cameras put between its segments, before the image; others as they are.

    OpenCV reads such an image soundly, says of it what it says of a damaged one, and of other damage then nothing.
    """
    kept = [_JPEG]
    at = len(_JPEG) if data.startswith(_JPEG) else len(data)
    for _ in range(_MOST_SEGMENTS):
        begins = data.find(0xFF, at, at + _MOST_PADS + 1)
        length = int.from_bytes(data[begins + 2 : begins + 4], "big")
        if begins < 0 or length < 2 or data[begins + 1] in (0, 0xFF):
            return data
        at = begins + 2 + length
        kept.append(data[begins:at])
        if kept[-1].startswith(_SCAN):
            return b"".join([*kept, data[at:]])
    return data


def unturned(data: bytes) -> bytes:
    """Return a TIFF whose first image asks for no turn, which OpenCV obeys whatever it is told; others as they are."""
    for tag, order, kind, place in _entries(data):
        if (tag, _TYPES.get(kind)) == (_ORIENTATION, "H"):
            return data[:place] + struct.pack(order + "H", 1) + data[place + 2 :]
    return data


def _pair(form: str, data: bytes, at: int) -> tuple[int, int]:
    width, height = struct.unpack_from(form, data, at)
    return abs(width), abs(height)


def _of_jpeg(data: bytes) -> tuple[int, int] | None:
    at = len(_JPEG)
    while found := _MARKER.search(data, at):
        at, marker = found.end(), found[1][0]
        if marker in _FRAMES:
            height, width = _pair(">HH", data, at + 3)
            return width, height
        if marker not in _ALONE:
            at += max(int.from_bytes(data[at : at + 2], "big"), 2)
    return None


def _of_webp(data: bytes) -> tuple[int, int] | None:
    if data[12:16] == b"VP8 ":
        width, height = _pair("<HH", data, 26)
        return width & 0x3FFF, height & 0x3FFF
    if data[12:16] == b"VP8L":
        (packed,) = struct.unpack_from("<I", data, 21)
        return (packed & 0x3FFF) + 1, (packed >> 14 & 0x3FFF) + 1
    if data[12:16] == b"VP8X" and len(data) >= 30:
        return int.from_bytes(data[24:27], "little") + 1, int.from_bytes(data[27:30], "little") + 1
    return None


def _of_tiff(data: bytes) -> tuple[int, int] | None:
    sides: dict[int, int] = {}
    for tag, order, kind, place in _entries(data):
        if tag in (_WIDTH, _HEIGHT) and kind in _TYPES:
            (value,) = struct.unpack_from(order + _TYPES[kind], data, place)
            sides[tag] = max(value, sides.get(tag, 0))
    return (sides[_WIDTH], sides[_HEIGHT]) if len(sides) == 2 else None


def _entries(data: bytes) -> Iterator[_Entry]:
    """Give the entries of the first image of a TIFF, up to where it is damaged: the reader of images says that."""
    if data[:4] not in _TIFF:
        return
    order, at, of_count, entry = _TIFF[data[:4]]
    with contextlib.suppress(struct.error, OverflowError):
        (first,) = struct.unpack_from(order + at, data, struct.calcsize(at))
        (entries,) = struct.unpack_from(order + of_count, data, first)
        start = first + struct.calcsize(of_count)
        for place in range(start, start + entry * entries, entry):
            tag, kind = struct.unpack_from(order + "HH", data, place)
            yield _Entry(tag, order, kind, place + 4 + struct.calcsize(at))
