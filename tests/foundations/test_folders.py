"""Folders appear whole or not at all, what a killed run leaves is put right, and nothing else is ever touched."""

import contextlib
import errno
import json
import os
import shutil
import stat
import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from calib.foundations import folders
from calib.foundations.errors import OutputError
from calib.foundations.files import opened_folder
from calib.foundations.folders import made_folder, reading_folder, refuse_unwritable, write_folder
from tests.support.swaps import OURS, at_operation, fill, left, swap

OLD = dict.fromkeys(OURS, "old")
NEW = dict.fromkeys(OURS[:2], "new")
HIDDEN = ".out.0123abcd.calib"


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def texts(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir()}


def tree(folder: Path) -> dict[str, tuple[int, int, str]]:
    """Everything below a folder: kind and permissions, number, and contents of files or where a link leads."""
    found = {}
    for path in sorted(folder.rglob("*")):
        told = path.lstat()
        held = ""
        if path.is_symlink():
            held = str(path.readlink())
        elif path.is_file():
            held = path.read_text()
        found[str(path.relative_to(folder))] = (told.st_mode, told.st_ino, held)
    return found


def precious(folder: Path) -> Path:
    """Somebody's folder, which looks as much like ours as it can, to be reached by a link."""
    left(folder)
    for place in (folder, folder / "old", folder / "new", fill(folder / "out", OLD)):
        (place / "thesis.tex").write_text("mine")
        fill(place / "sub", {"letter.txt": "mine", **OLD})
    for name in OURS:
        (folder / name).write_text("mine")
    return folder


# As it is meant. ----------------------------------------------------------------------------------------------------


def test_write_folder(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "out"
    for content in ("first", b"second \xff"):
        write_folder(out, {"a": content}, ("a",))
        assert (out / "a").read_bytes() == (content if isinstance(content, bytes) else content.encode())
        assert names(out.parent) == ["out"]


def test_a_hidden_folder_that_cannot_be_entered_does_not_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As with a umask that takes the user's own permissions; root would enter it all the same."""

    def entered(path: str | Path, inside: int | None = None) -> contextlib.AbstractContextManager[int]:
        if inside is not None:
            raise PermissionError(errno.EACCES, "Permission denied")
        return opened_folder(path)

    monkeypatch.setattr(folders, "opened_folder", entered)
    with pytest.raises(OutputError, match="Permission denied"):
        write_folder(tmp_path / "out", NEW)
    assert names(tmp_path) == []


@pytest.mark.parametrize("umask", [0o777, 0o400, 0o200, 0o100])
def test_a_umask_that_takes_the_users_own_permissions_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, umask: int
) -> None:
    """Else a fleet would start processes that cannot speak to each other, and show the traceback of every one."""
    before = os.umask(umask)
    try:
        monkeypatch.setattr(os, "geteuid", lambda: 0)
        refuse_unwritable(tmp_path / "out")
        monkeypatch.setattr(os, "geteuid", lambda: 1000)
        with pytest.raises(OutputError, match=f"the umask {umask:04o} takes"):
            refuse_unwritable(tmp_path / "out")
    finally:
        assert os.umask(before) == umask


