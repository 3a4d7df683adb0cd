"""The requests of the page: who may ask, what files may hold, and how work is cancelled."""

import asyncio
import contextlib
import http.client
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
import zipfile
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any
from urllib.parse import quote

import psutil
import pytest

from calib.app.child import _as_texts
from calib.app.folder import SESSION
from calib.app.server import _Folder
from calib.app.session import Session
from calib.foundations.errors import OutputError
from tests.support.cases import CASE, JOB, TABLE, URDF, run

# Whoever runs the tests in the background has taught them to ignore signals; a person's terminal has not.
MAIN = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
from calib.cli import main
main()
"""
PANDA = "example:panda_description/urdf/panda.urdf"


class Server:
    """``calib app`` in a process, and its page's requests without a browser."""

    def __init__(self, *arguments: str | Path, **environment: str) -> None:
        command = [sys.executable, "-W", "error", "-W", "ignore::DeprecationWarning", "-c", MAIN, "app"]
        self.process = subprocess.Popen(
            [*command, *map(str, arguments)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, **environment},
        )
        assert self.process.stdout is not None
        said = ""
        while "Ctrl-C" not in said:
            line = self.process.stdout.readline()
            assert line, self.process.communicate()
            said += line
        match = re.search(r"(http://127\.0\.0\.1:\d+)(/[\w-]{22}/)", said.replace("\n", ""))
        assert match is not None, said
        self.origin, self.page = match[1], match[1] + match[2]

    def end(self, number: signal.Signals = signal.SIGINT) -> tuple[int, str]:
        self.process.send_signal(number)
        error = self.process.communicate(timeout=60)[1]
        return self.process.returncode, error

    def ask(
        self, method: str, path: str, body: bytes | dict[str, Any] | None = None, **headers: str | None
    ) -> tuple[int, Any]:
        """Return status and answer; ``headers`` in the place of those that the page's own requests have."""
        data = json.dumps(body).encode() if isinstance(body, dict) else body
        given = {"Origin": self.origin, **headers}
        request = urllib.request.Request(self.page + path, data, method=method)
        for name, value in given.items():
            if value is not None:
                request.add_header(name, value)
        try:
            with urllib.request.urlopen(request, timeout=60) as answer:
                status, content = answer.status, answer.read()
        except urllib.error.HTTPError as e:
            status, content = e.code, e.read()
        try:
            return status, json.loads(content)
        except ValueError:
            return status, content

    def drop(self, name: str, data: bytes | str) -> tuple[int, Any]:
        return self.ask("PUT", "files/" + quote(name, safe=""), data.encode() if isinstance(data, str) else data)

    def settled(self) -> dict[str, Any]:
        end = time.monotonic() + 240
        while time.monotonic() < end:
            _, state = self.ask("GET", "state")
            if state["busy"] is None:
                found: dict[str, Any] = state
                return found
            time.sleep(0.2)
        raise TimeoutError(state)

    def look(self, **said: Any) -> dict[str, Any]:
        status, answer = self.ask("POST", "look", said)
        assert status == 200, answer
        return self.settled()

    def clear(self) -> None:
        for file in self.ask("GET", "state")[1]["files"]:
            assert self.ask("DELETE", "files/" + quote(file["name"]))[0] == 200


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    served = Server()
    yield served
    if served.process.poll() is None:
        served.end(signal.SIGTERM)  # its folder goes with it


@pytest.fixture
def empty(server: Server) -> Iterator[Server]:
    yield server
    server.ask("POST", "cancel")
    server.clear()


