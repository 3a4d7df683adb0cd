"""What is kept between runs: found again, ignored when damaged, and never in anybody's way."""

import os
from pathlib import Path

import pytest

from calib.foundations import cache

KEY = "ab" * 32


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("CALIB_CACHE", str(tmp_path / "a" / "b"))
    return tmp_path / "a" / "b"


def test_what_is_kept_is_found(place: Path) -> None:
    assert cache.kept(KEY) is None
    cache.keep(KEY, b"some\nbytes")
    assert cache.kept(KEY) == b"some\nbytes"
    assert cache.kept("cd" * 32) is None
    assert place.stat().st_mode & 0o077 == 0  # nobody else's


@pytest.mark.parametrize("contents", [b"", b"x" * 10, b"0" * 64 + b"some\nbytes"])
def test_a_damaged_entry_is_none(place: Path, contents: bytes) -> None:
    cache.keep(KEY, b"some\nbytes")
    (entry,) = place.iterdir()
    entry.write_bytes(contents)
    assert cache.kept(KEY) is None
    cache.keep(KEY, b"anew")
    assert cache.kept(KEY) == b"anew"


def test_an_entry_of_another_key_is_none(place: Path) -> None:
    cache.keep(KEY, b"some bytes")
    (entry,) = place.iterdir()
    entry.rename(entry.with_name(entry.name.replace("ab", "cd")))
    assert cache.kept("cd" * 32) is None


def test_where_it_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("CALIB_CACHE", "off")
    assert cache.folder() is None
    assert cache.kept(KEY) is None
    cache.keep(KEY, b"")
    monkeypatch.delenv("CALIB_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache.folder() == tmp_path / "calib"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr("sys.platform", "linux")
    assert cache.folder() == tmp_path / ".cache" / "calib"
    monkeypatch.setattr("sys.platform", "darwin")
    assert cache.folder() == tmp_path / "Library" / "Caches" / "calib"


@pytest.mark.parametrize("place", ["file", "file/below", "nul\0", "x" * 300])
def test_where_nothing_can_be_kept_nothing_is(place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("mine")
    monkeypatch.setattr(cache, "folder", lambda: tmp_path / place)
    cache.keep(KEY, b"some bytes")
    assert cache.kept(KEY) is None
    assert (tmp_path / "file").read_text() == "mine"


def test_the_oldest_give_way(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "_MOST", 3)
    for n in range(5):
        cache.keep(f"{n:064x}", b"")
        for entry in place.iterdir():
            os.utime(entry, ns=(int(entry.stem, 16), int(entry.stem, 16)))
    assert [cache.kept(f"{n:064x}") for n in range(5)] == [None, None, b"", b"", b""]


def test_files_of_others_in_the_folder_stay(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "_MOST", 1)
    place.mkdir(parents=True)
    others = ("mine.calib", f"{KEY}.calib.bak", ".out.01234567.calib")
    for name in others:
        (place / name).touch()
    for n in range(3):
        cache.keep(f"{n:064x}", b"")
    assert {path.name for path in place.iterdir()}.issuperset(others)
    assert len(list(place.iterdir())) == len(others) + 1


def test_what_is_called_as_an_entry_and_is_none_stops_no_tidying(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "_MOST", 1)
    (place / f"{1:064x}.calib").mkdir(parents=True)
    (place / f"{2:064x}.calib").symlink_to("nowhere")
    os.utime(place / f"{1:064x}.calib", (0, 0))
    for n in (3, 4, 5):
        cache.keep(f"{n:064x}", b"")
    assert [path.name for path in place.iterdir() if path.is_file()] == [f"{5:064x}.calib"]
    assert (place / f"{1:064x}.calib").is_dir() and (place / f"{2:064x}.calib").is_symlink()
