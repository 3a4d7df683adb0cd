"""Files for ``calib import`` that are filled with one thing to a size in bytes, for ``hostile_files.py``."""

import io
import json
import struct
import zipfile
import zlib
from collections.abc import Callable

import numpy as np

Fill = Callable[[int], bytes]
_TAKE = "Format Version,1.23,Take Name,T,Rotation Type,Quaternion,Length Units,Meters\n\n"
_VICON = "Trajectories\n100\n,,arm:a,,,arm:b,,\nFrame,Sub Frame,X,Y,Z,X,Y,Z\n,,mm,mm,mm,mm,mm,mm\n"
_QUALISYS = "NO_OF_FRAMES\t9\nNO_OF_MARKERS\t2\nFREQUENCY\t100\nMARKER_NAMES\ta\tb\na X\ta Y\ta Z\tb X\tb Y\tb Z\n"
_FIRST_MATRIX = "1 0 0 5\n0 1 0 6\n0 0 1 7\n0 0 0 1\n"
_POINT = "float64 x\nfloat64 y\nfloat64 z"
# Of SpreadsheetML.
_MAIN = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
_OFFICE = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
_PACKAGE = "http://schemas.openxmlformats.org/package/2006"
_KIND = "application/vnd.openxmlformats-officedocument.spreadsheetml"


def _text(piece: Callable[[int], str], head: str = "", tail: str = "") -> Fill:
    def filled(size: int) -> bytes:
        pieces, length, k = [head], len(head) + len(tail), 0
        while k == 0 or length <= size:
            pieces.append(piece(k))
            length, k = length + len(pieces[-1]), k + 1
        return "".join([*pieces, tail]).encode()

    return filled


def _archive(parts: dict[str, bytes]) -> bytes:
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in parts.items():
            archive.writestr(name, data)
    return held.getvalue()


# Arrays. ---------------------------------------------------------------------------------------------------------


def _header(text: bytes) -> bytes:
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


def _shape(shape: bytes, kind: bytes = b"'<f8'") -> bytes:
    return _header(b"{'descr': " + kind + b", 'fortran_order': False, 'shape': (" + shape + b"), }\n")


def _array(array: np.ndarray) -> bytes:
    held = io.BytesIO()
    np.save(held, array)
    return held.getvalue()