def test_only_the_page_itself_may_ask(empty: Server) -> None:
    port = empty.origin.rpartition(":")[2]
    family = [psutil.Process(empty.process.pid)]
    found = [c for member in family for c in member.net_connections("inet") if c.status == psutil.CONN_LISTEN]
    assert [c.laddr.ip for c in found] == ["127.0.0.1"]
    for origin in (None, "null", "http://evil.example", f"http://evil.example:{port}", "http://127.0.0.1:1"):
        for method, path in (
            ("POST", "look"),
            ("POST", "calibrate"),
            ("POST", "offer"),
            ("PUT", "files/a.csv"),
            ("DELETE", "files/a.csv"),
        ):
            assert empty.ask(method, path, b"{}", Origin=origin)[0] == 403
    for host in ("evil.example", f"evil.example:{port}", "0.0.0.0", "[::1]"):
        assert empty.ask("GET", "state", Host=host)[0] == 404
        assert empty.ask("POST", "look", {}, Host=host, Origin=f"http://{host}")[0] == 404
    assert empty.ask("GET", "state")[1]["files"] == []
    # Without the secret there is nothing, whoever asks.
    secret = empty.page
    try:
        for other in (f"{empty.origin}/", f"{empty.origin}/{'x' * 22}/"):
            empty.page = other
            assert [empty.ask("GET", path)[0] for path in ("", "state", "app.js", "calibration.zip")] == [404] * 4
            assert empty.ask("PUT", "files/a.csv", b"1")[0] in (404, 405)
    finally:
        empty.page = secret
    with urllib.request.urlopen(secret) as answer:
        assert answer.headers["X-Frame-Options"] == "DENY"
        assert "default-src 'none'; script-src 'self'" in answer.headers["Content-Security-Policy"]
        text = answer.read().decode()
    assert re.findall(r"""(?:src|href)="([^"]+)""", text) == [
        *("data:,", "app.css", "app.js"),
        *("results/report.html", "results/scene.html", "calibration.zip"),
    ]


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("look", b"[]"),
        ("offer", b"[]"),
        ("offer", b'{"paths": 1}'),
        ("offer", b'{"paths": [1]}'),
        ("look", b"\xff"),
        ("look", b"[" * 50_000),
        ("look", b'{"robot": 1}'),
        ("look", b'{"answers": []}'),
        ("look", b'{"answers": {"columns": []}}'),
        ("look", b'{"camera_on": "moon"}'),
        ("look", b'{"answers": {"tip": 1}}'),
        ("look", b'{"answers": {"columns": {"x": null}}}'),
        ("look", b'{"robot": "/etc/passwd"}'),
        ("look", b'{"robot": "../arm.urdf"}'),
        ("calibrate", b"{}"),
    ],
)
def test_requests_without_sense_are_answered_in_words(empty: Server, path: str, body: bytes) -> None:
    status, answer = empty.ask("POST", path, body)
    assert (status, list(answer)) == (400, ["sentence"])
    assert answer["sentence"].endswith(".")


def test_a_browser_is_started_with_an_address_that_leads_to_the_page_once(tmp_path: Path) -> None:
    watched, script = tmp_path / "address", tmp_path / "browser.sh"
    script.write_text(f'#!/bin/sh\nprintf %s "$1" > {watched}.new\nmv {watched}.new {watched}\n')
    script.chmod(0o700)
    server = Server("--open", BROWSER=f"{script} %s")
    end = time.monotonic() + 60
    while not watched.exists():
        assert time.monotonic() < end
        time.sleep(0.05)
    door = watched.read_text()
    assert door.startswith(server.origin)
    assert server.page.split("/")[-2] not in door
    with urllib.request.urlopen(door, timeout=60) as answer:
        assert answer.url == server.page
        assert b"Calibrate a robot arm" in answer.read()
    with pytest.raises(urllib.error.HTTPError, match="403") as refused:
        urllib.request.urlopen(door, timeout=60)
    with refused.value:
        assert b"has been used" in refused.value.read()
    server.end()


def test_files_have_a_size_and_a_kind(empty: Server) -> None:
    assert empty.drop("a.exe", b"MZ")[1]["sentence"].startswith("'a.exe': is no robot, mesh, table, photograph or job;")
    assert empty.drop("../../x.csv", b"1,2\n")[1]["files"] == [{"name": "x.csv", "kind": "table", "size": 4}]
    assert empty.ask("DELETE", "files/..%2F..%2Fx.csv")[1]["sentence"] == "'../../x.csv': there is no such file."
    # Refused before it is read.
    status = empty.ask("PUT", "files/large.csv", b"", **{"Content-Length": "200000001"})[0]
    assert status == 413
    assert empty.ask("PUT", "files/large.csv", b"", **{"Content-Length": "9" * 5000})[0] == 413
    assert empty.ask("PUT", "files/%ff.csv", b"")[0] == 400


