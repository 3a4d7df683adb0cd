"""The private folder of the page: names, sizes, and what leaves it."""

import stat
import zipfile
from pathlib import Path

import pytest

from calib.app.folder import as_zip, kind_of, plain_name, private_folder, take
from calib.foundations.errors import OutputError


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
    with pytest.raises(OutputError, match=r"^'a\.exe': is no robot, table, photograph or job; their names end with"):
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


def test_the_folder_as_one_file_has_no_links(tmp_path: Path) -> None:
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "report.html").write_text("r")
    (tmp_path / "measured.csv").write_text("m")
    (tmp_path / "link.csv").symlink_to("/etc/passwd")
    with as_zip(tmp_path) as file, zipfile.ZipFile(file) as archive:
        assert archive.namelist() == ["calibration/measured.csv", "calibration/results/report.html"]
        assert archive.read("calibration/measured.csv") == b"m"
