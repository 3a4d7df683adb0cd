"""Files are read with a guard, and appear whole or not at all."""

import contextlib
import errno
import os
import stat
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from calib.foundations import files
from calib.foundations.errors import CalibError, JobError, OutputError
from calib.foundations.files import (
    open_inside,
    read_bytes,
    read_inside,
    refuse_taken,
    sha256,
    write_atomically,
    write_new,
    write_together,
)
from tests.support.swaps import at_operation, swap

as_root = os.geteuid() == 0


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize(
    ("there", "asked"), [("gro\u0308\u00dfe.csv", "gr\u00f6\u00dfe.csv"), ("Data.CSV", "data.csv")]
)
def test_a_name_that_is_written_in_another_way_is_told(there: str, asked: str, tmp_path: Path) -> None:
    """As a file has it that comes from a system which knows no capitals, or writes accents apart."""
    (tmp_path / there).write_bytes(b"")
    if (tmp_path / asked).exists():
        pytest.skip("this file system takes both for one")
    with pytest.raises(JobError) as caught:
        read_bytes(tmp_path / asked, JobError)
    assert str(caught.value) == f"{tmp_path / asked}: there is no such file; there is {there!r}."


def test_read_bytes(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"abc")
    assert read_bytes(path, JobError) == b"abc"
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "dead").symlink_to("b")
    for bad, sentence in (
        (tmp_path / "b", "there is no such file."),
        (tmp_path / "dead", "there is no such file."),
        (path / "b", "there is no such file."),
        (tmp_path / "loop", "cannot be read (Too many levels of symbolic links)."),
        (tmp_path / "loop" / "b", "cannot be read (Too many levels of symbolic links)."),
        (tmp_path, "is not a regular file."),
        (tmp_path / "fifo", "is not a regular file."),
        (tmp_path / ("n" * 300), "cannot be read (File name too long)."),
    ):
        with pytest.raises(JobError) as caught:
            read_bytes(bad, JobError)
        assert str(caught.value) == f"{bad}: {sentence}"
    with pytest.raises(JobError, match="is larger than 2 bytes"):
        read_bytes(path, JobError, largest=2)


def test_read_inside(tmp_path: Path) -> None:
    folder, secret = tmp_path / "folder", tmp_path / "secret"
    folder.mkdir()
    secret.write_bytes(b"secret")
    (folder / "a").write_bytes(b"abc")
    (folder / "link").symlink_to(secret)
    (folder / "zeros").symlink_to("/dev/zero")
    (folder / "sub").mkdir()
    os.mkfifo(folder / "fifo")
    assert read_inside(folder, "a", JobError) == b"abc"
    (tmp_path / "named").symlink_to("folder")  # the folder itself is named by the user, in any way
    assert read_inside(tmp_path / "named", "a", JobError) == b"abc"
    for bad in ("link", "zeros", "sub", "fifo", ".."):
        with pytest.raises(JobError) as caught:
            read_inside(folder, bad, JobError)
        assert str(caught.value) == f"{folder / bad}: is not a regular file."
    with pytest.raises(JobError, match="there is no such file"):
        read_inside(folder, "b", JobError)
    with pytest.raises(JobError, match="is larger than 2 bytes"):
        read_inside(folder, "a", JobError, 2)
    with pytest.raises(JobError, match="cannot be read"):
        read_inside(tmp_path / "no", "a", JobError)


@pytest.mark.parametrize("swapped", ["link", "fifo"])
def test_what_takes_the_place_of_a_file_is_not_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, swapped: str
) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"abc")
    (tmp_path / "secret").write_bytes(b"secret")
    opened = os.open

    def late(name: str | Path, *flags: int, **options: int) -> int:
        if str(name).endswith("a"):
            path.unlink()
            path.symlink_to("secret") if swapped == "link" else os.mkfifo(path)
        return opened(name, *flags, **options)

    monkeypatch.setattr(os, "open", late)
    with pytest.raises(JobError, match=r"cannot be read|is not a regular file"):
        read_inside(tmp_path, "a", JobError)


def test_open_inside_follows_no_link_and_opens_nothing_larger(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"abc")
    (tmp_path / "link").symlink_to("a")
    with open_inside(tmp_path, "a", JobError, 3) as file:
        assert file.read() == b"abc"
    with pytest.raises(JobError, match="is larger than 2 bytes"):
        open_inside(tmp_path, "a", JobError, 2)
    with pytest.raises(JobError, match="is not a regular file"):
        open_inside(tmp_path, "link", JobError, 3)


def test_sha256() -> None:
    assert sha256(b"") == "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"