def test_a_mesh_of_a_long_path_is_taken_by_the_name_that_was_offered(empty: Server) -> None:
    """Letters that an address escapes made it longer than what the server listens to."""
    path = "/".join(["d d " * 22] * 11) + "/m.stl"
    name = empty.ask("POST", "offer", {"paths": [path]})[1]["wanted"][path]
    assert empty.ask("PUT", f"files/{quote(name, safe='')}", b"solid")[0] == 200
    assert empty.ask("DELETE", f"files/{quote(name, safe='')}")[0] == 200


def test_no_file_takes_the_place_of_one_that_is_called_otherwise(tmp_path: Path) -> None:
    """Two tables that were dropped one after the other became one, as their letters are none that every system has."""
    place = tmp_path / "work"

    def drop(server: Server, name: str, size: int) -> list[tuple[str, int]]:
        kept = server.ask("POST", "offer", {"paths": [name]})[1]["wanted"][name]
        return [(file["name"], file["size"]) for file in server.drop(kept, b"1" * size)[1]["files"]]

    server = Server("--folder", place)
    assert drop(server, "測定.csv", 1) == [("__.csv", 1)]
    assert drop(server, "検証.csv", 2) == [("__.csv", 1), ("___2.csv", 2)]
    assert server.end() == (0, "")
    server = Server("--folder", place)
    # What is dropped again takes its own place, also after a restart.
    assert drop(server, "検証.csv", 3) == [("__.csv", 1), ("___2.csv", 3)]
    packed = BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("測定.csv", b"1111")
        archive.writestr("確認.csv", b"11111")
    files = server.drop("all.zip", packed.getvalue())[1]["files"]
    assert [(file["name"], file["size"]) for file in files] == [("__.csv", 4), ("___2.csv", 3), ("___3.csv", 5)]
    assert server.end() == (0, "")


def test_tables_of_one_name_in_two_formats_are_two_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One took the other's place, and was read twice."""
    monkeypatch.chdir(tmp_path)
    for name, x in (("poses.json", 1), ("Poses.jsonl", 2), ("more.json", 3)):
        Path(name).write_text(json.dumps({"x": x, "y": x}) + "\n")
    Path("own.csv").write_text("x,y\n1,2\n")
    Path("lists.txt").write_text("P1 [4, 5, 6]\nP2 [7, 8, 9]\n")
    found = _as_texts(["poses.json", "Poses.jsonl", "more.json", "own.csv", "lists.txt"])
    assert found == [
        "tables/poses.json.csv",
        "tables/Poses.jsonl.csv",
        "tables/more.csv",
        "own.csv",
        "tables/lists.csv",
    ]
    assert Path(found[-1]).read_text().splitlines()[-1] == "P2,7,8,9"
    Path("named.log").write_text("J1=3.5; J2=-10; X=512,3 mm\nJ1=4.5; J2=-11; X=522,3 mm\n")
    (named,) = _as_texts(["named.log"])
    assert Path(named).read_text() == "J1,J2,X [mm]\n3.5,-10,512.3\n4.5,-11,522.3\n"
    values = [Path(name).read_text().splitlines()[-1][0] for name in found[:3]]
    assert values == ["1", "2", "3"]


