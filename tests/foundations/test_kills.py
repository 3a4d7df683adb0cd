"""Killed at every single filesystem operation, a folder is the old one or the new one, and nobody loses a file."""

import ast
import contextlib
import errno
import fcntl
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from calib.foundations import folders
from calib.foundations.errors import OutputError
from calib.foundations.files import opened_folder
from calib.foundations.folders import reading_folder, write_folder

OURS = ("model.json", "result.json", "report.html")

# A process with one thread, that can be forked: every fork does a thing and is gone at its n-th operation, which the
# interpreter's audit hooks tell beforehand. Writing and syncing are not told, and counted by hand.
KILLER = '''
import errno, os, sys, types
from pathlib import Path

# The package without what it imports: a small process forks fast.
sys.modules["calib"] = types.ModuleType("calib")
sys.modules["calib"].__path__ = [sys.argv[2]]

root = Path(sys.argv[1])
os.fsync = lambda handle: None  # no disk is lost here


def killed_at(n, what):
    """Do a thing in a fork that is gone at its n-th operation; return whether it was."""
    pid = os.fork()
    if pid == 0:
        left = [n]

        def count(event="", arguments=()):
            if event == "" or event.startswith(("os.", "shutil.", "tempfile.", "fcntl.")) or event == "open":
                left[0] -= 1
                if left[0] < 0:
                    os._exit(9)

        os.fsync = lambda handle: count()
        sys.addaudithook(count)
        what()
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 9


'''

FOLDER = """
from calib.foundations.folders import reading_folder, write_folder

OURS = ("model.json", "result.json", "report.html")


def contents(folder):
    return {path.name: path.read_text() for path in folder.iterdir()}


def write(word):
    write_folder(root / "out", dict.fromkeys(OURS[:2] if word == "new" else OURS, word), OURS)


def read():
    with reading_folder(root / "out"):
        return contents(root / "out")


old = dict.fromkeys(OURS, "old")
new = dict.fromkeys(OURS[:2], "new")
mine = {"notes.txt": "mine"}


def judge(expected):
    found = read()
    kept = {name: text for name, text in found.items() if name not in mine}
    assert kept in expected, found
    return found


seen = {"old": 0, "new": 0, "put right": 0, "killed twice": 0}
total = 0
for late in (False, True):
    n = 0
    while True:
        write("old")
        if late:
            (root / "out" / "notes.txt").write_text("mine")
        if not killed_at(n, lambda: write("new")):
            break
        if not (root / "out").exists():
            seen["put right"] += 1
            # Killed once more, at every operation of whoever puts it right.
            m = 0
            while killed_at(m, read):
                seen["killed twice"] += 1
                m += 1
        seen["new" if judge([old, new]).get("model.json") == "new" else "old"] += 1
        m = 0
        while not late and killed_at(m, lambda: write("new")):
            judge([old, new])
            m += 5
        write("new")
        assert sorted(os.listdir(root)) == ["out"], os.listdir(root)
        assert read() == (new | mine if late else new), (n, read())
        (root / "out" / "notes.txt").unlink(missing_ok=True)
        n += 1
    assert read() == (new | mine if late else new)
    (root / "out" / "notes.txt").unlink(missing_ok=True)
    total += n
print(total, seen)
"""


# What is beside is somebody else's, but for the one moment in which what replaces another is called as a part.
FILE = """
from calib.foundations.files import write_atomically

unnamed, new = sys.argv[3] == "unnamed", sys.argv[4] == "new"
opened = os.open
nameless = getattr(os, "O_TMPFILE", 0)


def known(name, flags, *arguments, **options):
    if nameless and flags & nameless == nameless and not unnamed:
        raise OSError(errno.EOPNOTSUPP, "Operation not supported")
    return opened(name, flags, *arguments, **options)


os.open = known
foreign = {".a.01234567.part": "theirs", "b": "theirs"}
seen = {"before": 0, "after": 0, "part": 0}
n = 0
while True:
    for path in root.iterdir():
        path.unlink()
    for name, text in (foreign if new else foreign | {"a": "old"}).items():
        (root / name).write_text(text)
    killed = killed_at(n, lambda: write_atomically(root / "a", "new", new=new))
    found = {path.name: path.read_text() for path in root.iterdir()}
    assert foreign.items() <= found.items(), found
    stood = found.pop("a", None)
    assert stood in ("new", None if new else "old"), stood
    parts = {name: text for name, text in found.items() if name not in foreign}
    assert all(name.startswith(".a.") and name.endswith(".part") for name in parts)
    if not killed:
        assert (stood, parts) == ("new", {})
        break
    seen["after" if stood == "new" else "before"] += 1
    seen["part"] += bool(parts)
    n += 1
print(n, seen)
"""


