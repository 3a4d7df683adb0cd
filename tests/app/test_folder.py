"""The private folder of the page: names, sizes, and what leaves it."""

import errno
import fcntl
import io
import os
import shutil
import stat
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from calib.app.folder import (
    MOST_OF_ARCHIVE,
    RESULT,
    SESSION,
    apart,
    as_zip,
    chosen,
    gather,
    kind_of,
    name_here,
    plain_name,
    private_folder,
    refuse_links,
    refuse_other_files,
    remove,
    take,
    unpacked,
)
from calib.foundations.errors import OutputError
from calib.foundations.folders import alone_with


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        ("measured.csv", "measured.csv"),
        ("../../etc/passwd.csv", "passwd.csv"),
        ("C:\\data\\arm.urdf", "arm.urdf"),
        (".hidden.csv", "_hidden.csv"),
        ("..csv", "_csv"),
        ("<img onerror=x>.csv", "_img onerror_x_.csv"),
        ("a\nb\0c.csv", "a_b_c.csv"),
        ("Größe.csv", "Gr__e.csv"),
        ("x" * 300 + ".csv", "x" * 100 + ".csv"),
        ("-rf.csv", "_rf.csv"),
        ("", "file"),
    ],
)
def test_names_are_made_plain(name: str, plain: str) -> None:
    assert plain_name(name) == plain
    assert plain_name(plain) == plain


def test_what_is_none_of_ours_is_said() -> None:
    assert [kind_of(n) for n in ("a.URDF", "a.csv", "a.toml", "a.JPG")] == ["robot", "table", "settings", "photograph"]
    with pytest.raises(
        OutputError, match=r"^'a\.exe': is no robot, mesh, table, photograph or job; their names end with"
    ):
        kind_of("a.exe")


def test_a_file_stays_in_the_folder_whatever_it_is_called(tmp_path: Path) -> None:
    folder = tmp_path / "work"
    folder.mkdir()
    assert take(folder, "../up.csv", b"1", {}) == "up.csv"
    assert take(folder, "/tmp/x.png", b"1", {}) == "x.png"
    assert sorted(str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*.*")) == [
        "work/photographs/x.png",
        "work/up.csv",
    ]
    (folder / "link.csv").symlink_to("/etc/passwd")
    with pytest.raises(OutputError):
        take(folder, "link.csv", b"1", {})
    assert (folder / "link.csv").is_symlink()


def test_files_have_bounds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calib.app.folder.LARGEST_FILE", 10)
    monkeypatch.setattr("calib.app.folder._LARGEST_SUM", 15)
    monkeypatch.setattr("calib.app.folder._MOST_FILES", 2)
    with pytest.raises(OutputError, match=r"'a\.csv': is too large"):
        take(tmp_path, "a.csv", b"x" * 11, {})
    with pytest.raises(OutputError, match=r"'a\.csv': is too large"):
        take(tmp_path, "a.csv", b"x" * 9, {"b.csv": 7})
    take(tmp_path, "a.csv", b"x" * 9, {"a.csv": 10})
    with pytest.raises(OutputError, match=r"'c\.csv': is one file more than the 2"):
        take(tmp_path, "c.csv", b"x", {"a.csv": 1, "b.csv": 1})
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]


def test_the_folder_is_private_and_was_empty(tmp_path: Path) -> None:
    for given in (None, tmp_path / "new" / "one", tmp_path / "there"):
        if given == tmp_path / "there":
            given.mkdir(mode=0o755)
        with private_folder(given) as place:
            assert stat.S_IMODE(place.stat().st_mode) == 0o700
            (place / "a.csv").write_text("1")
        assert place.exists() == (given is not None)
    for taken in (tmp_path / "there", tmp_path / "there" / "a.csv", tmp_path / "there" / "a.csv" / "x"):
        with pytest.raises(OutputError, match=r"choose another|cannot be made"), private_folder(taken):
            pytest.fail("was given")


def _killed(place: Path) -> Path:
    """Serve a page from a temporary folder beside others, and kill it; return what it leaves."""
    code = (
        "import os, sys, tempfile; from calib.app.folder import private_folder; tempfile.tempdir = sys.argv[1]\n"
        "with private_folder(None) as place:\n"
        "    (place / 'robot').mkdir(); (place / 'robot' / 'arm.urdf').write_text('<robot/>')\n"
        "    (place / '.session.json').write_text('{}'); print(place, flush=True); os.kill(os.getpid(), 9)"
    )
    said = subprocess.run([sys.executable, "-c", code, place], stdout=subprocess.PIPE, text=True, check=False).stdout
    return Path(said.strip())