def test_a_folder_that_stays_where_it_is_needs_no_rights_above_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fleet writes within its folder, such as one that is mounted in a container; it was refused."""
    (out := tmp_path / "out").mkdir()
    real = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != tmp_path and real(path, mode))
    refuse_unwritable(out, exchanged=False)
    for path, exchanged in ((out, True), (tmp_path / "new", False)):
        with pytest.raises(OutputError, match=f"cannot be written, as {tmp_path} is read-only"):
            refuse_unwritable(path, exchanged=exchanged)


@pytest.mark.parametrize("umask", [0o077, 0o022, 0o002])
def test_folders_and_files_obey_the_umask(tmp_path: Path, umask: int) -> None:
    before = os.umask(umask)
    try:
        for _ in range(2):
            write_folder(tmp_path / "deep" / "out", NEW, OURS)
    finally:
        os.umask(before)
    for path in (tmp_path / "deep", tmp_path / "deep" / "out"):
        assert path.stat().st_mode & 0o777 == 0o777 & ~umask
    for name in NEW:
        assert (tmp_path / "deep" / "out" / name).stat().st_mode & 0o777 == 0o666 & ~umask


@pytest.mark.parametrize("mode", [0o700, 0o2770, 0o775, 0o1777])
def test_a_folder_that_is_replaced_lets_in_whom_it_let_in(tmp_path: Path, mode: int) -> None:
    out = fill(tmp_path / "out", OLD)
    out.chmod(mode)
    write_folder(out, NEW, OURS)
    assert texts(out) == NEW
    assert stat.S_IMODE(out.stat().st_mode) == mode


@pytest.mark.parametrize(("mode", "other"), [(0o2770, 0o700), (0o775, 0o755), (0o705, 0o755)])
def test_a_group_that_cannot_be_kept_gives_no_other_group_its_rights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: int, other: int
) -> None:
    out = fill(tmp_path / "out", OLD)
    out.chmod(mode)
    found, given = folders.lstat, []

    def of_another_group(name: str, folder: int) -> os.stat_result | None:
        told = found(name, folder)
        if told is None or name != "out":
            return told
        return os.stat_result((*told[:5], told.st_gid + 1, *told[6:10]))

    def refuse(handle: int, user: int, group: int) -> None:
        given.append((user, group))
        raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))

    monkeypatch.setattr(folders, "lstat", of_another_group)
    monkeypatch.setattr(os, "fchown", refuse)
    write_folder(out, NEW, OURS)
    assert given == [(-1, tmp_path.stat().st_gid + 1)]
    assert stat.S_IMODE(out.stat().st_mode) == other


# Of an access control list: whom an entry is for, by kind; what all but the owner and others may at most.
USER, ONE, GROUP, MOST, OTHERS = 1, 2, 4, 16, 32
ACCESS, DEFAULT = "system.posix_acl_access", "system.posix_acl_default"


def listed(*entries: tuple[int, int]) -> bytes:
    """Return an access control list as Linux keeps it: kinds, and what each may; a user that is named has number 0."""
    return struct.pack("<I", 2) + b"".join(
        struct.pack("<HHI", kind, may, 0 if kind == ONE else 0xFFFFFFFF) for kind, may in entries
    )


def set_list(folder: Path, name: str, entries: bytes) -> None:
    try:
        os.setxattr(folder, name, entries)
    except (AttributeError, OSError):
        pytest.skip("this file system has no access control lists")


def list_of(folder: Path, name: str) -> bytes | None:
    return os.getxattr(folder, name) if name in os.listxattr(folder) else None


# One user is let in, and the group of the folder is not; its mode says of neither.
ONE_USER = listed((USER, 7), (ONE, 7), (GROUP, 0), (MOST, 7), (OTHERS, 0))


def test_a_folder_that_is_replaced_keeps_its_access_control_lists(tmp_path: Path) -> None:
    out = fill(tmp_path / "out", OLD)
    set_list(out, ACCESS, ONE_USER)
    set_list(out, DEFAULT, ONE_USER)
    write_folder(out, NEW, OURS)
    assert texts(out) == NEW
    assert (list_of(out, ACCESS), list_of(out, DEFAULT)) == (ONE_USER, ONE_USER)
    assert stat.S_IMODE(out.stat().st_mode) == 0o770


def test_a_folder_that_is_replaced_takes_no_list_of_the_folder_above(tmp_path: Path) -> None:
    out = fill(tmp_path / "out", OLD)
    out.chmod(0o750)
    set_list(tmp_path, DEFAULT, ONE_USER)
    write_folder(out, NEW, OURS)
    assert (list_of(out, ACCESS), list_of(out, DEFAULT)) == (None, None)
    assert stat.S_IMODE(out.stat().st_mode) == 0o750


def test_a_list_that_cannot_be_kept_gives_no_group_its_rights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))

    out = fill(tmp_path / "out", OLD)
    set_list(out, ACCESS, ONE_USER)
    monkeypatch.setattr(os, "setxattr", refuse)
    write_folder(out, NEW, OURS)
    assert stat.S_IMODE(out.stat().st_mode) == 0o700


def test_a_folder_whose_name_does_not_reach_the_disk_gives_way_to_the_old_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fsync(handle: int) -> None:
        if os.path.samestat(os.fstat(handle), tmp_path.stat()) and "new" in (tmp_path / "out" / OURS[0]).read_text():
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    out = fill(tmp_path / "out", OLD)
    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(OutputError, match="Input/output error"):
        write_folder(out, NEW, OURS)
    assert texts(out) == OLD
    assert names(tmp_path) == ["out"]


def test_only_its_user_can_enter_what_is_half_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []

    def create(name: str, folder: int, data: bytes) -> None:
        seen.extend(path.stat().st_mode & 0o777 for path in tmp_path.iterdir())

    monkeypatch.setattr(folders, "create", create)
    write_folder(tmp_path / "out", NEW)
    assert seen == [0o700] * (1 + len(NEW))


@pytest.mark.parametrize("error", [KeyError("x"), KeyboardInterrupt(), OSError(28, "No space left on device")])
def test_whatever_goes_wrong_leaves_a_whole_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    """An error, a Ctrl-C or a full disk at every single operation."""

    def fail() -> None:
        raise error

    n, failed = 0, [0]
    while failed:
        place = tmp_path / str(n)
        fill(place / "out", OLD)
        with monkeypatch.context() as patched:
            failed = at_operation(patched, n, fail)
            try:
                write_folder(place / "out", NEW, OURS)
            except (OutputError, type(error)) as e:
                said = f"{place / 'out'}: the results cannot be written (No space left on device)."
                assert str(e) in (said, str(error))
                assert isinstance(e, OutputError) == isinstance(error, OSError)
        with reading_folder(place / "out"):
            assert texts(place / "out") in (OLD, NEW)
        write_folder(place / "out", NEW, OURS)
        assert texts(place / "out") == NEW
        assert names(place) == ["out"]
        n += 1
    assert n > 30


@pytest.mark.parametrize("old", [True, False])
def test_ctrl_c_behind_every_operation_leaves_nothing_beside_a_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, old: bool
) -> None:
    """It is heeded when an operation has been done: a hidden folder that was just made stayed."""

    def pressed() -> None:
        raise KeyboardInterrupt

    n, happened = 0, [0]
    while happened:
        place = tmp_path / str(n)
        place.mkdir()
        if old:
            fill(place / "out", OLD)
        with monkeypatch.context() as patched, contextlib.suppress(KeyboardInterrupt):
            happened = at_operation(patched, n, pressed, after=True)
            write_folder(place / "out", NEW, OURS)
        assert names(place) in (["out"], [] if not old else ["out"]), n
        assert not (place / "out").exists() or texts(place / "out") in (OLD, NEW)
        n += 1
    assert n > 30


def test_an_error_leaves_nothing_of_a_new_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(folders, "create", full)
    for out in (tmp_path / "out", tmp_path / "deep" / "er" / "out"):
        with pytest.raises(OutputError, match="No space left on device"):
            write_folder(out, NEW)
        assert names(tmp_path) == []


def test_write_folder_says_why_it_cannot(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("mine")
    link = tmp_path / "link"
    link.symlink_to("file")
    for out, why in (
        (file, "is a file or a link, and the results need a folder."),
        (file / "out", "the results cannot be written (File exists)."),
        (link, "is a file or a link, and the results need a folder."),
        (tmp_path / ("x" * 300), "the results cannot be written (File name too long)."),
    ):
        with pytest.raises(OutputError) as caught:
            write_folder(out, NEW, OURS)
        assert str(caught.value) == f"{out}: {why}"
    assert (names(tmp_path), file.read_text()) == (["file", "link"], "mine")


def test_the_root_is_a_folder_as_others() -> None:
    """It has no folder above, and no name."""
    refuse_unwritable(Path("/"))
    with pytest.raises(OutputError, match=r"^/: already exists"):
        write_folder(Path("/"), {"a": "b"})


def test_a_new_folder_never_takes_the_place_of_another(tmp_path: Path) -> None:
    fill(tmp_path / "out", {"letter.txt": "mine"})
    before = tree(tmp_path)
    with pytest.raises(OutputError, match="already exists; choose another name"):
        write_folder(tmp_path / "out", NEW)
    assert tree(tmp_path) == before


def test_of_the_old_folder_only_listed_regular_files_are_removed(tmp_path: Path) -> None:
    home = precious(tmp_path / "home")
    before = tree(home)
    out = fill(tmp_path / "out", {"result.json": "old", "letter.txt": "mine"})
    fill(out / "sub", {"letter.txt": "mine", "result.json": "mine"})
    fill(out / "report.html", {"letter.txt": "mine"})  # called as a result, and none
    (out / "link").symlink_to(home)
    (out / "model.json").hardlink_to(home / "thesis.tex")
    os.mkfifo(out / "pipe")
    write_folder(out, NEW, OURS)
    assert tree(home) == before
    assert names(out) == ["letter.txt", "link", "model.json", "pipe", "report.html", "result.json", "sub"]
    assert (out / "model.json").read_text() == (out / "result.json").read_text() == "new"
    assert texts(out / "sub") == {"letter.txt": "mine", "result.json": "mine"}
    assert texts(out / "report.html") == {"letter.txt": "mine"}
    assert names(tmp_path) == ["home", "out"]


def test_what_would_collide_stays_in_the_hidden_folder(tmp_path: Path) -> None:
    out = tmp_path / "out"
    fill(out / "model.json", {"letter.txt": "mine"})
    write_folder(out, NEW, OURS)
    assert texts(out) == NEW
    (hidden,) = (path for path in tmp_path.iterdir() if path != out)
    write_folder(out, NEW, OURS)
    assert texts(hidden / "old" / "model.json") == {"letter.txt": "mine"}


# What a killed run left. --------------------------------------------------------------------------------------------


def test_killed_between_the_two_steps(tmp_path: Path) -> None:
    left(tmp_path / HIDDEN)
    with reading_folder(tmp_path / "out"):
        pass
    assert texts(tmp_path / "out") == dict.fromkeys(OURS, "old")
    write_folder(tmp_path / "out", NEW, OURS)
    assert texts(tmp_path / "out") == NEW
    assert names(tmp_path) == ["out"]


def test_killed_before_the_old_one_was_removed(tmp_path: Path) -> None:
    left(tmp_path / HIDDEN, new=False)
    (tmp_path / HIDDEN / "old" / "notes.txt").write_text("mine")
    fill(tmp_path / "out", NEW)
    with reading_folder(tmp_path / "out"):
        pass
    assert texts(tmp_path / "out") == NEW
    write_folder(tmp_path / "out", NEW, OURS)
    assert texts(tmp_path / "out") == {**NEW, "notes.txt": "mine"}
    assert names(tmp_path) == ["out"]


def test_what_is_half_removed_does_not_come_back(tmp_path: Path) -> None:
    """Killed as it removed the old folder, after which somebody removed the new one."""
    left(tmp_path / HIDDEN, new=False)
    with reading_folder(tmp_path / "out"):
        assert names(tmp_path) == [HIDDEN]
    write_folder(tmp_path / "out", NEW, OURS)
    assert names(tmp_path) == ["out"]


def test_an_old_folder_whose_place_somebody_took_is_kept(tmp_path: Path) -> None:
    """Killed between the two steps, after which somebody put another folder there: that is not the successor."""
    left(tmp_path / HIDDEN)
    fill(tmp_path / "out", {"letter.txt": "mine"})
    write_folder(tmp_path / "out", NEW, OURS)
    assert texts(tmp_path / "out") == {**NEW, "letter.txt": "mine"}
    assert texts(tmp_path / HIDDEN / "old") == dict.fromkeys(OURS, "old")


def test_a_new_folder_that_is_taken_away_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As by a program that tidies up for the same user."""
    out = fill(tmp_path / "out", OLD)
    rename = os.rename

    def hindered(src: str, dst: str, **handles: int) -> None:
        if (src, dst) == ("new", "out"):
            shutil.rmtree(next(tmp_path.glob(".out.*.calib")) / "new")
        rename(src, dst, **handles)

    monkeypatch.setattr(os, "rename", hindered)
    with pytest.raises(OutputError, match="the results cannot be written"):
        write_folder(out, NEW, OURS)
    assert texts(out) == OLD
    assert names(tmp_path) == ["out"]