def test_write_atomically_replaces_and_leaves_nothing_beside(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    write_atomically(path, "grün")
    assert path.read_text(encoding="utf-8") == "grün"
    write_atomically(path, b"\0new")
    assert path.read_bytes() == b"\0new"
    assert names(tmp_path) == ["result.json"]


@pytest.mark.parametrize("umask", [0o077, 0o022, 0o002])
def test_write_atomically_obeys_the_umask(tmp_path: Path, umask: int) -> None:
    before = os.umask(umask)
    try:
        write_atomically(tmp_path / "a", "")
    finally:
        os.umask(before)
    assert (tmp_path / "a").stat().st_mode & 0o777 == 0o666 & ~umask


@pytest.mark.parametrize("kind", ["link", "dangling", "folder", "pipe", "device"])
def test_write_atomically_takes_the_place_of_files_alone(tmp_path: Path, kind: str) -> None:
    """As root, ``--plot /dev/null`` would otherwise be the end of that device."""
    (tmp_path / "mine").write_text("mine")
    path = tmp_path / "a"
    match kind:
        case "link":
            path.symlink_to("mine")
        case "dangling":
            path.symlink_to("nothing")
        case "folder":
            path.mkdir()
        case "pipe":
            os.mkfifo(path)
        case _:
            path = Path("/dev/null")
    before = path.lstat()
    with pytest.raises(OutputError) as caught:
        write_atomically(path, "new")
    what = "a link" if kind in ("link", "dangling") else "not a regular file"
    assert str(caught.value) == f"{path}: is {what}, and is not replaced; choose another name."
    assert (path.lstat().st_ino, path.lstat().st_mode) == (before.st_ino, before.st_mode)
    assert (tmp_path / "mine").read_text() == "mine"
    assert [name for name in names(tmp_path) if name.endswith(".part")] == []


def test_write_atomically_leaves_other_names_of_the_file_alone(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("mine")
    (tmp_path / "a").hardlink_to(tmp_path / "mine")
    write_atomically(tmp_path / "a", "new")
    assert ((tmp_path / "mine").read_text(), (tmp_path / "a").read_text()) == ("mine", "new")


def test_what_is_to_be_new_takes_the_place_of_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_new(tmp_path / "a", "new")
    assert (tmp_path / "a").read_text() == "new"
    with pytest.raises(OutputError, match=r"a: already exists; choose another name\.$"):
        write_new(tmp_path / "a", "newer")
    # Somebody writes it between the look and the deed; with and without hard links.
    for links in (True, False):
        path = tmp_path / f"links {links}"
        monkeypatch.setattr(files, "refuse_taken", lambda path: None)
        if not links:
            monkeypatch.setattr(os, "link", refused)
        path.write_text("mine")
        if links:
            with pytest.raises(OutputError, match=r"cannot be written \(File exists\)"):
                write_new(path, "new")
            assert path.read_text() == "mine"
        else:
            path.unlink()
            write_new(path, "new")
            assert path.read_text() == "new"
    assert not [name for name in names(tmp_path) if name.endswith(".part")]


def test_what_leads_to_no_folder_is_refused_before_work_is_done(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "nowhere").symlink_to("none")
    (tmp_path / "file").touch()
    for name, why in (
        ("loop", "Too many levels of symbolic links"),
        ("nowhere", "No such file or directory"),
        ("none", "No such file or directory"),
        ("file", "Not a directory"),
    ):
        with pytest.raises(OutputError) as caught:
            refuse_taken(tmp_path / name / "job.toml")
        assert str(caught.value) == f"{tmp_path / name}/job.toml: cannot be written ({why})."


def refused(*_: object, **__: object) -> None:
    raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))