def _age(*places: Path) -> None:
    """Let two days pass since these were used."""
    for place in places:
        os.utime(place, (time.time() - 2 * 86_400,) * 2)


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    place = tmp_path / "tmp"
    place.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    return place


def test_the_temporary_folder_of_a_page_that_was_killed_goes_after_a_day(temporary: Path) -> None:
    old, new = _killed(temporary), _killed(temporary)
    _age(old)
    with private_folder(None) as place:
        assert sorted(temporary.iterdir()) == sorted([new, place])
    assert not old.exists()
    _age(new)
    with private_folder(None):
        assert not new.exists()
    assert list(temporary.iterdir()) == []


def test_a_folder_that_takes_the_place_of_one_that_goes_stays(temporary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where others may write beside it, they could have moved a folder of this user to its name."""
    _age(left := _killed(temporary))
    (precious := temporary / "precious").mkdir()
    (precious / "notes.txt").write_text("mine")

    def swapped(marker: int, *, where_unknown: bool) -> bool:
        left.rename(temporary / "elsewhere")
        precious.rename(left)
        return alone_with(marker, where_unknown=where_unknown)

    with monkeypatch.context() as during:
        during.setattr("calib.app.folder.alone_with", lambda *a, **k: swapped(*a, **k) if k else alone_with(*a))
        with private_folder(None):
            assert (left / "notes.txt").read_text() == "mine"


def test_no_folder_goes_that_is_not_left_by_a_page_that_was_killed(
    temporary: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copied, moved, kept, unmarked, linked, open_to_all = (_killed(temporary) for _ in range(6))
    there = [shutil.copytree(copied, temporary / "calib-app-copied", copy_function=shutil.copy2)]
    there.append(moved.rename(temporary / "calib-app-moved"))
    with private_folder(kept):  # it goes on, and is the user's from now on
        pass
    (unmarked / ".served").unlink()
    (linked / ".served").rename(tmp_path / "marker")
    (linked / ".served").symlink_to(tmp_path / "marker")
    open_to_all.chmod(0o755)
    (temporary / "calib-app-file").write_text("x")
    (temporary / "calib-app-link").symlink_to(tmp_path)
    there += [kept, unmarked, linked, open_to_all]
    _age(copied, *there)
    with private_folder(None) as first:
        _age(first)
        with private_folder(None):  # another page, for the one before is alive
            assert first.exists()
        assert not copied.exists()
        assert all((place / "robot" / "arm.urdf").exists() for place in there)
        _age(other := _killed(temporary))
        monkeypatch.setattr(os, "getuid", lambda: temporary.stat().st_uid + 1)
        with private_folder(None):
            assert other.exists()
    assert (temporary / "calib-app-file").exists()
    assert (temporary / "calib-app-link").is_symlink()


def test_where_no_locks_are_known_no_folder_goes(temporary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _age(left := _killed(temporary))

    def none(*_: object) -> None:
        raise OSError(errno.ENOTSUP, os.strerror(errno.ENOTSUP))

    monkeypatch.setattr(fcntl, "flock", none)
    with private_folder(None):
        assert left.exists()


def test_without_a_place_for_temporary_files_a_folder_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*_: object, **__: object) -> str:
        raise FileNotFoundError(errno.ENOENT, "No usable temporary directory found in ['/tmp']")

    monkeypatch.setattr(tempfile, "mkdtemp", none)
    with pytest.raises(OutputError) as caught, private_folder(None):
        pass
    assert str(caught.value).endswith("found in ['/tmp']); name one by --folder.")


def test_the_folder_as_one_file_has_no_links(tmp_path: Path) -> None:
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "report.html").write_text("r")
    (tmp_path / "measured.csv").write_text("m")
    (tmp_path / "link.csv").symlink_to("/etc/passwd")
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "arm_description").symlink_to("/etc")
    for name in ("tables", "photographs"):
        (tmp_path / name).symlink_to(tmp_path / "results")
    with as_zip(tmp_path) as file, zipfile.ZipFile(file) as archive:
        assert archive.namelist() == ["calibration/measured.csv", "calibration/results/report.html"]
        assert archive.read("calibration/measured.csv") == b"m"


def test_no_file_is_removed_or_replaced_behind_a_link(tmp_path: Path) -> None:
    page, others = tmp_path / "page", tmp_path / "others"
    page.mkdir()
    take(page, "arm.urdf", b"<robot/>", {})
    take(page, "m/a.stl", b"mesh", {})
    gather(page, "arm.urdf", ["package://m/a.stl"], ["m/a.stl"])
    (page / "results").mkdir()
    for name in ("robot", "meshes", "results"):
        shutil.copytree(page / name, others / name)
        shutil.rmtree(page / name)
        (page / name).symlink_to(others / name)
    for file in ("robot/arm.urdf", "robot/m/a.stl", "meshes/m/a.stl"):
        (others / file).write_bytes(b"of somebody else")
    with pytest.raises(OutputError, match=r"^'robot': is a link, which this page does not follow; move it away\.$"):
        gather(page, "arm.urdf", ["package://m/a.stl"], ["m/a.stl"])
    for told in (
        lambda: take(page, "m/a.stl", b"mesh", {"m/a.stl": 4}),
        lambda: take(page, "m/b.stl", b"mesh", {}),
        lambda: remove(page, "m/a.stl"),
        lambda: refuse_other_files(page, ["robot/new.urdf"]),
        lambda: refuse_links(page, [page / RESULT]),
    ):
        with pytest.raises(OutputError, match="is a link"):
            told()
    found = {path.relative_to(others).as_posix(): path.read_bytes() for path in others.rglob("*") if path.is_file()}
    assert found == dict.fromkeys(("robot/arm.urdf", "robot/m/a.stl", "meshes/m/a.stl"), b"of somebody else")
    take(page, "arm.urdf", b"<robot/>", {"arm.urdf": 8})  # what is in no such folder is taken


def test_the_folder_as_one_file_is_not_made_on_a_full_disk_nor_for_nobody(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "measured.csv").write_bytes(os.urandom(100_000))
    with pytest.raises(OutputError, match=r"^The archive: is not wanted any more\.$"):
        as_zip(tmp_path, wanted=lambda: False)
    if Path("/dev/full").exists():
        monkeypatch.setattr(tempfile, "TemporaryFile", lambda: Path("/dev/full").open("r+b"))  # noqa: SIM115
        with pytest.raises(OutputError, match=r"^The archive: cannot be made \(No space left on device\)\.$"):
            as_zip(tmp_path)


def test_a_folder_that_the_page_has_left_is_taken_up_unless_it_leads_elsewhere(tmp_path: Path) -> None:
    place = tmp_path / "work"
    with private_folder(place):
        (place / SESSION).write_text("{}")
    with private_folder(place) as again:
        assert again == place
    for spoil in (lambda: (place / "photographs").symlink_to("/etc"), lambda: place.chmod(0o755)):
        spoil()
        with pytest.raises(OutputError, match="neither empty nor left by this page"), private_folder(place):
            pytest.fail("was given")
        (place / "photographs").unlink(missing_ok=True)


PACKAGE = ["arm/package.xml", "arm/CMakeLists.txt", "arm/urdf/arm.urdf", "arm/config/limits.yaml"]


def test_of_a_folder_what_is_of_use_is_chosen() -> None:
    meshes = ["arm/meshes/visual/base.stl", "arm/meshes/collision/base.stl"]
    found = chosen([*PACKAGE, *meshes, "arm/meshes/visual/skin.png", "arm/.git/base.stl"])
    assert found == {"arm/urdf/arm.urdf": "arm.urdf", **{name: name for name in meshes}}
    tables = ["day 1/a.csv", "day 2/a.csv", "day 2/b.csv", "day 2/notes.pdf", "photos/1.png", "photos/old.zip"]
    assert chosen(tables) == {
        "day 1/a.csv": "day 1_a.csv",
        "day 2/a.csv": "day 2_a.csv",
        "day 2/b.csv": "b.csv",
        "photos/1.png": "1.png",
    }
    # What lies in no folder was meant: it is told what it is not.
    assert chosen(["run.exe", "a.csv"]) == {"run.exe": "run.exe", "a.csv": "a.csv"}
    with pytest.raises(OutputError, match="5001 files are too many"):
        chosen(["a"] * 5001)


def packed(contents: dict[str, bytes], **links: str) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in contents.items():
            archive.writestr(name, data)
        for name, target in links.items():
            link = zipfile.ZipInfo(name + ".csv")
            link.external_attr = (stat.S_IFLNK | 0o777) << 16
            archive.writestr(link, target)
    return file.getvalue()


def unpacked_of(data: bytes) -> dict[str, bytes]:
    return {kept: contents for kept, _, contents in unpacked(data, "arm.zip", {})}


def test_paths_without_end_are_left_out() -> None:
    """To look at the folders above a file took a time that grows with the square of their number."""
    endless = "a/" * 600 + "x.csv"
    assert chosen([endless, "t.csv"]) == {"t.csv": "t.csv"}
    assert chosen([endless], packed=True) == {}


def test_an_archive_is_unpacked_within_bounds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    inside = {
        "../../arm.urdf": b"<robot/>",
        "arm/meshes/base.stl": b"solid",
        "readme.md": b"r",
        "/etc/poses.csv": b"1\n",
    }
    found = unpacked_of(packed(inside, passwd="/etc/passwd"))
    assert found == {"arm/meshes/base.stl": b"solid", "poses.csv": b"1\n"}
    for name, data in {**found, "../../out/../base.stl": b"solid"}.items():
        take(tmp_path, name, data, {})
    left = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file())
    assert left == ["meshes/_/_/out/_/base.stl", "meshes/arm/meshes/base.stl", "poses.csv"]
    for data, sentence in (
        (b"PK nothing", "is no archive that can be read"),
        (packed({"readme.md": b"r"}), "holds no robot, mesh, table, photograph or job"),
    ):
        with pytest.raises(OutputError, match=rf"^'arm\.zip': {sentence}\.$"):
            unpacked_of(data)
    # Of what unpacks to too much, no more is read than a byte too many.
    monkeypatch.setattr("calib.app.folder.LARGEST_FILE", 100)
    name, _, much = next(unpacked(packed({"a.csv": bytes(100_000)}), "arm.zip", {}))
    assert len(much) == 101
    with pytest.raises(OutputError, match=r"'a\.csv': is too large"):
        take(tmp_path, name, much, {})
    monkeypatch.setattr("calib.app.folder._MOST_FILES", 1)
    with pytest.raises(OutputError, match="more than the 1 files"):
        unpacked_of(packed({"a.csv": b"1", "b.csv": b"1"}))


def test_meshes_are_put_where_the_robot_says_that_they_are(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text("<robot/>")
    dropped = [
        "arm-main/meshes/visual/base.stl",
        "arm-main/meshes/collision/base.stl",
        "tool.stl",
        "a/1.stl",
        "b/1.stl",
    ]
    for name in dropped:
        take(tmp_path, name, name.encode(), {})
    uris = ["package://arm/meshes/visual/base.stl", "../tool.stl", "package://arm/1.stl", "package://arm/none.stl"]
    hostile = [
        "package://../../tool.stl",
        "file:///tmp/tool.stl",
        "/etc/tool.stl",
        "a\0/tool.stl",
        "x/" * 3000 + "tool.stl",
    ]
    urdf, lost = gather(tmp_path, "arm.urdf", [*uris, *hostile], dropped)
    assert urdf == "robot/arm.urdf"
    assert lost == [*uris[2:], *hostile[1:]]
    made = {str(path.relative_to(tmp_path)) for path in (tmp_path / "robot").rglob("*") if path.is_file()}
    assert made == {"robot/arm.urdf", "robot/arm/meshes/visual/base.stl", "robot/tool.stl"}
    found = (tmp_path / "robot/arm/meshes/visual/base.stl").read_text()
    assert found == "arm-main/meshes/visual/base.stl"
    assert not (tmp_path.parent / "tool.stl").exists()
    gather(tmp_path, "arm.urdf", [], dropped)
    assert [path.name for path in (tmp_path / "robot").iterdir()] == ["arm.urdf"]


def test_what_has_taken_the_place_of_a_dropped_mesh_is_not_copied(tmp_path: Path) -> None:
    """Of a link to a device it would be copied without end."""
    (tmp_path / "secret").write_text("secret")
    (tmp_path / "arm.urdf").write_text("<robot/>")
    dropped = ["m/link.stl", "m/pipe.stl", "m/mesh.stl"]
    for name in dropped:
        take(tmp_path, name, b"solid", {})
    for name in dropped[:2]:
        (tmp_path / "meshes" / name).unlink()
    (tmp_path / "meshes/m/link.stl").symlink_to(tmp_path / "secret")
    os.mkfifo(tmp_path / "meshes/m/pipe.stl")
    uris = [f"package://{name}" for name in dropped]
    assert gather(tmp_path, "arm.urdf", uris, dropped)[1] == uris[:2]
    assert [path.name for path in (tmp_path / "robot/m").iterdir()] == ["mesh.stl"]


def test_a_mesh_at_very_many_paths_does_not_fill_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calib.app.folder._LARGEST_SUM", 1000)
    (tmp_path / "arm.urdf").write_text("<robot/>")
    take(tmp_path, "a.stl", bytes(300), {})
    uris = [f"package://m{k}/a.stl" for k in range(4)]
    assert gather(tmp_path, "arm.urdf", [*uris[:3], "package://m0//a.stl"], ["a.stl"])[1] == []
    with pytest.raises(OutputError, match=r"^'arm\.urdf': its meshes, at all paths by which it names them, have more"):
        gather(tmp_path, "arm.urdf", uris, ["a.stl"])


def test_files_that_a_person_has_put_into_the_folder_stay(tmp_path: Path) -> None:
    """They were removed with ``robot/`` at every look, and replaced by what was dropped or made under their names."""
    for name in ("arm.urdf", "mine.csv", "robot/notes.txt", "robot/m/own.stl", "tables/poses.csv"):
        (tmp_path / name).parent.mkdir(exist_ok=True, parents=True)
        (tmp_path / name).write_text("mine")
    take(tmp_path, "a.stl", b"solid", {})
    take(tmp_path, "arm.urdf", b"mine", {})  # the same again, as after a page that was killed
    for known in (False, True):  # as a page begins, and as it goes on
        assert gather(tmp_path, "arm.urdf", ["package://m/a.stl"], ["a.stl"]) == ("robot/arm.urdf", [])
        with pytest.raises(OutputError, match=r"'mine\.csv': is in the folder, but was not dropped"):
            take(tmp_path, "mine.csv", b"other", {"arm.urdf": 4} if known else {})
        with pytest.raises(OutputError, match=r"own\.stl': was not made by this page"):
            gather(tmp_path, "arm.urdf", ["package://m/own.stl"], ["own.stl"])
        with pytest.raises(OutputError, match=r"poses\.csv': was not made by this page"):
            refuse_other_files(tmp_path, ["tables/poses.csv"])
    assert {str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*.*") if p.read_text() == "mine"} == {
        *("arm.urdf", "mine.csv", "robot/notes.txt", "robot/m/own.stl", "tables/poses.csv"),
    }


@pytest.mark.parametrize("method", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_an_archive_that_is_unpacked_without_bounds_is_refused(method: int) -> None:
    """Of these zipfile unpacks all, however little is asked for: 200 kB became 3 GB of memory."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        archive.writestr("a.csv", b"1\n" * 1000)
    with pytest.raises(OutputError, match=r"^'arm\.zip': is packed by another method than the usual one"):
        unpacked_of(file.getvalue())


def test_an_archive_holds_no_more_than_is_made_of_what_was_measured() -> None:
    """Of 577 kB became two tables of 198 MB, and each kept `calib check` busy for more than a minute."""
    half = bytes(MOST_OF_ARCHIVE * 500_000)
    assert len(unpacked_of(packed({"a.csv": half, "b.csv": half}))) == 2
    refused = r"^'arm\.zip': unpacks to more than 20 MB; unpack it, and drop what is in it\.$"
    with pytest.raises(OutputError, match=refused):
        unpacked_of(packed({"a.csv": half, "b.csv": half, "c.csv": b"1"}))
    # What is of no use is not unpacked.
    assert list(unpacked_of(packed({"a.csv": half, "a.bin": half, "b.bin": half}))) == ["a.csv"]
    # A larger archive may hold more.
    noise = np.random.default_rng(0).bytes(1_500_000)
    assert list(unpacked_of(packed({"a.csv": half + half, "b.csv": noise}))) == ["a.csv", "b.csv"]


def test_an_archive_that_tells_less_than_it_holds_is_refused() -> None:
    data, said = packed({"a.csv": bytes(300_000)}), (300_000).to_bytes(4, "little")
    assert data.count(said) == 2
    with pytest.raises(OutputError, match=r"^'arm\.zip': is no archive that can be read\.$"):
        unpacked_of(data.replace(said, (3).to_bytes(4, "little")))


def test_an_archive_that_is_dropped_again_is_unpacked_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What it replaces counts no more: its files were cut off where both together were too much."""
    monkeypatch.setattr("calib.app.folder.LARGEST_FILE", 10)
    monkeypatch.setattr("calib.app.folder._LARGEST_SUM", 15)
    inside = {"a.csv": b"12345", "b.csv": b"12345", "c.csv": b"12345"}
    there: dict[str, int] = {}
    for _ in range(2):
        for name, data in unpacked_of(packed(inside)).items():
            there[take(tmp_path, name, data, there)] = len(data)
        assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == inside
    with pytest.raises(OutputError, match=r"'d\.csv': is too large"):
        take(tmp_path, "d.csv", b"1", there)


def test_files_whose_plain_names_are_alike_are_kept_apart(tmp_path: Path) -> None:
    names = ["a/b/x.csv", "a_b/x.csv", "Größe.csv", "Gräße.csv", "A/m.csv", "q/M.csv", "l/" + "x" * 200 + "1.csv"]
    names += ["l/" + "x" * 200 + "2.csv", "arm/meshes/底座.stl", "arm/meshes/手臂.stl", "run.exe"]
    kept = apart(chosen(names), {})
    assert list(kept) == names
    plain = [name_here(name) for name in kept.values() if name != "run.exe"]
    assert plain == [name for name in kept.values() if name != "run.exe"]
    assert len({name.lower() for name in plain}) == len(plain)
    # Dropped again, each takes its own place; what is called otherwise takes none of these.
    called = {kept[path]: name for path, name in chosen(names).items()}
    assert apart(chosen(names), called) == kept
    assert apart(chosen(["Grüße.csv", "M.CSV", "Gräße.csv"]), called) == {
        "Grüße.csv": "Gr__e_3.csv",
        "M.CSV": "M_3.CSV",
        "Gräße.csv": "Gr__e_2.csv",
    }
    assert kept["Größe.csv"] == "Gr__e.csv"
    assert kept["Gräße.csv"] == "Gr__e_2.csv"
    # Which of the two meshes is meant cannot be told: neither is shown in the other's place.
    meshes = [name for name in plain if name.endswith(".stl")]
    for name in meshes:
        take(tmp_path, name, b"solid", {})
    (tmp_path / "arm.urdf").write_text("<robot/>")
    uris = ["package://arm/meshes/底座.stl", "package://arm/meshes/手臂.stl"]
    assert gather(tmp_path, "arm.urdf", uris, meshes)[1] == uris


def test_many_names_that_are_alike_get_their_numbers_at_once() -> None:
    names = {f"{k}.csv": chr(0x4E00 + k) + ".csv" for k in range(5000)}
    begun = time.process_time()
    assert len(set(apart(names, {}).values())) == 5000
    assert time.process_time() - begun < 2.0


def test_a_folder_is_served_by_one_page_at_a_time(tmp_path: Path) -> None:
    place = tmp_path / "work"
    for _ in range(2):
        with private_folder(place):
            with pytest.raises(OutputError, match="another page is served from it"), private_folder(place):
                pytest.fail("was given")
            with as_zip(place) as file, zipfile.ZipFile(file) as archive:
                assert archive.namelist() == []
    (place / ".served").unlink()
    os.mkfifo(place / ".served")
    with pytest.raises(OutputError, match=r"its \.served is not a regular file"), private_folder(place):
        pytest.fail("was given")


@pytest.mark.parametrize("ending", [".urdf", ".stl"])
def test_a_full_disk_is_said_when_robot_and_meshes_are_put_together(
    ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A mesh for which there is no room is not said to be missing among those that were dropped."""
    (tmp_path / "arm.urdf").write_text("<robot/>")
    take(tmp_path, "m/a.stl", b"solid", {})
    write = Path.write_bytes

    def full(place: Path, data: bytes) -> int:
        if place.suffix == ending:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(place, data)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OutputError, match=r"cannot be written \(No space left on device\)"):
        gather(tmp_path, "arm.urdf", ["package://m/a.stl"], ["m/a.stl"])


def test_an_empty_folder_of_another_user_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Root may write into it, and its owner could enter it; it stays as it was."""
    tmp_path.chmod(0o755)
    monkeypatch.setattr(os, "getuid", lambda: tmp_path.stat().st_uid + 1)
    with pytest.raises(OutputError, match="belongs to another user"), private_folder(tmp_path):
        pass
    assert (stat.S_IMODE(tmp_path.stat().st_mode), list(tmp_path.iterdir())) == (0o755, [])