def test_a_place_that_is_taken_at_the_last_moment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fill(tmp_path / "out", OLD)
    rename = os.rename

    def late(name: str, to: str, **options: int) -> None:
        if name == "new":
            fill(tmp_path / "out", {"letter.txt": "mine"})
        rename(name, to, **options)

    monkeypatch.setattr(os, "rename", late)
    with pytest.raises(OutputError) as caught:
        write_folder(tmp_path / "out", NEW, OURS)
    (hidden,) = (path for path in tmp_path.iterdir() if path.name != "out")
    assert str(caught.value) == (
        f"{tmp_path / 'out'}: another has taken its place meanwhile; what was there is {hidden / 'old'}."
    )
    assert texts(tmp_path / "out") == {"letter.txt": "mine"}
    assert texts(hidden / "old") == OLD


@pytest.mark.parametrize("old", [OLD, {}])
@pytest.mark.parametrize(
    ("number", "why"),
    [
        (errno.EBUSY, "is a mount point, which cannot be replaced; choose a folder inside"),
        (
            errno.EXDEV,
            "is part of what a container was started from (a lower layer of an overlay), where folders cannot be "
            "moved; remove it or choose another one",
        ),
    ],
)
def test_why_a_folder_cannot_be_moved_is_told(
    number: int, why: str, old: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fill(tmp_path / "out", old)

    def kept(name: str, to: str, **_: int) -> None:
        assert "out" in (name, to)
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "rename", kept)
    with pytest.raises(OutputError) as caught:
        write_folder(tmp_path / "out", NEW, OURS if old else ())
    assert str(caught.value) == f"{tmp_path / 'out'}: {why}."
    assert texts(tmp_path / "out") == old
    assert names(tmp_path) == ["out"]