def killed(tmp_path: Path, code: str, *arguments: str) -> tuple[int, dict[str, int]]:
    """Return at how many operations something was killed, and how often what was seen then."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    command = [
        sys.executable,
        "-W",
        "error",
        "-c",
        KILLER + code,
        str(tmp_path),
        str(Path(folders.__file__).parents[1]),
    ]
    done = subprocess.run([*command, *arguments], env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    operations, seen = done.stdout.split(" ", 1)
    return int(operations), ast.literal_eval(seen)


@pytest.mark.parametrize("new", [True, False], ids=["new", "replaced"])
@pytest.mark.parametrize("unnamed", [True, False], ids=["unnamed", "named"])
def test_a_file_killed_at_every_operation(tmp_path: Path, unnamed: bool, new: bool) -> None:
    if unnamed and not unnamed_files(tmp_path):
        pytest.skip("this file system knows no files without a name")
    operations, seen = killed(tmp_path, FILE, "unnamed" if unnamed else "named", "new" if new else "replaced")
    assert operations > 4
    assert seen["before"] > 2
    assert seen["before"] + seen["after"] == operations
    # Without a name it leaves nothing, but in the one moment between link and rename.
    assert seen["part"] == (0 if new else 1) if unnamed else seen["part"] > 1


def unnamed_files(folder: Path) -> bool:
    try:
        os.close(os.open(folder, os.O_WRONLY | os.O_TMPFILE))
    except (AttributeError, OSError):
        return False
    return True


def test_a_folder_killed_at_every_operation(tmp_path: Path) -> None:
    operations, counted = killed(tmp_path, FOLDER)
    assert operations > 40
    assert all(count > 0 for count in counted.values()), counted
    assert counted["old"] + counted["new"] == operations


# Two at once. -----------------------------------------------------------------------------------------------------


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@contextlib.contextmanager
def held(folder: Path, kind: int) -> Iterator[threading.Event]:
    """Keep a folder in a thread, as another run that reads or exchanges it, until the event or the end."""
    begun, enough = threading.Event(), threading.Event()

    def run() -> None:
        with opened_folder(folder.parent) as above, folders._locked(folders._Place(folder, above), kind):
            begun.set()
            enough.wait()

    thread = threading.Thread(target=run)
    thread.start()
    begun.wait()
    try:
        yield enough
    finally:
        enough.set()
        thread.join()


def test_a_writer_waits_for_a_reader_or_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    write_folder(out, {"a": "old"})
    with held(out, fcntl.LOCK_SH) as enough:
        with monkeypatch.context() as hasty:
            hasty.setattr(folders, "_PATIENCE", 0.05)
            with pytest.raises(OutputError) as caught:
                write_folder(out, {"a": "new"}, ("a",))
        assert str(caught.value) == f"{out}: another run is writing here; try again when it has ended."
        assert names(tmp_path) == ["out"]
        threading.Timer(0.1, enough.set).start()
        write_folder(out, {"a": "new"}, ("a",))
        assert enough.is_set()
    assert (out / "a").read_text() == "new"
    assert names(tmp_path) == ["out"]


def test_two_writers_at_once_leave_whole_folders_and_the_last_one_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    create = folders.create

    def meanwhile(name: str, folder: int, data: bytes) -> None:
        if name == "b":
            write_folder(out, {"a": "second"}, ("a", "b"))
            with reading_folder(tmp_path / "other"):
                pass
            assert {path.name: path.read_text() for path in out.iterdir()} == {"a": "second"}
        create(name, folder, data)

    monkeypatch.setattr(folders, "create", meanwhile)
    write_folder(out, {"a": "first", "b": "first"}, ("a", "b"))
    assert {path.name: path.read_text() for path in out.iterdir()} == {"a": "first", "b": "first"}
    assert names(tmp_path) == ["out"]


def test_readers_do_not_wait_for_one_another_but_for_a_writer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    monkeypatch.setattr(folders, "_PATIENCE", 0.05)
    with held(out, fcntl.LOCK_SH), reading_folder(out), reading_folder(tmp_path / "other"):
        pass
    with held(out, fcntl.LOCK_EX), pytest.raises(OutputError, match="another run is writing here"), reading_folder(out):
        pass


def test_where_no_lock_is_to_be_had(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", refuse)
    left = tmp_path / ".out.0123abcd.calib"
    left.mkdir()
    for word in ("old", "new"):
        write_folder(tmp_path / "out", {"a": word}, ("a",))
        with reading_folder(tmp_path / "out"):
            assert (tmp_path / "out" / "a").read_text() == word
    assert names(tmp_path) == [left.name, "out"]  # it may be another run's
    monkeypatch.undo()
    write_folder(tmp_path / "out", {"a": "new"}, ("a",))
    assert names(tmp_path) == ["out"]


# What cannot be written. ------------------------------------------------------------------------------------------


def failing(number: int) -> Callable[..., None]:
    def fail(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number))

    return fail


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EROFS, errno.EDQUOT, errno.EIO], ids=errno.errorcode.get)
@pytest.mark.parametrize("operation", ["mkdir", "open", "fsync", "rename"])
def test_a_disk_that_fails_costs_neither_the_old_nor_a_trace(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, operation: str, number: int
) -> None:
    out = tmp_path / "out"
    write_folder(out, {"a": "old"})
    works = getattr(os, operation)

    def broken(*arguments: object, **options: object) -> object:
        writing = operation != "open" or bool(int(str(arguments[1])) & os.O_CREAT)
        return failing(number)() if writing else works(*arguments, **options)

    for folder in (out, tmp_path / "deep" / "er" / "out"):
        with monkeypatch.context() as patched:
            patched.setattr(os, operation, broken)
            with pytest.raises(OutputError) as caught:
                write_folder(folder, {"a": "new"}, ("a",))
        assert str(caught.value) == f"{folder}: the results cannot be written ({os.strerror(number)})."
        assert (out / "a").read_text() == "old"
        assert names(tmp_path) == ["out"]


def test_the_second_of_the_two_renames_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    write_folder(out, {"a": "old"})
    rename = os.rename

    def fail_once(name: str, to: str, **options: int) -> None:
        if name == "new":
            failing(errno.EIO)()
        rename(name, to, **options)

    monkeypatch.setattr(os, "rename", fail_once)
    with pytest.raises(OutputError, match="Input/output error"):
        write_folder(out, {"a": "new"}, ("a",))
    assert (out / "a").read_text() == "old"
    assert names(tmp_path) == ["out"]


def test_what_cannot_be_put_right_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    write_folder(out, {"a": "old"})

    class Killed(BaseException):
        pass

    def die(name: str, to: str, **options: int) -> None:
        if to == "old":
            rename(name, to, **options)
        raise Killed

    rename = os.rename
    monkeypatch.setattr(os, "rename", die)
    with pytest.raises(Killed):
        write_folder(out, {"a": "new"}, ("a",))
    monkeypatch.setattr(os, "rename", failing(errno.EROFS))
    with pytest.raises(OutputError) as caught, reading_folder(out):
        pass
    assert str(caught.value) == f"{out}: what an interrupted run left cannot be repaired (Read-only file system)."
    monkeypatch.undo()
    with reading_folder(out):
        assert (out / "a").read_text() == "old"
