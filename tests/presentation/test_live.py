"""The scene served live: to this machine alone, on one port, with joints that a person moves."""

import asyncio
import fcntl
import json
import os
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from calib.foundations.files import opened_folder
from calib.job.inputs import load
from calib.job.run import run as identify
from calib.machine.model_file import load_machine
from calib.presentation.live import answer, sliders
from calib.results.folder import write_results
from calib.robot.links import arm_of
from scripts.development.browser import CHROMIUM, browser
from tests.support.cases import CASE, JOB, run

# Whoever runs the tests in the background has taught them to ignore Ctrl-C; a person's terminal has not.
MAIN = "import signal; signal.signal(2, signal.default_int_handler); from calib.cli import main; main()"


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("live") / "out"
    write_results(identify(load(CASE.parent / "irb2400" / JOB)), folder)
    return folder


@pytest.fixture
def out(results: Path, tmp_path: Path) -> Path:
    return shutil.copytree(results, tmp_path / "out")


@pytest.fixture
def server(out: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    command = [sys.executable, "-W", "error", "-W", "ignore::DeprecationWarning", "-c", MAIN, "view", str(out)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    said = ""
    while "Ctrl-C" not in said:
        line = process.stdout.readline()
        assert line, process.communicate()
        said += line
    match = re.search(r"http://127\.0\.0\.1:\d+/", said.replace("\n", ""))
    assert match is not None
    yield process, match[0]
    process.kill()
    process.communicate()


def fetch(address: str, **headers: str) -> tuple[int, bytes]:
    try:
        with urllib.request.urlopen(urllib.request.Request(address, headers=headers)) as response:
            return response.status, response.read()
    except urllib.error.HTTPError as e:
        return e.code, b""


def test_it_listens_on_this_machine_alone_and_ends_well(server: tuple[subprocess.Popen[str], str], out: Path) -> None:
    process, address = server
    family = [psutil.Process(process.pid), *psutil.Process(process.pid).children(recursive=True)]
    found = [c for member in family for c in member.net_connections("inet") if c.status == psutil.CONN_LISTEN]
    assert [c.laddr.ip for c in found] == ["127.0.0.1"]
    assert found[0].laddr.port == int(address.rsplit(":", 1)[1].strip("/"))
    assert fetch(address) == (200, (out / "scene.html").read_bytes())
    assert fetch(address + "report.html") == (200, (out / "report.html").read_bytes())
    # Nothing but the two pages, and not for a name that another site has given this machine.
    for path in ("model.json", "../out/result.json", "%2e%2e/secret", "scene.html/x"):
        assert fetch(address + path)[0] == 404
    for host in ("evil.example", "127.0.0.1.evil.example", "localhost.evil.example:80", "0.0.0.0", "[::1]", "127.1"):
        assert fetch(address, Host=host)[0] == 404
    with urllib.request.urlopen(address) as response:
        assert response.headers["X-Frame-Options"] == "DENY"
        assert response.headers["Cross-Origin-Resource-Policy"] == "same-origin"
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=60.0) == ("", "")
    assert process.returncode == 0


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on the path")
def test_a_page_of_somebody_else_asks_no_other_server(server: tuple[subprocess.Popen[str], str], out: Path) -> None:
    """A folder of results may be a stranger's, and its pages then say nothing of what they may do."""
    _, address = server
    with socket.create_server(("127.0.0.1", 0)) as other, browser() as page:
        elsewhere = f"http://127.0.0.1:{other.getsockname()[1]}/"
        asking = f"fetch('{elsewhere}').then(() => 'asked', () => 'refused').then(said => {{ document.title = said }})"
        text = f'<!DOCTYPE html><title>safe</title><script>{asking}</script><script src="{elsewhere}s.js"></script>'
        for name in ("scene.html", "report.html"):
            (out / name).write_text(text)
        page.open(address)
        page.wait_for("document.title === 'refused'")  # a scene is drawn by its script
        page.open(address + "report.html")
        assert page.evaluate("document.title") == "safe"
        other.setblocking(False)
        with pytest.raises(BlockingIOError):  # nobody has come
            other.accept()


def test_who_reads_slowly_has_no_copy_of_the_page(server: tuple[subprocess.Popen[str], str], out: Path) -> None:
    """Twelve that asked for a page of 199 MB and did not read it took 2.4 GB."""
    process, address = server
    os.truncate(out / "report.html", 60_000_000)
    port, before = int(address.rsplit(":", 1)[1].strip("/")), psutil.Process(process.pid).memory_info().rss
    asked = f"GET /report.html HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode()
    waiting = [socket.create_connection(("127.0.0.1", port)) for _ in range(6)]
    try:
        for one in waiting:
            one.sendall(asked)
            assert one.recv(12) == b"HTTP/1.1 200"
        assert fetch(address)[0] == 200
        assert psutil.Process(process.pid).memory_info().rss - before < 100_000_000
    finally:
        for one in waiting:
            one.close()
    status, page = fetch(address + "report.html")
    assert (status, len(page)) == (200, 60_000_000)


def test_joints_are_answered_by_the_calibrated_model(server: tuple[subprocess.Popen[str], str], out: Path) -> None:
    from tornado.httpclient import HTTPClientError, HTTPRequest
    from tornado.websocket import websocket_connect

    _, address = server
    place = address.replace("http", "ws") + "live"

    async def talk() -> tuple[Any, Any]:
        port = place.split(":")[2].split("/")[0]
        for headers, code in (
            ({"Origin": "http://evil.example"}, 403),
            ({"Origin": "http://127.0.0.1:1"}, 403),  # another page of this machine
            ({"Origin": "null"}, 403),
            # A name that another site has made to point here: page and address are then the same to a browser.
            ({"Origin": f"http://evil.example:{port}", "Host": f"evil.example:{port}"}, 404),
        ):
            with pytest.raises(HTTPClientError) as refused:
                await websocket_connect(HTTPRequest(place, headers=headers))
            assert refused.value.code == code
        socket = await websocket_connect(place)
        hello = json.loads(str(await socket.read_message()))
        await socket.write_message(json.dumps({"readings": [10.0, 20.0, -5.0, 0.0, 30.0, 0.0], "apart": 3.0}))
        told = json.loads(str(await socket.read_message()))
        socket.close()
        return hello, told

    hello, told = asyncio.run(talk())
    assert [r["name"] for r in hello["readings"]] == [f"joint_{k}" for k in range(1, 7)]
    model = load_machine(out)
    u = np.radians([[10.0, 20.0, -5.0, 0.0, 30.0, 0.0]])
    arm = arm_of(model.robot, model.deviations, u, np.eye(4))
    np.testing.assert_allclose(told["positions"]["robot"], arm.positions[0], atol=1e-12)
    apart = 1e3 * np.linalg.norm((model.robot.tips(u, model.deviations) - model.robot.tips(u))[0, :3, 3])
    assert f"are {apart:.3f} mm apart" in told["sentence"]


def asked(address: str, origin: str = "") -> tuple[socket.socket, bytes]:
    """A WebSocket of the server, and the first line of its answer."""
    port = int(address.rstrip("/").rpartition(":")[2])
    page = socket.create_connection(("127.0.0.1", port), timeout=20)
    page.sendall(
        f"GET /live HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        f"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n{origin}\r\n".encode()
    )
    return page, page.recv(10_000).splitlines()[0]


def test_pages_that_leave_while_they_are_answered_are_nothing_to_speak_of(
    server: tuple[subprocess.Popen[str], str],
) -> None:
    process, address = server
    text = json.dumps({"readings": [0.0] * 6, "apart": 1.0}).encode()
    question = bytes([0x81, 0x80 | len(text)]) + bytes(4) + text  # one frame, masked by zeros
    for _ in range(10):
        page, first = asked(address)
        assert b"101" in first
        page.sendall(50 * question)
        page.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        page.close()  # at once, as when the browser ends
    page, first = asked(address, "Origin: http://[::1\r\n")
    page.close()
    assert b"403" in first
    # Bytes that are no form, sent to where a WebSocket is.
    form = {"Content-Type": "multipart/form-data; boundary="}
    with pytest.raises(urllib.error.HTTPError, match="400"):
        urllib.request.urlopen(urllib.request.Request(address + "live", b"a", form))
    page, first = asked(address)
    assert b"101" in first
    page.sendall(50 * question)
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=20)[1] == ""
    page.close()