def _no_list(hidden: Path) -> None:
    (hidden / "list.json").unlink()


def _empty_list(hidden: Path) -> None:
    (hidden / "list.json").write_text("")


def _other_list(hidden: Path) -> None:
    (hidden / "list.json").write_text(json.dumps({"calib": "mine", "files": OURS}))


def _no_json(hidden: Path) -> None:
    (hidden / "list.json").write_text("[" * 100_000)


def _a_list(hidden: Path) -> None:
    (hidden / "list.json").write_text("[1]")


def _linked_list(hidden: Path) -> None:
    (hidden / "list.json").rename(hidden.with_name("list.json"))
    (hidden / "list.json").symlink_to(hidden.with_name("list.json"))


def _hard_linked_list(hidden: Path) -> None:
    hidden.with_name("list.json").hardlink_to(hidden / "list.json")


def _pipe(hidden: Path) -> None:
    (hidden / "list.json").unlink()
    os.mkfifo(hidden / "list.json")


def _folder(hidden: Path) -> None:
    (hidden / "list.json").unlink()
    (hidden / "list.json").mkdir()


def _link(hidden: Path) -> None:
    hidden.rename(hidden.with_name("elsewhere"))
    hidden.symlink_to("elsewhere")


def _other_name(hidden: Path) -> None:
    hidden.rename(hidden.with_name(".out.backup01.calib"))