def test_write_atomically_stays_in_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder gives way to a link to another, at every single operation."""
    done, n = False, 0
    while not done:
        here, home, away = (tmp_path / f"{name}{n}" for name in ("here", "home", "away"))
        here.mkdir()
        home.mkdir()
        (home / "a").write_text("mine")
        with monkeypatch.context() as patched:
            swapped = at_operation(patched, n, lambda here=here, home=home, away=away: swap(here, away, home))
            with contextlib.suppress(OutputError):
                write_atomically(here / "a", "new")
        done = not swapped
        assert {path.name: path.read_text() for path in home.iterdir()} in (
            {"a": "mine"},
            # Swapped before the folder was opened: the user's path leads there, and what he named is replaced.
            {"a": "new"},
        )
        if n > 0:
            assert (home / "a").read_text() == "mine"
        n += 1
    assert n > 5


def failing_of_folders(number: int) -> Callable[[int], None]:
    """What brings files to the disk, but no folder."""

    def fsync(handle: int) -> None:
        if stat.S_ISDIR(os.fstat(handle).st_mode):
            raise OSError(number, os.strerror(number))

    return fsync


@pytest.mark.parametrize("unnamed", [True, False])
def test_a_name_that_does_not_reach_the_disk_does_not_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, unnamed: bool
) -> None:
    if not unnamed:
        monkeypatch.setattr(os, "O_TMPFILE", 0, raising=False)
    monkeypatch.setattr(os, "fsync", failing_of_folders(errno.EIO))
    with pytest.raises(OutputError, match="Input/output error"):
        write_new(tmp_path / "a", "new")
    assert names(tmp_path) == []


@pytest.mark.parametrize("number", [errno.EINVAL, errno.ENOSYS, errno.ENOTSUP])
def test_a_file_system_that_brings_no_folders_to_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    monkeypatch.setattr(os, "fsync", failing_of_folders(number))
    write_new(tmp_path / "a", "new")
    write_atomically(tmp_path / "a", "newer")
    assert (tmp_path / "a").read_text() == "newer"


def test_of_files_that_belong_together_none_stays_where_one_cannot_be_written(tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    write_together({first: "1", second: b"2"})
    assert (first.read_text(), second.read_text()) == ("1", "2")
    first.unlink()
    with pytest.raises(OutputError, match="already exists"):
        write_together({first: "3", second: "4"})
    assert names(tmp_path) == ["second"]
    assert second.read_text() == "2"


@pytest.mark.parametrize("unnamed", [True, False])
@pytest.mark.parametrize("operation", ["link", "fsync"])
@pytest.mark.parametrize("count", [1, 2])
def test_ctrl_c_as_a_file_gets_its_name_leaves_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, unnamed: bool, operation: str, count: int
) -> None:
    if not unnamed:
        monkeypatch.setattr(os, "O_TMPFILE", 0, raising=False)
    works, paths = getattr(os, operation), [tmp_path / "a", tmp_path / "b"][:count]

    def interrupted(*arguments: object, **options: object) -> None:
        works(*arguments, **options)
        if paths[-1].exists():
            raise KeyboardInterrupt

    monkeypatch.setattr(os, operation, interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_together(dict.fromkeys(paths, "new"))
    assert names(tmp_path) == []


def test_what_took_the_place_of_one_of_several_files_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write = files.write_atomically

    def another(path: Path, data: bytes | str, *, new: bool = False) -> os.stat_result:
        if path.name == "second":
            (tmp_path / "theirs").write_text("theirs")
            (tmp_path / "theirs").replace(tmp_path / "first")
            raise KeyboardInterrupt
        return write(path, data, new=new)

    monkeypatch.setattr(files, "write_atomically", another)
    with pytest.raises(KeyboardInterrupt):
        write_together({tmp_path / "first": "1", tmp_path / "second": "2"})
    assert (tmp_path / "first").read_text() == "theirs"


def test_write_atomically_says_why_it_cannot(tmp_path: Path) -> None:
    with pytest.raises(OutputError) as caught:
        write_atomically(tmp_path / "no" / "a", "")
    assert str(caught.value) == f"{tmp_path / 'no' / 'a'}: cannot be written (No such file or directory)."
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError, match="is not the name of a file"):
        write_atomically(tmp_path / "a\0b", "")
    assert names(tmp_path) == ["folder"]


def test_a_file_is_written_where_there_is_no_proc(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As where a folder has been made the root (chroot) without it: a file without a name gets none."""
    monkeypatch.setattr(files, "_by_number", lambda handle: f"{tmp_path}/proc/self/fd/{handle}")
    write_new(tmp_path / "a", "new")
    write_atomically(tmp_path / "a", "newer")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a": "newer"}


@pytest.mark.skipif(as_root, reason="root writes anywhere")
def test_write_atomically_in_a_read_only_folder(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(OutputError, match="Permission denied"):
        write_atomically(tmp_path / "a", "")
    tmp_path.chmod(0o700)


def test_a_killed_writer_leaves_the_old_contents_or_the_new(tmp_path: Path) -> None:
    path = tmp_path / "a"
    old, new = b"o" * 2_000_000, b"n" * 2_000_000
    write_atomically(path, old)
    code = (
        "from pathlib import Path; from calib.foundations.files import write_atomically\n"
        f"print('go', flush=True)\nwhile True: write_atomically(Path({str(path)!r}), b'n' * 2_000_000)"
    )
    for delay in (0.0, 0.003, 0.011):
        with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as writer:
            writer.stdout.readline()
            time.sleep(delay)
            writer.kill()
        assert path.read_bytes() in (old, new)


def test_every_error_is_a_calib_error() -> None:
    assert issubclass(OutputError, CalibError)
    assert issubclass(OutputError, OSError)
