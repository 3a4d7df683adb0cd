"""What recordings of ROS unpack to, and what their databases compute, has a limit.

rosbags unpacks whatever a chunk holds: a megabyte of zstd is ten gigabytes of zeros, a chunk says itself how large it
is, and an index may point to one in the middle of other data. So its decompressors are those of this module while a
recording is open: they stop at a size. A database is read for what it declares before anything is asked of it.
"""

import bz2
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from os import SEEK_CUR
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from calib.foundations.errors import MeasurementError
from calib.foundations.files import is_there
from calib.measurement.formats.message_types import Definitions

# One chunk, and one message packed by itself; writers make chunks of some megabytes.
LARGEST_CHUNK = 256_000_000
# All that is unpacked, for each byte that is read, and at least: logs of an arm at rest shrink to a hundredth.
MOST_PER_BYTE, LEAST_TOTAL = 200, 200_000_000
# All records in chunks of MCAP and of ROS 1, for each byte of the file, and at least: a microsecond or two each.
RECORDS_PER_BYTE, LEAST_RECORDS = 1, 1_000_000
# Of a record of ROS 1, its names and small values; and so many bytes of it cost as much as one more.
LARGEST_HEADER, _BYTES_OF_A_RECORD = 1_000_000, 50
# A stream in a chunk by itself, and so many bytes that are handed on to the next, cost as much as a record.
_BYTES_OF_A_STREAM = 10_000
_LENGTH = struct.Struct("<xQ")
# As many topics as no recording has.
MOST_TOPICS = 10_000
# Steps in which SQLite reads what tables there are; some dozens each are needed.
_MOST_STEPS = 1_000_000
# Steps in which it reads what is in them, for each byte of the file, and at least; a message needs some dozens.
STEPS_PER_BYTE, LEAST_STEPS, _STEPS_AT_ONCE = 100, 20_000_000, 100_000
# Every row that ends before a column with a default has all of it.
_LONGEST_DEFAULT = 100
_PIECE = 1_000_000
# What is replaced in rosbags belongs to the process: recordings are read one after another.
_ALONE = threading.RLock()