def _older_name(hidden: Path) -> None:
    shutil.copytree(hidden / "old", hidden.with_name(".out.previous"))
    hidden.rename(hidden.with_name(".out.0123abcd.new"))


@pytest.mark.parametrize(
    "made",
    [
        *(_no_list, _empty_list, _other_list, _no_json, _a_list, _linked_list, _hard_linked_list),
        *(_pipe, _folder, _link, _other_name, _older_name),
    ],
)
@pytest.mark.parametrize("there", [False, True])
def test_what_no_run_left_is_nobodys_business(tmp_path: Path, made: Callable[[Path], None], there: bool) -> None:
    made(left(tmp_path / HIDDEN))
    if there:
        fill(tmp_path / "out", OLD)
    before = {name: told for name, told in tree(tmp_path).items() if not name.startswith("out")}
    with reading_folder(tmp_path / "out"):
        assert (tmp_path / "out").exists() == there
    write_folder(tmp_path / "out", NEW, OURS)
    assert texts(tmp_path / "out") == NEW
    assert {name: told for name, told in tree(tmp_path).items() if not name.startswith("out")} == before


@pytest.mark.parametrize("foreign", ["folder", "list"])
def test_what_another_user_left_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, foreign: str) -> None:
    hidden = left(tmp_path / HIDDEN)
    told = os.fstat
    number = (hidden if foreign == "folder" else hidden / "list.json").stat().st_ino

    def fstat(handle: int) -> os.stat_result:
        found = told(handle)
        if found.st_ino != number:
            return found
        return os.stat_result([*found[:4], os.geteuid() + 1, *found[5:10]])

    monkeypatch.setattr(os, "fstat", fstat)
    before = tree(hidden)
    with reading_folder(tmp_path / "out"):
        assert not (tmp_path / "out").exists()
    write_folder(tmp_path / "out", NEW, OURS)
    assert tree(hidden) == before


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_what_is_given_to_another_user_is_left_alone(tmp_path: Path) -> None:
    hidden = left(tmp_path / HIDDEN)
    os.chown(hidden, 12345, 12345)
    before = tree(hidden)
    write_folder(tmp_path / "out", NEW, OURS)
    assert tree(hidden) == before