def _arrays(each: bytes, bytes_of_one: int) -> Fill:
    return lambda size: _archive({f"a{k}.npy": each for k in range(size // bytes_of_one)})


def _element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def _matrix(name: str, rows: int, columns: int, data: bytes) -> bytes:
    head = _element(6, struct.pack("<II", 6, 0)) + _element(5, struct.pack("<2i", rows, columns))
    return _element(14, head + _element(1, name.encode()) + _element(9, data))


def _packed(data: bytes) -> bytes:
    small = zlib.compress(data, 9)
    return struct.pack("<II", 15, len(small)) + small


def _matlab(elements: Callable[[int], bytes]) -> Fill:
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<HH", 0x0100, 0x4D49)
    return lambda size: head + elements(size)


# Workbooks. ------------------------------------------------------------------------------------------------------


def _workbook(sheet: str, count: int = 1) -> bytes:
    every = range(count)
    override = "".join(
        f'<Override PartName="/xl/worksheets/s{k}.xml" ContentType="{_KIND}.worksheet+xml"/>' for k in every
    )
    relations = "".join(
        f'<Relationship Id="r{k}" Type="{_OFFICE}/worksheet" Target="worksheets/s{k}.xml"/>' for k in every
    )
    sheets = "".join(f'<sheet name="s{k}" sheetId="{k + 1}" r:id="r{k}"/>' for k in every)
    parts = {
        "[Content_Types].xml": f'<Types xmlns="{_PACKAGE}/content-types"><Default Extension="rels" '
        'ContentType="application/vnd.openxmlformats-package.relationships+xml"/><Override PartName="/xl/workbook.xml" '
        f'ContentType="{_KIND}.sheet.main+xml"/>{override}</Types>',
        "_rels/.rels": f'<Relationships xmlns="{_PACKAGE}/relationships"><Relationship Id="r" '
        f'Type="{_OFFICE}/officeDocument" Target="xl/workbook.xml"/></Relationships>',
        "xl/workbook.xml": f'<workbook xmlns="{_MAIN}" xmlns:r="{_OFFICE}"><sheets>{sheets}</sheets></workbook>',
        "xl/_rels/workbook.xml.rels": f'<Relationships xmlns="{_PACKAGE}/relationships">{relations}</Relationships>',
    }
    inside = f'<worksheet xmlns="{_MAIN}">{sheet}</worksheet>'
    every_part = {**parts, **{f"xl/worksheets/s{k}.xml": inside for k in every}}
    return _archive({name: text.encode() for name, text in every_part.items()})


def _rows(row: Callable[[int], str], bytes_of_one: int, more: str = "") -> Fill:
    return lambda size: _workbook(f"<sheetData>{''.join(map(row, range(1, size // bytes_of_one)))}</sheetData>{more}")


def _merged(size: int) -> bytes:
    """Return cells of a first row that are merged with all below, in as many columns as there may be."""
    columns = min(size // 100, 900)
    cells = "".join(
        f'<row r="{r}">{"<c><v>1</v></c>" * (columns if r == 1 else 1)}</row>' for r in range(1, size // 210)
    )
    names = (f"{chr(65 + k // 26 - 1) if k >= 26 else ''}{chr(65 + k % 26)}" for k in range(min(columns, 26 * 27)))
    merges = "".join(f'<mergeCell ref="{name}1:{name}200000"/>' for name in names)
    return _workbook(f"<sheetData>{cells}</sheetData><mergeCells>{merges}</mergeCells>")


# Recordings. -----------------------------------------------------------------------------------------------------


def _record(kind: int, *parts: bytes) -> bytes:
    return bytes([kind]) + struct.pack("<Q", sum(map(len, parts))) + b"".join(parts)


def _word(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()


def _mcap(records: Callable[[int], list[bytes]], definition: str = _POINT, kind: str = "Point") -> Fill:
    begin = _record(1, _word("ros2"), _word(""))
    begin += _record(3, struct.pack("<H", 1), _word(f"geometry_msgs/msg/{kind}"), _word("ros2msg"), _word(definition))
    begin += _channel(1)
    magic, end = b"\x89MCAP0\r\n", _record(15, struct.pack("<I", 0)) + _record(2, struct.pack("<QQI", 0, 0, 0))
    return lambda size: magic + begin + b"".join(records(size)) + end + magic


def _channel(number: int, schema: int = 1) -> bytes:
    return _record(4, struct.pack("<HH", number, schema), _word(f"/t{number}"), _word("cdr"), struct.pack("<I", 0))


def _kind_of_message(number: int) -> bytes:
    schema = struct.pack("<H", number), _word(f"a/msg/B{number:x}"), _word("ros2msg"), _word("bool x")
    return _record(3, *schema) + _channel(number, number)


def _message(k: int, data: bytes) -> bytes:
    return _record(5, struct.pack("<HIQQ", 1, 0, k, k), data)


def _vicon_wide(size: int) -> bytes:
    """Return 330 markers of one body that turns, in as many frames as there is room for."""
    rng, count = np.random.default_rng(0), 330
    head = f"Trajectories\n100\n,,{',,,'.join(f'arm:m{k}' for k in range(count))},,\n"
    head += f"Frame,Sub Frame{',X,Y,Z' * count}\n,{',mm' * 3 * count}\n"
    body, frames = rng.normal(size=(count, 3)) * 100.0, []
    for frame in range(max(2, (size - len(head)) // (18 * count))):
        turned = body @ np.linalg.qr(rng.normal(size=(3, 3)))[0].T + rng.normal(size=3) * 100.0
        frames.append(f"{frame},0,{','.join(f'{x:.1f}' for x in turned.ravel())}\n")
    return (head + "".join(frames)).encode()


# By what they are called: the file, the contents by their size, and further arguments of the command.
IMPORTED: dict[str, tuple[str, Fill, tuple[str, ...]]] = {
    "named numbers": ("a.txt", _text(lambda k: f"J1={k}.5; J2=-2.25; X: 512,3 mm\n"), ()),
    "named numbers, very many": ("a.txt", _text(lambda _: "".join(f"a{k}=1 " for k in range(12_000)) + "\n"), ()),
    "named numbers far apart": ("a.txt", _text(lambda _: f"a=1{' ' * 45_000}b=2{' ' * 45_000}c=3\n"), ()),
    "a name as long as a line": ("a.txt", _text(lambda _: "a" * 99_000 + "\n", "a=1 b=2 c=3\n"), ()),
    "a number as long as a line": ("a.txt", _text(lambda _: f"a={'1' * 99_000}!\n", "a=1 b=2 c=3\n"), ()),
    "units as long as a line": ("a.txt", _text(lambda _: "a=1 m" + "m/" * 40_000 + "\n"), ()),
    "matrices of placements": ("a.txt", _text(lambda _: _FIRST_MATRIX), ()),
    "placements that are none": ("a.txt", _text(lambda k: f"{k} 1 1 1\n", _FIRST_MATRIX), ()),
    "placements of long numbers": ("a.txt", _text(lambda _: "1" * 90_000 + " 0 0 0\n", _FIRST_MATRIX), ()),
    "markers of Vicon": ("a.csv", _text(lambda k: f"{k},0,{k % 9}.5,2,3,4,5,6\n", _VICON), ()),
    "markers of Vicon, one body": ("a.csv", _vicon_wide, ("--each-point",)),
    "markers of Qualisys": ("a.tsv", _text(lambda k: f"{k % 9}.5\t2\t3\t4\t5\t6\n", _QUALISYS), ()),
    "markers of Motive": (
        "log.csv",
        _text(
            lambda k: f"{k},{k}.0,1,2,3\n",
            _TAKE + ",Type,Marker,Marker,Marker\n,Name,m,m,m\n,,Position,Position,Position\nFrame,Time,X,Y,Z\n",
        ),
        (),
    ),
    "printed by pandas": ("a.txt", _text(lambda k: f"{k}  {k % 9}.5  2.0\n", "n  x [mm]  y [mm]\n"), ()),
    "points of RAPID": (
        "a.mod",
        _text(lambda k: f"CONST robtarget p{k}:=[[{k},-30,0],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\n"),
        (),
    ),
    "points of KRL": ("a.dat", _text(lambda k: f"DECL E6POS XP{k}={{X {k}.5,Y 2,Z 3,A 4,B 5,C 6,S 2,T 35}}\n"), ()),
    "points of URScript": ("a.script", _text(lambda k: f" movej([{k % 3}.1,-1.2,.3,.4,.5,.6], a=1.4, v=1.05)\n"), ()),
    "points of FANUC": (
        "a.ls",
        _text(lambda k: f"P[{k}]{{\n UF : 0,\n J1= {k}.5 deg, J2= 3 deg, J3= 7 deg\n}};\n"),
        (),
    ),
    "statements of many kinds": (
        "a.txt",
        _text(lambda k: f"move{'abcdefghij'[k % 10]}([1{',1' * (2 + k % 500)}])\n"),
        (),
    ),
    "lists that are named": (
        "a.txt",
        _text(lambda k: f"n{k}=[[1,2,3],[1,2,3],[1,2,{k}]],\n", "a=[\n", "[1,2,3]]\n"),
        (),
    ),
    "rows in many brackets": ("a.txt", _text(lambda k: f"{'[' * 9}{k},2,3{']' * 9},\n", "a=[\n", "[1,2,3]]\n"), ()),
    "minus signs apart": ("a.txt", _text(lambda _: f"={' ' * 50}-{' ' * 48}\n", "[1,2,3]\n[1,2,3]\n"), ()),
    "columns of JSON": ("a.json", _text(lambda k: f"{k},", '{"a": [', "1]}"), ()),
    "rows of JSON below titles": (
        "a.json",
        _text(lambda k: f"[{k},2,3],", '{"columns": ["a", "b", "c"], "data": [', "[1,2,3]]}"),
        (),
    ),
    "cells of few columns each": ("a.json", _text(lambda k: f'{{"a{k % 44}":1}},', "[", '{"a":1}]'), ()),
    "lists in a list of a long name": (
        "a.json",
        _text(lambda _: f"{json.dumps([1] * 500)},", f'[{{"{"n" * 900}": [', "[1]]}]"),
        (),
    ),
    "joints of JSON": ("a.json", _text(lambda _: '{"name":["a","b"],"position":[1,2]},', "[", '{"a":1}]'), ()),
    "merged keys of YAML": ("a.yaml", _text(lambda k: f"- <<: {{a: {k}}}\n  b: 1\n"), ()),
    "states in YAML": ("a.yaml", _text(lambda k: f"---\nname: [a, b]\nposition: [{k}, 2]\n"), ()),
    "small arrays": ("a.npz", _arrays(_array(np.zeros(3)), 300), ()),
    "headers of arrays": ("a.npz", _arrays(_shape(b"1," * 4500), 230), ()),
    "fields of arrays": (
        "a.npz",
        _arrays(_shape(b"1,", b"[" + b",".join(b"('a%d','<f8')" % k for k in range(600)) + b"]"), 2200),
        (),
    ),
    "empty words of arrays": ("a.npz", lambda _: _archive({"a.npy": _shape(b"4000000,", b"'<U0'")}), ()),
    "one long word of arrays": ("a.npz", lambda size: _archive({"a.npy": _array(np.array(["a " * (20 * size)]))}), ()),
    "zeros of arrays": (
        "a.npz",
        lambda size: _archive({"a.npy": _array(np.zeros((4000, min(size // 500, 1000))))}),
        (),
    ),
    "matrices of MATLAB": (
        "a.mat",
        _matlab(lambda size: b"".join(_matrix(f"a{k}", 3, 1, bytes(24)) for k in range(size // 110))),
        (),
    ),
    "matrices of MATLAB, packed": (
        "a.mat",
        _matlab(lambda size: b"".join(_packed(_matrix(f"a{k}", 4000, 1, bytes(32_000))) for k in range(size // 1000))),
        (),
    ),
    "variables of MATLAB 4": (
        "a.mat",
        lambda size: b"".join(struct.pack("<5i", 50, 1, 1, 0, 6) + b"%05d\0\1" % k for k in range(size // 27)),
        (),
    ),
    "elements of MATLAB": ("a.mat", _matlab(lambda size: struct.pack("<II", 15, 0) * (size // 8)), ()),
    "zeros of MATLAB": ("a.mat", _matlab(lambda size: _packed(bytes(min(190 * size, 190_000_000)))), ()),
    "rows of a workbook": (
        "a.xlsx",
        _rows(lambda r: f'<row r="{r}">{"".join(f"<c><v>{r}.{c}</v></c>" for c in range(6))}</row>', 40),
        (),
    ),
    "texts of a workbook": (
        "a.xlsx",
        _rows(lambda r: f'<row r="{r}"><c t="inlineStr"><is><t>a{r}</t></is></c></row>', 20),
        (),
    ),
    "formulas of a workbook": (
        "a.xlsx",
        _rows(lambda r: f'<row r="{r}"><c r="A{r}"><f t="shared" si="0">A1+1</f><v>{r}</v></c></row>', 20),
        (),
    ),
    "digits of a workbook": ("a.xlsx", _rows(lambda r: f"<row><c><v>{r}{'9' * 4200}</v></c></row>", 100), ()),
    "merged cells of a workbook": ("a.xlsx", _merged, ()),
    "cells far right in a workbook": (
        "a.xlsx",
        _rows(lambda r: f'<row r="{r}"><c r="ALL{r}"><v>1</v></c></row>', 210),
        (),
    ),
    "sheets of a workbook": ("a.xlsx", lambda size: _workbook("<sheetData/>", min(size // 500, 3000)), ()),
    "messages of nothing": (
        "one.mcap",
        _mcap(lambda size: [_message(k, b"") for k in range(size // 33)]),
        ("--topic", "/t1"),
    ),
    "messages of points": (
        "one.mcap",
        _mcap(lambda size: [_message(k, b"\0\1\0\0" + struct.pack("<3d", k, 1, 2)) for k in range(size // 61)]),
        ("--topic", "/t1"),
    ),
    "topics of a recording": (
        "one.mcap",
        _mcap(lambda size: [_channel(2 + k) for k in range(size // 40)]),
        ("--topic", "/t1"),
    ),
    "kinds of messages": (
        "one.mcap",
        _mcap(lambda size: [_kind_of_message(2 + k) for k in range(min(size // 93, 60_000))]),
        ("--topic", "/t1"),
    ),
    "remarks of a recording": (
        "one.mcap",
        _mcap(lambda size: [_record(12, _word("x"), struct.pack("<I", 0)) for _ in range(size // 20)]),
        ("--topic", "/t1"),
    ),
}