BOMB = '<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]><robot name="&b;"/>'
ENTITY = '<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]><robot name="&a;"><link name="l"/></robot>'
JOINTS = "".join(f"{k}.1,{k}.2,0.3,0.4,0.5,0.6,0.7,0.8,0.9,1.0\n" for k in range(9))
HOSTILE = {
    "bomb": ({"arm.urdf": BOMB, "m.csv": JOINTS}, r"arm\.urdf.*DOCTYPE|arm\.urdf.*entit"),
    "entity": ({"arm.urdf": ENTITY, "m.csv": JOINTS}, r"arm\.urdf.*DOCTYPE|arm\.urdf.*entit"),
    "no xml": ({"arm.urdf": b"\x00\xff" * 500, "m.csv": JOINTS}, r"arm\.urdf"),
    "no robot": ({"m.csv": JOINTS}, "There is no robot yet"),
    "zeros": ({"m.csv": b"\x00" * 5000}, r"m\.csv"),
    "ragged": ({"m.csv": "a,b,c\n1,2,3\n1,2\n"}, r"m\.csv:3: "),
    "empty": ({"m.csv": ""}, r"m\.csv"),
    "script": ({"<script>alert(1)</script>.csv": "a,b\n1,2\n1\n"}, r"script_\.csv:3: "),
    "no workbook": ({"m.xlsx": b"PK\x03\x04" + b"x" * 100}, r"m\.xlsx"),
    "no arrays": ({"m.npz": b"\x93NUMPY"}, r"m\.npz"),
    "deep": ({"m.json": "[" * 100_000}, r"m\.json"),
    "no job": ({"j.toml": "a = ["}, r"j\.toml: is not TOML"),
    "two jobs": ({"a.toml": "[robot]\n", "b.toml": "[robot]\n"}, "'a.toml' and 'b.toml' are both jobs; remove one"),
    "board called as the job": ({"calibration.toml": 'kind = "charuco"\n'}, r"calibration\.toml: has no \[robot\]"),
    "no photographs": ({"p.png": b"\x89PNG", "b.toml": 'kind = "charuco"\n', "m.csv": "image\np.png\n"}, r"b\.toml"),
    "files elsewhere": (
        {
            "j.toml": 'schema = 1\n[robot]\nurdf = "example:panda_description/urdf/panda.urdf"\n[error_model]\n'
            'offsets = "all"\n[[measurements]]\nfile = "/etc/passwd"\nobserves = "position"\n'
        },
        r"calibration\.toml: file: '/etc/passwd' is not in the folder of this page; drop the file\.",
    ),
    "a pivot elsewhere": (
        {
            "j.toml": 'schema = 1\n[robot]\nurdf = "example:panda_description/urdf/panda.urdf"\n[error_model]\n'
            'offsets = "all"\n[instruments.arm]\nkind = "arm"\nurdf = "arm.urdf"\ntip = "tip"\nsigma = "1 mm"\n'
            'pivot = "/etc/passwd"\n[[measurements]]\nfile = "m.csv"\ninstrument = "arm"\n'
        },
        r"calibration\.toml: pivot: '/etc/passwd' is not in the folder of this page; drop the file\.",
    ),
    "files above": (
        {
            "j.toml": 'schema = 1\n[robot]\nurdf = "../arm.urdf"\n[error_model]\noffsets = "all"\n'
            '[[measurements]]\nfile = "m.csv"\nobserves = "position"\n'
        },
        r"calibration\.toml: urdf: '\.\./arm\.urdf' is not in the folder of this page; drop the file\.",
    ),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_gets_its_sentence(empty: Server, name: str) -> None:
    files, sentence = HOSTILE[name]
    for file, data in files.items():
        assert empty.drop(file, data)[0] == 200
    own = "arm.urdf" if "arm.urdf" in files else "" if name == "no robot" else PANDA
    state = empty.look(robot=own)
    assert re.search(sentence, state["sentence"]), state["sentence"]
    assert "root:" not in state["sentence"]
    assert "\n" not in state["sentence"]
    assert state["look"] is None
    assert empty.ask("POST", "calibrate")[0] == 400


def drop_case(server: Server) -> None:
    for file in (JOB, URDF, TABLE, "validation.csv"):
        assert server.drop(file, (CASE / file).read_bytes())[0] == 200


def test_a_dropped_job_is_checked_changed_and_calibrated_as_by_the_command(tmp_path: Path) -> None:
    server = Server("--folder", tmp_path / "work")
    try:
        drop_case(server)
        state = server.look()
        assert state["sentence"] == ""
        assert state["look"]["job"] == (CASE / JOB).read_text(encoding="utf-8")
        assert "parameters (condition number" in state["look"]["determined"]
        # A job that is changed for the worse is not calibrated.
        assert server.ask("POST", "check", {"job": state["look"]["job"] + "\nwrong = 1\n"})[0] == 200
        assert "wrong" in server.settled()["sentence"]
        assert server.ask("POST", "calibrate")[0] == 400
        assert server.ask("POST", "check", {"job": state["look"]["job"]})[0] == 200
        assert server.settled()["look"]["findings"] == state["look"]["findings"]
        assert server.ask("POST", "calibrate")[0] == 200
        status, answer = server.drop("more.csv", b"1\n")
        assert (status, answer["sentence"]) == (
            400,
            "A calibration is under way; wait for its end, or cancel it.",
        )
        assert server.settled()["results"]["trusted"] is True
        status, archive = server.ask("GET", "calibration.zip")
        names = zipfile.ZipFile(BytesIO(archive)).namelist()
        assert {f"calibration/{name}" for name in (JOB, URDF, TABLE)} < set(names)
        assert "calibration/results/result.json" in names
        request = urllib.request.urlopen(server.page + "results/report.html")
        assert request.headers["Content-Security-Policy"].startswith("sandbox")
        # What the command makes of the same job, byte for byte but for the folder's name.
        shutil.copytree(tmp_path / "work", tmp_path / "own", ignore=shutil.ignore_patterns("results"))
        assert run("calibrate", tmp_path / "own" / JOB, "-o", tmp_path / "own" / "results", "-q").code == 0
        for file in ("model.json", "calibrated.urdf", "residuals.csv"):
            own, other = (tmp_path / side / "results" / file for side in ("own", "work"))
            assert own.read_bytes() == other.read_bytes()
        assert server.end() == (0, "")
        assert (tmp_path / "work" / "results" / "report.html").exists()
    finally:
        server.process.kill()
        server.process.communicate()


def in_archive(server: Server) -> list[str]:
    status, contents = server.ask("GET", "calibration.zip")
    assert status == 200
    return zipfile.ZipFile(BytesIO(contents)).namelist()


def test_results_are_shown_beside_the_files_that_they_are_of_alone(tmp_path: Path) -> None:
    place, report = tmp_path / "page", "results/report.html"
    fewer = b"".join((CASE / TABLE).read_bytes().splitlines(keepends=True)[:40])
    server = Server("--folder", place)
    try:
        drop_case(server)
        server.look()
        for change in ("dropped", "results", "table", "job"):
            assert server.ask("POST", "calibrate")[0] == 200
            found = server.settled()["results"]
            assert (found["trusted"], server.ask("GET", report)[0]) == (True, 200)
            assert f"calibration/{report}" in in_archive(server)
            match change:
                case "dropped":
                    assert server.drop(TABLE, fewer)[0] == 200
                case "results":  # by somebody else, while the page is served
                    assert run("calibrate", place / JOB, "-o", place / "results", "-q").code == 0
                case _:
                    assert server.end() == (0, "")
                    server = Server("--folder", place)
                    assert server.ask("GET", "state")[1]["results"] == found
                    assert server.end() == (0, "")
                    name = TABLE if change == "table" else JOB
                    (place / name).write_bytes((place / name).read_bytes() + b"\n")
                    server = Server("--folder", place)
                    assert server.ask("GET", "state")[1]["look"] is None
            assert server.ask("GET", "state")[1]["results"] is None
            assert server.ask("GET", report)[0] == 404
            assert not [name for name in in_archive(server) if "results" in name]
            assert server.look()["look"]["sound"]
        assert server.end() == (0, "")
    finally:
        server.process.kill()
        server.process.communicate()


def test_files_that_change_while_they_are_calibrated_are_said(tmp_path: Path) -> None:
    async def changed() -> dict[str, Any]:
        session = Session(tmp_path)
        (tmp_path / JOB).write_text("one")
        session._before = session.seen()
        (tmp_path / JOB).write_text("another")
        session._take("calibrate", {"found": {"trusted": True}}, "")
        return session.state()

    state = asyncio.run(changed())
    said = "Files changed while this worked, and the results are not of those that are there now."
    assert (state["results"], state["sentence"]) == (None, said)


def test_files_that_change_while_they_are_packed_are_not_packed_as_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def packed(folder: Path, **_: object) -> BytesIO:
        (folder / JOB).write_text("another")
        return BytesIO()

    session = Session(tmp_path)
    handler = object.__new__(_Folder)
    handler.session, handler._left = session, threading.Event()
    monkeypatch.setattr("calib.app.server.as_zip", packed)
    with pytest.raises(OutputError, match=r"^The files changed while the archive was made; download it again\.$"):
        asyncio.run(handler._archive())


def test_who_leaves_while_the_folder_is_sent_or_packed_is_nothing_to_speak_of() -> None:
    server = Server()
    try:
        assert server.drop("many.npz", os.urandom(20_000_000))[0] == 200
        port, path = int(server.origin.rpartition(":")[2]), server.page.removeprefix(server.origin)
        for reads in (True, False):
            with socket.create_connection(("127.0.0.1", port)) as browser:
                browser.sendall(f"GET {path}calibration.zip HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
                if reads:
                    assert browser.recv(1000).startswith(b"HTTP/1.1 200")
        assert server.ask("GET", "state")[0] == 200
        assert server.end() == (0, "")
    finally:
        server.process.kill()
        server.process.communicate()


def test_work_can_be_cancelled_and_ends_with_the_server() -> None:
    server = Server()
    try:
        drop_case(server)
        state = server.look()
        for ending in ("cancel", "end"):
            assert server.ask("POST", "calibrate")[0] == 200
            children: list[psutil.Process] = []
            # A child begins in the folder of its parent, for a moment.
            while not children or children[0].cwd() == str(Path.cwd()):
                children = psutil.Process(server.process.pid).children(recursive=True)
            if ending == "cancel":
                assert server.ask("POST", "cancel")[1]["busy"] is None
                state = server.ask("GET", "state")[1]
                assert (state["results"], state["sentence"]) == (None, "")
                assert server.ask("GET", "results/report.html")[0] == 404
            else:
                folder = Path(children[0].cwd())
                assert server.end() == (0, "")
                assert not folder.exists()
            assert psutil.wait_procs(children, timeout=20)[1] == []
    finally:
        server.process.kill()
        server.process.communicate()


def test_work_that_is_killed_is_said_and_the_page_goes_on() -> None:
    server = Server()
    try:
        drop_case(server)
        server.look()
        assert server.ask("POST", "calibrate")[0] == 200
        children: list[psutil.Process] = []
        while not children:
            children = psutil.Process(server.process.pid).children()
        children[0].kill()
        killed = "The process that worked on this was killed; the memory may not suffice."
        assert server.settled()["sentence"] == killed
        assert server.look()["sentence"] == ""
        assert server.end() == (0, "")
    finally:
        server.process.kill()
        server.process.communicate()


def test_a_file_that_cannot_be_removed_stays_and_is_said(tmp_path: Path) -> None:
    server = Server("--folder", tmp_path / "page")
    try:
        server.drop("a.csv", "x")
        (tmp_path / "page" / "a.csv").unlink()
        (tmp_path / "page" / "a.csv").mkdir()
        status, answer = server.ask("DELETE", "files/a.csv")
        assert status == 400
        # Linux and macOS do not give the same reason.
        assert answer["sentence"].startswith("'a.csv': cannot be removed (")
        assert [file["name"] for file in server.ask("GET", "state")[1]["files"]] == ["a.csv"]
        assert server.end() == (0, "")
    finally:
        server.process.kill()
        server.process.communicate()


def test_of_several_windows_one_works_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    at_work: list[str] = []
    most = 0

    async def work(_: Session, verb: str, asked: object) -> None:
        nonlocal most
        at_work.append(verb)
        most = max(most, len(at_work))
        try:
            await asyncio.sleep(3600)
        finally:
            await asyncio.sleep(0)  # a child takes its time to end
            at_work.remove(verb)

    async def windows() -> list[object]:
        session = Session(tmp_path)
        await session.look({})
        await asyncio.sleep(0)
        await asyncio.gather(session.look({}), session.check("schema = 1"), session.look({}))
        session._look = {"findings": []}
        await asyncio.sleep(0)
        said = await asyncio.gather(session.calibrate(), session.look({}), return_exceptions=True)
        await asyncio.sleep(0)
        assert at_work == ["calibrate"]
        await session.cancel()
        assert at_work == []
        return list(said)

    monkeypatch.setattr(Session, "_run", work)
    begun, refused = asyncio.run(windows())
    assert most == 1
    assert begun is None
    assert str(refused) == "A calibration is under way; wait for its end, or cancel it."


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_files_go_when_the_terminal_is_closed(tmp_path: Path, number: signal.Signals) -> None:
    server = Server(TMPDIR=str(tmp_path))
    try:
        drop_case(server)
        assert server.ask("POST", "look", {})[0] == 200
        children = psutil.Process(server.process.pid).children(recursive=True)
        assert list(tmp_path.iterdir())
        assert server.end(number) == (0, "")
        assert list(tmp_path.iterdir()) == []
        assert psutil.wait_procs(children, timeout=20)[1] == []
    finally:
        server.process.kill()
        server.process.communicate()


def test_a_folder_that_was_removed_is_said_and_not_made_anew(tmp_path: Path) -> None:
    place = tmp_path / "page"
    server = Server("--folder", place)
    said = f"{place}: is gone, with all files of this page; end calib app, and begin it again."
    try:
        drop_case(server)
        server.look()
        for another in (False, True):
            shutil.rmtree(place)
            if another:  # one that somebody else has made
                place.mkdir()
            state = server.ask("GET", "state")[1]
            assert (state["files"], state["robot"], state["look"], state["sentence"]) == ([], "", None, said)
            for method, path, body in (
                ("PUT", "files/a.csv", b"1"),
                ("POST", "look", {"robot": "", "answers": {}}),
                ("POST", "check", {"job": "schema = 1"}),
                ("GET", "calibration.zip", None),
            ):
                status, answer = server.ask(method, path, body)
                assert (status // 100, answer["sentence"]) in {(4, said), (5, said)}, path
            assert not place.exists() or (another and not list(place.iterdir()))
            place.mkdir(exist_ok=True)
        assert server.end() == (0, "")
    finally:
        server.process.kill()
        server.process.communicate()


def test_bad_folders_and_ports_are_said_in_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "there.csv").write_text("1")
    said = run("app", "--folder", tmp_path)
    assert (said.code, said.out) == (1, "")
    assert (
        said.err == f"Error: {tmp_path}: already exists, and is neither empty nor left by this page; choose another.\n"
    )
    left = tmp_path / "left"
    left.mkdir(mode=0o700)
    (left / "a.csv").write_text("1")
    endless = '{"files": {"a.csv": 1e999}, "asked": {"robot": ""}, "look": 1, "results": 1, "sentence": ""}'
    few = '{"files": {}, "asked": 1, "look": 1, "results": 1}'
    for contents in ("", "[]", '{"files": {"../a.csv": 1}}', few, endless):
        (left / SESSION).write_text(contents)
        said = run("app", "--folder", left)
        assert (said.code, said.out) == (1, "")
        assert said.err.startswith(f"Error: {left / SESSION}: was not written by this page; choose another folder.")
    assert run("app", "--port", "70000").code == 2


def test_ctrl_c_ends_a_page_that_is_asked_all_the_time() -> None:
    """A look that began while the server ended kept it from ending for good."""
    server, over = Server(), threading.Event()

    def asked() -> None:
        with contextlib.suppress(OSError, http.client.HTTPException):
            while not over.is_set():
                server.ask("POST", "look", {"robot": PANDA, "answers": {}})

    windows = [threading.Thread(target=asked) for _ in range(3)]
    try:
        for window in windows:
            window.start()
        time.sleep(0.1)
        server.process.send_signal(signal.SIGINT)
        assert server.process.communicate(timeout=60)[1] == ""
        assert server.process.returncode == 0
    finally:
        over.set()
        server.process.kill()
        for window in windows:
            window.join()