def test_the_browser_is_opened_where_that_is_asked_for(out: Path, tmp_path: Path) -> None:
    browser_of_a_person, opened = tmp_path / "browser", tmp_path / "opened"
    browser_of_a_person.write_text(f'#!/bin/sh\necho "$1" > "{opened}.part" && mv "{opened}.part" "{opened}"\n')
    browser_of_a_person.chmod(0o755)
    for program in (str(browser_of_a_person), str(tmp_path / "none")):
        process = subprocess.Popen(
            [sys.executable, "-c", MAIN, "view", str(out), "--open"],
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "BROWSER": program, "PATH": "/usr/bin:/bin" if program.endswith("browser") else ""},
        )
        assert process.stdout is not None
        said = ""
        while "Ctrl-C" not in said or (program.endswith("none") and "by hand" not in said):
            line = process.stdout.readline()
            assert line, said
            said += line
        address = re.search(r"http://127\.0\.0\.1:\d+/", said.replace("\n", ""))
        assert address is not None
        while program.endswith("browser") and not opened.exists():
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60.0)
        if program.endswith("browser"):
            assert opened.read_text().strip() == address[0]


def test_questions_without_sense_are_answered_in_words(results: Path) -> None:
    model = load_machine(results)
    good = {"readings": [0.0] * 6, "apart": 1.0}
    assert "positions" in answer(model, json.dumps(good))
    for changes in (
        {"readings": [0.0] * 5},
        {"readings": "x"},
        {"readings": [None] * 6},
        {"apart": None},
        {"apart": 1e999},
        {"apart": 10**400},
        {"apart": 1e300},
        {"readings": [1e300] * 6},
        {"readings": [[0.0] * 6]},
        {"readings": [0.0]},
        {"readings": []},
    ):
        assert answer(model, json.dumps({**good, **changes})) == {"sentence": "The server does not know this request."}
    for message in ("", "[]", "[" * 5000, b"\xff"):
        assert "positions" not in answer(model, message)
    assert "loop 'parallelogram'" in answer(model, json.dumps({**good, "apart": 1e6}))["sentence"]
    assert all(s["lower"] <= s["value"] <= s["upper"] for s in sliders(model))