def test_a_list_that_names_other_folders_reaches_nothing_there(tmp_path: Path) -> None:
    """As an archive of a stranger may bring along, unpacked by this user."""
    home = precious(tmp_path / "home")
    hidden = left(
        tmp_path / HIDDEN, new=False, listed=["../../home/thesis.tex", "..", "sub", "link", "hard", str(home)]
    )
    fill(tmp_path / "out", OLD)
    for part in ("old", "sub"):
        fill(hidden / "old" / "sub" / part, {"link": "mine"})
    (hidden / "old" / "link").symlink_to(home)
    (hidden / "old" / "hard").hardlink_to(home / "sub" / "letter.txt")
    before = tree(home)
    write_folder(tmp_path / "out", NEW, OURS)
    assert tree(home) == before
    assert (tmp_path / "out" / "link").readlink() == home
    assert (tmp_path / "out" / "sub" / "old" / "link").read_text() == "mine"


@pytest.mark.parametrize("part", ["old", "new"])
@pytest.mark.parametrize("kind", ["link", "file", "pipe"])
def test_parts_that_are_no_folders(tmp_path: Path, part: str, kind: str) -> None:
    home = precious(tmp_path / "home")
    before = tree(home)
    hidden = left(tmp_path / HIDDEN, **{part: False})
    match kind:
        case "link":
            (hidden / part).symlink_to(home)
        case "file":
            (hidden / part).write_text("mine")
        case _:
            os.mkfifo(hidden / part)
    fill(tmp_path / "out", OLD)
    with reading_folder(tmp_path / "out"):
        pass
    write_folder(tmp_path / "out", NEW, OURS)
    assert tree(home) == before
    assert texts(tmp_path / "out") == NEW
    assert (
        stat.S_IFMT((hidden / part).lstat().st_mode)
        == {
            "link": stat.S_IFLNK,
            "file": stat.S_IFREG,
            "pipe": stat.S_IFIFO,
        }[kind]
    )