class Unpacker:
    """Unpacks the chunks of one recording of ``size`` bytes, as far as its limits go."""

    def __init__(self, where: Path, size: int) -> None:
        self._where = where
        self._left = max(LEAST_TOTAL, MOST_PER_BYTE * size)
        self._records_left = max(LEAST_RECORDS, RECORDS_PER_BYTE * size)
        self._steps_left = max(LEAST_STEPS, STEPS_PER_BYTE * size)

    def unpacked(self, make: Callable[[], Any], data: bytes) -> bytes:
        """Return what decompressors as those of the standard library make of the streams in ``data``."""
        most, pieces, size = min(LARGEST_CHUNK, self._left), list[bytes](), 0
        while data:
            self._take_records(1 + len(data) // _BYTES_OF_A_STREAM)
            made, given = make(), data
            while not made.eof:
                piece, given = made.decompress(given, max_length=_PIECE), b""
                pieces.append(piece)
                size += len(piece)
                if size > most:
                    raise self._too_much()
                if not piece and made.needs_input:
                    raise ValueError("a chunk ends too early")
            data = made.unused_data or b""
        self._left -= size
        return b"".join(pieces)

    def as_it_is(self, data: bytes) -> bytes:
        """Return a chunk, or a message, that is not packed: an index may point to the same one many times."""
        self._left -= len(data)
        if self._left < 0:
            raise self._too_much()
        return data

    def counted(self, chunk: bytes) -> bytes:
        """Return a chunk of MCAP, whose records are counted before the reader goes through them."""
        at = 0
        while at + _LENGTH.size <= len(chunk):
            at += _LENGTH.size + _LENGTH.unpack_from(chunk, at)[0]
            self._take_records(1)
        return chunk

    def header(self, size: int) -> None:
        """Count a record of ROS 1, whose header of this size is to be read: an index may point to one many times."""
        if size > LARGEST_HEADER:
            raise MeasurementError(f"{self._where}: has a header of more than {LARGEST_HEADER} bytes.")
        self._take_records(1 + size // _BYTES_OF_A_RECORD)

    def steps(self) -> bool:
        """Count steps of SQLite, which is told by whether it is to end: it never is."""
        self._steps_left -= _STEPS_AT_ONCE
        if self._steps_left < 0:
            raise MeasurementError(f"{self._where}: takes longer to read than a recording of its size can take.")
        return False

    def _take_records(self, many: int) -> None:
        self._records_left -= many
        if self._records_left < 0:
            raise MeasurementError(f"{self._where}: has more records than a recording of its size can have.")

    def _too_much(self) -> MeasurementError:
        return MeasurementError(
            f"{self._where}: unpacks to more than {LARGEST_CHUNK} bytes at once, or in all to more than "
            f"{MOST_PER_BYTE} times its size."
        )


@contextmanager
def limited(where: Path, size: int) -> Iterator[None]:
    """Give rosbags these decompressors for as long as a recording of ``size`` bytes is read."""
    with _ALONE, _replaced(where, size):
        yield


@contextmanager
def _replaced(where: Path, size: int) -> Iterator[None]:
    import apsw  # noqa: PLC0415 - an extra
    from lz4.frame import LZ4FrameDecompressor  # noqa: PLC0415
    from rosbags.highlevel import anyreader  # noqa: PLC0415
    from rosbags.rosbag1 import reader as of_ros1  # noqa: PLC0415
    from rosbags.rosbag2 import reader as of_ros2  # noqa: PLC0415
    from rosbags.rosbag2 import storage_mcap as of_mcap  # noqa: PLC0415
    from rosbags.rosbag2 import storage_sqlite3 as of_sqlite  # noqa: PLC0415

    unpacker = Unpacker(where, size)
    zstd: Any = vars(of_ros2)["zstd"]

    def one(make: Callable[[], Any]) -> Callable[..., bytes]:
        return lambda data, _=0: unpacker.unpacked(make, data)

    def refused(*_: object) -> Any:
        raise MeasurementError(f"{where}: is packed file by file; unpack it first: zstd -d.")

    def plain(data: bytes, _: int = 0) -> bytes:
        return unpacker.as_it_is(data)

    ros1 = {"none": plain, "bz2": one(bz2.BZ2Decompressor), "lz4": one(LZ4FrameDecompressor)}

    def of_zstd(data: bytes, _: int = 0) -> bytes:
        try:
            return unpacker.unpacked(zstd.ZstdDecompressor, data)
        except zstd.ZstdError as e:  # which is no exception of another kind
            raise ValueError("a chunk is damaged") from e

    def of_records(unpack: Callable[..., bytes]) -> Callable[..., bytes]:
        return lambda data, _=0: unpacker.counted(unpack(data))

    mcap = {"": of_records(plain), "lz4": of_records(ros1["lz4"]), "zstd": of_records(of_zstd)}
    of_messages = SimpleNamespace(decompress=of_zstd, open=refused)

    def database(path: Any) -> Any:
        refuse_computed(Path(str(path)))
        return Database(path)

    def counted(connection: Any) -> None:
        connection.set_progress_handler(unpacker.steps, _STEPS_AT_ONCE)

    class Database(of_ros2.Sqlite3Reader):  # type: ignore[misc]  # rosbags is an extra, which is not looked at
        """Has no definitions that were not found when they were recorded: rosbags does not know their encoding."""

        def open(self) -> None:
            apsw.connection_hooks.append(_without_unknown)
            try:
                super().open()
            finally:
                apsw.connection_hooks.remove(_without_unknown)

    class Indexed(of_ros1.Reader):  # type: ignore[misc]
        """Reads no more of indexes than the file has: chunks may share one."""

        read = 0

        def open(self) -> None:
            super().open()
            self.connections: list[Any] = list(map(definitions.legible, self.connections))

        def read_index_data(self, pos: int, indexes: Any) -> None:
            before = self.bio.tell() if self.bio else 0
            super().read_index_data(pos, indexes)
            self.read += (self.bio.tell() if self.bio else 0) - before
            if self.read > size:
                raise MeasurementError(f"{where}: has indexes that are larger than the file.")

    def bytes_of(read: Callable[[Any, int], bytes], source: Any, many: int) -> bytes:
        return unpacker.as_it_is(read(source, many))

    class Header(of_ros1.Header):  # type: ignore[misc]
        """Is read only where it is not too large, and not too often."""

        @classmethod
        def read(cls, src: Any, expect: Any = None) -> Any:
            unpacker.header(of_ros1.read_uint32(src))
            src.seek(-4, SEEK_CUR)
            return super().read(src, expect)

    class Storage(of_ros2.Reader):  # type: ignore[misc]
        @property
        def connections(self) -> list[Any]:
            return list(map(definitions.legible, super().connections))

    definitions = Definitions(where, anyreader)
    parsers: dict[str, Any] = {
        "Reader1": Indexed,
        "Reader2": Storage,
        "get_types_from_msg": definitions.of_messages,
        "get_types_from_idl": definitions.of_idl,
    }
    mcap_reader = _mcap_reader(of_mcap)

    # How messages were sent is YAML in the metadata, a database or a channel; it takes no part, and is not read.
    unread: dict[str, Any] = {"parse_qos": lambda _: []}
    tables: tuple[tuple[Any, dict[str, Any]], ...] = (
        *((vars(module), unread) for module in (of_ros2, of_mcap, of_sqlite)),
        (vars(anyreader), parsers),
        (vars(of_mcap), {"get_msgdef": partial(_of_channel, of_mcap.get_msgdef)}),
        (vars(of_ros1), {"Header": Header, "read_bytes": partial(bytes_of, of_ros1.read_bytes)}),
        (of_ros1.decompressors, ros1),
        (of_mcap.DECOMPRESSORS, mcap),
        (vars(of_ros2), {"zstd": of_messages}),
        (vars(of_ros2.DirectoryReader)["STORAGE_PLUGINS"], {"sqlite3": database, "mcap": mcap_reader}),
        (vars(of_ros2.Reader)["STORAGE_PLUGINS"], {".db3": database, ".mcap": mcap_reader}),
    )
    before = [dict(table) for table, _ in tables]
    apsw.connection_hooks.append(counted)
    try:
        for table, ours in tables:
            table.update(ours)
        yield
    finally:
        apsw.connection_hooks.remove(counted)
        for (table, _), was in zip(tables, before, strict=True):
            table.update(was)


def _without_unknown(database: Any) -> None:
    """Put a view in the place of the table of definitions of a database."""
    database.execute(
        "CREATE TEMP VIEW message_definitions AS SELECT * FROM main.message_definitions "
        "WHERE encoding IN ('ros2msg', 'ros2idl')"
    )


def _mcap_reader(of_mcap: Any) -> Any:
    """Return a reader of MCAP that needs no index of messages, and takes messages in the order in which they are."""

    class Mcap(of_mcap.McapReader):  # type: ignore[misc]  # rosbags is an extra, which is not looked at
        chunks: list[Any]

        def read_index(self) -> None:
            super().read_index()
            # When messages were recorded is told by statistics, or else by indexes.
            if self.statistics is None and not all(chunk.message_index_offsets for chunk in self.chunks):
                self.meta_scan()

        def messages(self, connections: Any, start: Any = None, stop: Any = None) -> Any:
            if not self.chunks:
                yield from self.messages_scan(connections, start, stop)
                return
            every, wanted = self.chunks, {one.id for one in connections}
            # Each chunk would be asked for every topic, one after the other, and one without an index has none.
            self.chunks = [
                chunk._replace(channel_count=_All())
                for chunk in every
                if not (chunk.message_index_offsets and wanted.isdisjoint(chunk.message_index_offsets))
            ]
            try:
                if self.chunks:
                    yield from super().messages(connections, start, stop)
            finally:
                self.chunks = every

    return Mcap


class _All(dict[int, int]):
    """Says of every topic that a chunk has a message of it."""

    def get(self, _: int, __: Any = None) -> int:
        return 1


def _of_channel(told: Callable[[Any], Any], schema: Any) -> Any:
    """Return the definition of a channel's messages: none of JSON, Protobuf and others, which may be beside ROS's."""
    is_known = schema is None or schema.encoding in ("ros2msg", "ros2idl", "omgidl", "")
    return told(schema if is_known else None)


def refuse_computed(path: Path) -> None:
    """Raise MeasurementError for a database of which a view, a trigger or a column computes what is read.

    Also where a part of it is in a file beside it, which a reader who may change nothing does not see; and where a page
    is part of more than one tree, or twice of one: SQLite would go through it as often as it is pointed to, which some
    hundred pages can do without end. Raises errors of SQLite for a file that is none.
    """
    import apsw  # noqa: PLC0415 - an extra

    # The reader of recordings puts the name into an address as it is.
    if any(mark in str(path) for mark in "?#%"):
        raise MeasurementError(f"{path}: its name has ?, # or %; rename it.")
    for beside in (path.with_name(f"{path.name}{end}") for end in ("-wal", "-journal")):
        if is_there(beside, Path.is_file) and beside.stat().st_size:
            raise MeasurementError(
                f"{path}: was not closed, and {beside.name} beside it holds what is not in it; open it once by "
                "sqlite3, and let it do PRAGMA wal_checkpoint(TRUNCATE)."
            )
    flags = apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI
    database = apsw.Connection(path.absolute().as_uri() + "?immutable=1", flags=flags)
    try:
        # The list of tables is such a tree as well, and read before pages are counted.
        database.set_progress_handler(lambda: True, _MOST_STEPS)
        names = []
        for kind, name, root in database.execute("SELECT type, name, rootpage FROM sqlite_master"):
            if kind not in ("table", "index") or (kind == "table" and not root):
                what = f"{kind}" if kind != "table" else "virtual table"
                raise MeasurementError(f"{path}: has a {what}; a recording has plain tables alone.")
            names += [name] if kind == "table" else []
        for name in names:
            for *_, default, _, hidden in database.execute("SELECT * FROM pragma_table_xinfo(?)", (name,)):
                if hidden:
                    raise MeasurementError(f"{path}: has a computed column; a recording has plain tables alone.")
                if len(default or "") > _LONGEST_DEFAULT:
                    raise MeasurementError(f"{path}: has a column with a default of {len(default)} characters.")
        database.set_progress_handler(None)
        database.execute("PRAGMA ignore_check_constraints = 1")  # which would compute as well
        if list(database.execute("PRAGMA quick_check(1)")) != [("ok",)]:
            raise MeasurementError(f"{path}: is a damaged database; what is left of it, .recover of sqlite3 may save.")
        if "topics" in names:
            # Texts such as "1" and "01" are different, and both the number of a message's topic.
            number = "CASE typeof(id) WHEN 'integer' THEN id END"
            many, different = next(iter(database.execute(f"SELECT count(*), count(DISTINCT {number}) FROM topics")))
            if many > MOST_TOPICS or many != different:
                raise MeasurementError(f"{path}: has {many} topics, of {different} numbers.")
    finally:
        database.close()