def test_bad_folders_and_ports_are_said_in_a_sentence(out: Path, tmp_path: Path) -> None:
    said = run("view", tmp_path / "no")
    assert (said.code, said.out) == (1, "")
    assert said.err.startswith(f"Error: {tmp_path}/no/model.json: there is no such file")
    (out / "scene.html").unlink()
    said = run("view", out)
    assert (said.code, said.err) == (1, f"Error: {out}: holds no scene.html; run calib calibrate again.\n")
    assert run("view", out, "--port", "70000").code == 2


def test_a_folder_that_another_run_keeps_keeps_nobody_else_waiting(
    server: tuple[subprocess.Popen[str], str], out: Path
) -> None:
    process, address = server
    with opened_folder(out.parent) as above, ThreadPoolExecutor() as others:
        fcntl.flock(above, fcntl.LOCK_EX)
        waiting = others.submit(fetch, address)
        (out / "newer").touch()  # the folder is to be read again
        time.sleep(2.5)
        assert fetch(address + "nothing") == (404, b"")
        assert not waiting.done()
        fcntl.flock(above, fcntl.LOCK_UN)
        assert waiting.result()[0] == 200
        fcntl.flock(above, fcntl.LOCK_EX)
        waiting = others.submit(fetch, address)
        (out / "newer").unlink()
        time.sleep(1.5)
        process.send_signal(signal.SIGINT)
        assert (process.wait(timeout=20), process.communicate()[1]) == (0, "")
        assert isinstance(waiting.exception(), OSError)


@pytest.mark.parametrize("kind", ["link", "zeros", "pipe", "folder"])
def test_only_regular_files_of_the_folder_are_served(
    server: tuple[subprocess.Popen[str], str], out: Path, tmp_path: Path, kind: str
) -> None:
    (tmp_path / "secret").write_text("secret")
    _, address = server
    for name in ("scene.html", "report.html"):
        (out / name).unlink()
        spoiled(out / name, kind, tmp_path / "secret")
        assert fetch(address + name) == (404, b"")
    assert fetch(address) == (404, b"")
    said = run("view", out)
    assert (said.code, said.out, said.err) == (1, "", f"Error: {out}/scene.html: is not a regular file.\n")