@pytest.mark.parametrize("kind", ["link", "file", "pipe"])
def test_what_is_no_folder_is_not_put_back(tmp_path: Path, kind: str) -> None:
    """Such as a link in an archive of somebody else: it became ``out``, and the next run replaced what it leads to."""
    home = fill(tmp_path / "home", OLD)
    old = left(tmp_path / HIDDEN, old=False) / "old"
    match kind:
        case "link":
            old.symlink_to(home)
        case "file":
            old.write_text("mine")
        case _:
            os.mkfifo(old)
    with reading_folder(tmp_path / "out"):
        pass
    assert not os.path.lexists(tmp_path / "out")
    write_folder(tmp_path / "out", NEW, OURS)
    assert texts(tmp_path / "out") == NEW
    assert texts(home) == OLD
    assert os.path.lexists(old)


# Somebody who swaps folders for links meanwhile. --------------------------------------------------------------------


def _hidden(place: Path) -> Path | None:
    return next((path for path in place.iterdir() if path.name.endswith(".calib")), None)


SWAPPED: dict[str, Callable[[Path], Path | None]] = {
    "out": lambda place: place / "out",
    "hidden": _hidden,
    "new": lambda place: None if _hidden(place) is None else _hidden(place) / "new",
    "old": lambda place: None if _hidden(place) is None else _hidden(place) / "old",
    "above": lambda place: place,
}


def _write(place: Path) -> None:
    write_folder(place / "out", NEW, OURS)


def _read(place: Path) -> None:
    with reading_folder(place / "out"):
        pass


@pytest.mark.parametrize("what", SWAPPED)
@pytest.mark.parametrize("before", ["whole", "aside", "removed"])
@pytest.mark.parametrize("act", [_write, _read])
def test_swapped_at_every_operation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str, before: str, act: Callable[[Path], None]
) -> None:
    """A link to somebody's folder takes a folder's place: nothing that it leads to is changed."""
    home = precious(tmp_path / "home")
    told = tree(home)
    n, swapped = 0, [0]
    while swapped:
        place = tmp_path / f"place{n}"
        place.mkdir()
        if before != "aside":
            fill(place / "out", OLD)
        if before != "whole":
            left(place / HIDDEN, new=before == "aside")

        def at(place: Path = place, away: str = f"away{n}") -> None:
            path = SWAPPED[what](place)
            if path is not None and path.parent.is_dir():
                swap(path, path.with_name(away), home)

        with monkeypatch.context() as patched:
            swapped = at_operation(patched, n, at)
            try:
                act(place)
            except OutputError as e:
                assert str(e).count("\n") == 0
        # Before the folder above is opened, the user's path itself leads elsewhere: that is what is named then.
        if (what, act) == ("above", _write) and tree(home) != told:
            assert n < 20
            shutil.rmtree(home)
            told = tree(precious(home))
        assert tree(home) == told, n
        n += 1
    assert n > (30 if act is _write else 5)


@pytest.mark.parametrize("target", ["nowhere", "link"], ids=["nowhere", "circle"])
def test_a_folder_below_a_link_that_leads_nowhere_is_refused_for_that(tmp_path: Path, target: str) -> None:
    """It said that a file exists."""
    link = tmp_path / "link"
    link.symlink_to(target)
    said = f"cannot be made, as {link} is a link that leads nowhere"
    with pytest.raises(OutputError, match=said):
        write_folder(link / "board", {"a": b"1"})
    with pytest.raises(OutputError, match=said), made_folder(link):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["link"]