def spoiled(path: Path, kind: str, secret: Path) -> None:
    match kind:
        case "link":
            path.symlink_to(secret)
        case "zeros":
            path.symlink_to("/dev/zero")
        case "pipe":
            os.mkfifo(path)
        case _:
            path.mkdir()


@pytest.mark.parametrize("kind", ["zeros", "pipe", "folder"])
@pytest.mark.parametrize("name", ["model.json", "nominal.urdf"])
def test_results_that_are_no_files_are_said_in_a_sentence(out: Path, tmp_path: Path, name: str, kind: str) -> None:
    (out / name).unlink()
    spoiled(out / name, kind, tmp_path)
    said = run("view", out)
    assert (said.code, said.out) == (1, "")
    assert said.err.endswith(f"{out}/{name}: is not a regular file.\n")
    assert said.err.count("\n") == 1


def test_a_page_that_is_too_large_is_not_served(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calib.presentation.live._LARGEST_PAGE", 1000)
    assert run("view", out) == (1, "", f"Error: {out}/scene.html: is larger than 1000 bytes.\n")


def test_a_port_that_is_taken_is_said_in_a_sentence(out: Path) -> None:
    import socket

    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        said = run("view", out, "--port", str(port))
    assert said.code == 1
    assert said.err.startswith(f"Error: port {port}: cannot be listened on")


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on the path")
def test_a_person_moves_a_joint_and_sees_new_results(server: tuple[subprocess.Popen[str], str], out: Path) -> None:
    _, address = server
    with browser() as page:
        page.size(1280, 900)
        page.open(address)
        page.wait_for("document.querySelectorAll('#live input').length === 6")
        tip = "viewer.scene_tree.find(['robot', 'tool0']).object.position.toArray()"
        said = "[...document.querySelectorAll('#live output')].map(o => o.innerText)"
        values = "[...document.querySelectorAll('#live input')].map(i => Number(i.value))"
        model = load_machine(out)
        tops = "[...document.querySelectorAll('#live label, #said')].map(e => e.getBoundingClientRect().top)"
        before_any = page.evaluate(tops)
        # The sliders tell the readings of the pose that is shown.
        page.evaluate("pose.value = 250; pose.dispatchEvent(new Event('input')); true")
        before = page.evaluate(tip)
        others = page.evaluate("page.readings[250]")
        np.testing.assert_allclose(page.evaluate(values), others, atol=1e-9)
        shown = model.robot.tips(np.radians([others]), model.deviations)[0, :3, 3]
        np.testing.assert_allclose(before, shown, atol=1e-5)
        texts = page.evaluate(said)
        assert [float(text.removesuffix(" deg")) for text in texts] == pytest.approx(others, abs=0.051)
        page.evaluate(
            "(s => { s.value = 40; s.dispatchEvent(new Event('input')); })(document.querySelector('#live input')), true"
        )
        page.wait_for("document.getElementById('said').innerText.includes('mm apart')")
        # One is touched, the others stay, and nothing jumps.
        np.testing.assert_allclose(page.evaluate(values), [40.0, *others[1:]], atol=1e-9)
        assert page.evaluate(said)[1:] == texts[1:]
        assert page.evaluate(tops) == before_any
        lines = "[...document.querySelectorAll('#live output')].map(o => o.getBoundingClientRect().height)"
        assert len(set(page.evaluate(lines))) == 1
        u = np.radians([[40.0, *others[1:]]])
        expected = model.robot.tips(u, model.deviations)[0, :3, 3]
        np.testing.assert_allclose(page.evaluate(tip), expected, atol=1e-6)
        assert np.linalg.norm(expected - before) > 0.1
        # Results of the same folder, anew: the page loads itself again.
        page.evaluate("window.old = true")
        renewed = out.with_name("renewed")
        shutil.copytree(out, renewed)
        out.rename(out.with_name("gone"))
        renewed.rename(out)
        page.wait_for("window.old === undefined && document.querySelectorAll('#live input').length === 6")
        assert page.trouble == []
        assert all(a.startswith((address, address.replace("http", "ws"), "data:")) for a in page.requests)
