"""Many jobs at once: the bytes of single runs, whatever becomes of the others."""

import csv
import errno
import io
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
from concurrent.futures.process import BrokenProcessPool
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import joblib
import psutil
import pytest

from calib.foundations import files
from calib.foundations.errors import JobError, OutputError
from calib.foundations.version import __version__
from calib.job import fleet as fleets
from calib.job.fleet import Done, FleetJob, fleet_jobs, run_fleet, unchanged
from calib.job.fleet_summary import fleet_lines, write_summary
from calib.presentation.fleet_tables import JobLine, QuantityError, fleet_report, fleet_sheet
from calib.presentation.report.markdown import render_markdown
from calib.presentation.report.page import render_page
from calib.presentation.tables import plain, sheet_table
from tests.support.cases import JOB, TABLE, by_another_machine, copy_case, edit, run, tree
from tests.support.swaps import left

MAIN = "from calib.cli import main; main()"
QUIET = {"dashboard_address": "127.0.0.1:0", "silence_logs": 50}
GOOD = ("plain.toml", "fewer.toml")
BAD = 'jobs/bad.toml: error_model.offsets: \'al\' is not "all", "none" or a list of names.'


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two jobs that succeed and one that does not."""
    jobs = tmp_path / "jobs"
    copy_case(jobs).rename(jobs / "plain.toml")
    text = (jobs / "plain.toml").read_text(encoding="utf-8")
    for name, offsets in (("fewer", '["joint_2", "joint_3"]'), ("bad", '"al"')):
        (jobs / f"{name}.toml").write_text(text.replace('offsets = "all"', f"offsets = {offsets}"), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def jobs(*names: str) -> list[str]:
    return [f"jobs/{name}" for name in names]


def moments(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_ino for path in folder.iterdir() if path.is_dir()}


def test_a_system_without_semaphores_is_told(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where /dev/shm is missing or full, joblib has no processes to offer."""
    monkeypatch.delitem(joblib.parallel.BACKENDS, "loky")
    said = run("fleet", *jobs(*GOOD))
    assert (said.code, said.out) == (1, "")
    assert said.err.startswith(
        "Error: calib fleet: cannot share work between processes here, as no semaphore can be made;"
    )


@pytest.mark.parametrize("told", ["LOKY_MAX_CPU_COUNT=abc", "JOBLIB_START_METHOD=zz", "JOBLIB_MULTIPROCESSING=no"])
def test_an_environment_that_makes_no_sense_is_told(folder: Path, told: str) -> None:
    """joblib reads some of it when it is loaded, so that a process of its own shows it."""
    name, _, value = told.partition("=")
    done = subprocess.run(
        [sys.executable, "-c", MAIN, "fleet", *jobs(*GOOD)],
        env={**os.environ, name: value},
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
    assert done.stderr.startswith("Error: calib fleet: joblib, which shares the work between processes, cannot use")
    assert value in done.stderr


@pytest.mark.parametrize("options", [("-X", "dev"), ("-bb",)])
def test_python_may_be_told_to_look_closely(folder: Path, options: tuple[str, ...]) -> None:
    """Of what it warns of then, it takes its own off again as it starts a process, and expects to find it."""
    quiet = "-W", "ignore"  # of libraries
    command = [sys.executable, *quiet, *options, "-c", MAIN, "fleet", *jobs("plain.toml"), "-j", "1", "-q"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_quiet_fleet_tells_why_a_job_failed(folder: Path) -> None:
    said = run("fleet", *jobs("bad.toml"), "-j", "1", "-q")
    assert (said.code, said.out, said.err) == (1, "", f"Error: bad: {BAD}\n")


def test_the_same_bytes_as_single_runs_and_a_bad_job_stops_nobody(folder: Path) -> None:
    said = run("fleet", *jobs("bad.toml", *GOOD), "--jobs", "2")
    assert (said.code, said.err) == (1, "")
    text = " ".join(said.out.split())
    assert f"Warning: bad: failed: {BAD} 3 jobs: 2 trusted, 1 failed. The fleet is in fleet: fleet.html," in text
    assert re.search(r"plain position \[mm\] 31\.0533 0\.0370 27/45 trusted", text)
    for name in GOOD:
        stem = name.removesuffix(".toml")
        assert run("calibrate", f"jobs/{name}", "-o", f"single/{stem}", "-q").code == 0
        assert tree(folder / "fleet" / stem) == tree(folder / "single" / stem)
    summaries = ["fleet.html", "summary.csv", "summary.json"]
    assert sorted(path.name for path in (folder / "fleet").iterdir()) == [
        "fewer",
        *summaries[:1],
        "plain",
        *summaries[1:],
    ]
    contents = json.loads((folder / "fleet/summary.json").read_text(encoding="utf-8"))["fleet"]
    result = json.loads((folder / "fleet/plain/result.json").read_text(encoding="utf-8"))
    assert [one["name"] for one in contents] == ["bad", "plain", "fewer"]
    (error,) = contents[1]["errors"]
    judged = result["metrics"]["validation"]
    assert (error["before"], error["after"]) == (
        judged["before"]["position"]["rms"],
        judged["after"]["position"]["rms"],
    )
    rows = list(csv.DictReader(io.StringIO((folder / "fleet/summary.csv").read_text(encoding="utf-8"))))
    assert [(row["job"], row["verdict"], row["unit"]) for row in rows] == [
        ("bad", "failed", ""),
        ("plain", "trusted", "mm"),
        ("fewer", "trusted", "mm"),
    ]
    assert float(rows[1]["after"]) == pytest.approx(error["after"] * 1e3, abs=1e-6)
    assert (rows[0]["why"], rows[2]["report"]) == (BAD, "fewer/report.html")


def test_what_has_not_changed_is_not_run_again(folder: Path) -> None:
    assert run("fleet", *jobs(*GOOD), "-o", "all", "-j", "1", "-q") == (0, "", "")
    first, made = tree(folder / "all"), moments(folder / "all")
    said = run("fleet", *jobs("bad.toml", *GOOD), "-o", "all", "-j", "1")
    assert said.code == 1
    assert "2 trusted, 1 failed. Unchanged and not run again: 2." in " ".join(said.out.split())
    assert moments(folder / "all") == made
    # An input, the job itself, the results and the versions: each decides.
    job, other = fleet_jobs([Path("jobs/plain.toml"), Path("jobs/fewer.toml")], Path("all"))
    assert unchanged(job)
    for name in (TABLE, "plain.toml"):
        before = (folder / "jobs" / name).read_bytes()
        (folder / "jobs" / name).write_bytes(before + b"\n")
        assert not unchanged(job)
        assert unchanged(other) == (name != TABLE)
        (folder / "jobs" / name).write_bytes(before)
    assert unchanged(job)
    edit("all/plain/result.json", (f'"calib": "{result_version(folder)}"', '"calib": "0.0.0"'))(folder)
    assert not unchanged(job)
    (folder / "all/fewer/report.html").unlink()
    assert not unchanged(other)
    assert run("fleet", *jobs(*GOOD), "-o", "all", "-j", "1", "-q").code == 0
    assert tree(folder / "all") == first
    assert not moments(folder / "all").items() & made.items()


def result_version(folder: Path) -> str:
    return str(json.loads((folder / "all/plain/result.json").read_text(encoding="utf-8"))["versions"]["calib"])


def test_json_and_doubts(folder: Path) -> None:
    (folder / "jobs/plain.toml").rename(folder / "jobs" / JOB)
    by_another_machine(folder / "jobs")
    said = run("fleet", f"jobs/{JOB}", "-j", "1", "--json")
    assert (said.code, said.err) == (3, "")
    assert said.out == (folder / "fleet/summary.json").read_text(encoding="utf-8")
    (one,) = json.loads(said.out)["fleet"]
    assert (one["name"], one["word"]) == ("jobs", "not trusted")
    assert "On held-out data the position error is no smaller than before calibration." in one["why"]


# Before anything runs. --------------------------------------------------------------------------------------------


def test_names_and_folders(tmp_path: Path) -> None:
    given = ("a/calibration.toml", "b/calibration.toml", "b/calibration_fast.toml", "c/x.toml", "c/calibrations.toml")
    found = fleet_jobs([Path(path) for path in given], tmp_path)
    names = ("a", "b", "b_fast", "x", "calibrations")
    assert [(job.name, job.out) for job in found] == [(name, tmp_path / name) for name in names]


REFUSED = [
    (("jobs/plain.toml", "jobs/plain.toml"), "jobs/plain.toml: is named twice; name every job once."),
    (("jobs/plain.toml", "other/plain.toml"), "jobs/plain.toml and other/plain.toml: both would be written to fleet/"),
    (("a/x.toml", "b/X.toml"), "a/x.toml and b/X.toml: both would be written to fleet/X; rename one of them."),
    (
        ("a/\u00e9.toml", "b/e\u0301.toml"),
        "a/\u00e9.toml and b/e\\u0301.toml: both would be written to fleet/e\\u0301; ",
    ),
    (("jobs/.toml",), "jobs/.toml: '.toml' is no name for a folder of results; rename it."),
    (("summary.csv.toml",), "summary.csv.toml: its results would be written to fleet/summary.csv, where a summary "),
]


@pytest.mark.parametrize(("paths", "why"), REFUSED, ids=lambda x: "" if isinstance(x, tuple) else x[:20])
def test_two_jobs_with_one_folder_are_refused(folder: Path, paths: tuple[str, ...], why: str) -> None:
    said = run("fleet", *paths)
    assert (said.code, said.out) == (1, "")
    assert said.err.startswith(f"Error: {why}")
    assert said.err.count("\n") == 1
    assert not (folder / "fleet").exists()


def test_folders_that_cannot_take_a_summary(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "mine").mkdir()
    (folder / "mine/summary.csv").write_text("mine")
    (folder / "file").write_text("mine")
    (folder / "results").mkdir()
    (folder / "results/result.json").write_text("{}")
    for out, why in (
        ("results", "results: holds the results of one job, which nothing else may be in; choose another folder."),
        ("mine", "mine/summary.csv: is no summary of a fleet, and would be replaced by one; choose a folder."),
        ("file", "file: is a file, and the results need a folder."),
        ("x" * 300, f"{'x' * 300}: cannot hold the results (File name too long)."),
    ):
        assert run("fleet", "jobs/plain.toml", "-o", out) == (1, "", f"Error: {why}\n")
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(OutputError, match="read-only"):
        fleet_jobs([], folder / "a/b")


def test_a_folder_of_a_job_that_is_a_link_is_not_followed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where it is made while others run."""
    assert run("calibrate", "jobs/plain.toml", "-o", "precious", "-q").code == 0
    before = tree(folder / "precious")
    (job,) = fleet_jobs([Path("jobs/plain.toml")], Path("fleet"))
    (folder / "fleet").mkdir()
    (folder / "fleet/plain").symlink_to("../precious")
    why = "fleet/plain: is a link, and results would replace what it leads to; remove it."
    assert run("fleet", "jobs/plain.toml") == (1, "", f"Error: {why}\n")
    assert fleets._one(job, str(folder)) == Done(job, why)
    # Also where it becomes one a moment after it was looked at.
    monkeypatch.setattr(fleets, "_refuse_link", lambda _: None)
    failure = fleets._one(job, str(folder)).failure
    assert failure == (
        f"fleet/plain: leads to {folder / 'precious'} now, and led to {folder / 'fleet/plain'} when the work began; "
        "run it again."
    )
    assert tree(folder / "precious") == before


def test_a_fleet_whose_folder_leads_elsewhere_meanwhile_writes_nothing_there(folder: Path) -> None:
    (folder / "all").mkdir()
    (job,) = fleet_jobs([Path("jobs/plain.toml")], Path("all"))
    assert run("calibrate", "jobs/fewer.toml", "-o", "precious/plain", "-q").code == 0
    before = tree(folder / "precious")
    (folder / "all").rmdir()
    (folder / "all").symlink_to("precious")
    led = "{0}: leads to {1}/precious{2} now, and led to {1}/{0} when the work began; run it again."
    assert fleets._one(job, str(folder)).failure == led.format("all/plain", folder, "/plain")
    with pytest.raises(OutputError) as told:
        write_summary([], Path("all"), folder / "all")
    assert str(told.value) == led.format("all", folder, "")
    assert tree(folder / "precious") == before


def test_results_that_another_run_has_put_in_their_place_are_not_told_as_those_of_a_job(folder: Path) -> None:
    (job,) = fleet_jobs([Path("jobs/plain.toml")], Path("all"))
    why = f"{job.out}: holds the results of other inputs, which another run has written there meanwhile."
    for earlier in (False, True):
        finished = run_fleet([job], workers=1)
        assert finished[0].earlier == earlier
        assert fleet_lines(finished)[0].word == "trusted"
        assert run("calibrate", "jobs/fewer.toml", "-o", "all/plain", "-q").code == 0
        (line,) = fleet_lines(finished)
        assert (line.word, line.why, line.report) == ("failed", (why,), None)
        assert run("calibrate", "jobs/plain.toml", "-o", "all/plain", "-q").code == 0


def test_what_a_killed_fleet_left_beside_whole_results_goes_with_the_next(folder: Path) -> None:
    """It was killed when results had their name: they are not made again, and the hidden folder stayed for ever."""
    (job,) = fleet_jobs([Path("jobs/plain.toml")], Path("all"))
    run_fleet([job], workers=1)
    left(folder / "all/.plain.01234567.calib", old=False, new=False)
    theirs = folder / "all/.plain.89abcdef.calib"
    theirs.mkdir()
    (theirs / "list.json").write_text("theirs")
    before = tree(folder / "all/plain")
    assert run_fleet([job], workers=1)[0].earlier
    assert sorted(path.name for path in (folder / "all").iterdir()) == [".plain.89abcdef.calib", "plain"]
    assert tree(folder / "all/plain") == before


def test_a_file_that_somebody_wrote_while_a_fleet_ran_is_not_replaced(folder: Path) -> None:
    (folder / "all").mkdir()
    fleet_jobs([Path("jobs/plain.toml")], Path("all"))
    (folder / "all/summary.csv").write_text("mine")
    with pytest.raises(OutputError, match=r"all/summary\.csv: is no summary of a fleet, and would be replaced by one"):
        write_summary([], Path("all"))
    assert [path.name for path in (folder / "all").iterdir()] == ["summary.csv"]
    assert (folder / "all/summary.csv").read_text() == "mine"


def test_a_fleet_that_cannot_be_written_leaves_no_empty_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(files, "_to_disk", full)  # of the summary; the job is a bad one
    said = run("fleet", "jobs/bad.toml", "-o", "deep/out", "-j", "1", "-q")
    assert (said.code, said.out) == (1, "")
    assert said.err == "Error: deep/out/summary.json: cannot be written (No space left on device).\n"
    assert not (folder / "deep").exists()


# When something dies. ---------------------------------------------------------------------------------------------


def test_a_process_that_dies_costs_no_job(folder: Path) -> None:
    killed: list[int] = []

    def kill(_: str) -> None:
        if not killed:
            workers = [p for p in psutil.Process().children(recursive=True) if "loky" in " ".join(p.cmdline())]
            killed.extend(p.pid for p in workers if "resource_tracker" not in " ".join(p.cmdline()))
            for pid in killed:
                os.kill(pid, signal.SIGKILL)

    chosen = fleet_jobs([Path(f"jobs/{name}") for name in ("bad.toml", *GOOD)], Path("all"))
    found = run_fleet(chosen, workers=2, progress=kill)
    assert killed
    assert [done.failure for done in found] == [BAD, None, None]


def test_a_job_whose_process_dies_is_told_and_the_others_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    def together(tasks):  # type: ignore[no-untyped-def]
        for _, (job, _), _ in list(tasks):
            if job.name == "b":
                raise BrokenProcessPool
            yield Done(job)

    chosen = [FleetJob(Path(name), name, Path(name)) for name in "abcd"]
    monkeypatch.setattr(fleets, "_together", together)
    found = {done.job.name: done.failure for done in fleets._run(chosen)}
    assert found == {"a": None, "b": "b: its process died; the memory may not suffice.", "c": None, "d": None}


def test_that_no_process_can_be_started_is_not_said_of_the_folder(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))

    monkeypatch.setattr(joblib.Parallel, "__call__", full)
    said = run("fleet", "jobs/plain.toml", "-o", "none/left", "-j", "1", "-q")
    why = "calib fleet: its processes cannot be started or spoken to (Resource temporarily unavailable)."
    assert said == (1, "", f"Error: {why}\n")
    assert not (folder / "none").exists()


def test_no_more_processes_are_started_than_there_are_jobs(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    configured = joblib.parallel_config

    def config(backend: str, n_jobs: int, **options: object) -> object:
        asked.append(n_jobs)
        return configured("threading", n_jobs=1)

    monkeypatch.setattr(joblib, "parallel_config", config)
    monkeypatch.setattr(fleets, "calibrated", lambda *_, **__: 1 / 0)
    for workers in (100_000, 2, 1):
        list(run_fleet(fleet_jobs([Path("jobs/plain.toml")], Path("all")), workers=workers))
    assert asked == [2, 2, 1]


def test_a_fault_of_this_program_costs_its_job_alone(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fleets, "calibrated", lambda *_, **__: 1 / 0)
    (done,) = run_fleet(fleet_jobs([Path("jobs/plain.toml")], Path("all")), workers=1)
    assert done.failure == (
        "jobs/plain.toml: met a fault of this program (ZeroDivisionError: division by zero); calib calibrate shows it."
    )
    (line,) = fleet_lines([done])
    assert (line.word, line.report) == ("failed", None)
    missing = Done(FleetJob(Path("x.toml"), "x", folder / "x"))
    assert fleet_lines([missing])[0].why == (f"{folder}/x/result.json: there is no such file.",)
    assert fleets._one(missing.job, "/no/such/folder").failure == (
        "x.toml: its process does not see /no/such/folder (No such file or directory); workers need the same files."
    )


@pytest.mark.parametrize(
    ("by", "all_of_them"),
    [
        (signal.SIGINT, True),
        (signal.SIGTERM, False),
        (signal.SIGTERM, True),
        (signal.SIGHUP, False),
        (signal.SIGHUP, True),
        (signal.SIGKILL, False),
    ],
    ids=["Ctrl-C", "ended", "all ended", "told of a closed terminal", "terminal closed", "killed"],
)
def test_what_is_finished_is_kept_and_the_workers_end(folder: Path, by: signal.Signals, *, all_of_them: bool) -> None:
    many = [f"job_{k}.toml" for k in range(12)]
    for name in many:
        (folder / "jobs" / name).write_bytes((folder / "jobs/plain.toml").read_bytes())
    # Where the tests themselves run in the background, Ctrl-C is ignored, and that is inherited.
    heard = "signal.signal(signal.SIGINT, signal.default_int_handler); signal.signal(signal.SIGHUP, signal.SIG_DFL)"
    listening = f"import signal; {heard}; {MAIN}"
    command = [sys.executable, "-W", "error", "-c", listening, "fleet", *jobs(*many), "-j", "2"]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, process_group=0)
    while running.poll() is None and not list(folder.glob("fleet/job_*/result.json")):
        time.sleep(0.01)
    workers = psutil.Process(running.pid).children(recursive=True)
    assert len(workers) >= 2
    # What minds their resources may find some gone that the signal cut short: it says so to nobody.
    assert [
        "-Wignore" in worker.cmdline() for worker in workers if "loky.backend.resource_tracker" in str(worker.cmdline())
    ] == [True]
    if by == signal.SIGINT:
        os.killpg(running.pid, by)  # as a terminal does
        said = "Error: interrupted; what is finished is kept, and the same command goes on with the rest.\n"
        assert (running.wait(), *running.communicate()) == (130, "", said)
    elif by in (signal.SIGTERM, signal.SIGHUP):
        os.killpg(running.pid, by) if all_of_them else running.send_signal(by)
        # What minds their resources, and has the same standard error, has nothing to tell of.
        assert (running.wait(), *running.communicate()) == (128 + by, "", "")
    else:
        running.kill()
        running.wait()
    while any(worker.is_running() and worker.status() != psutil.STATUS_ZOMBIE for worker in workers):
        time.sleep(0.01)
    running.communicate()
    chosen = fleet_jobs([Path(f"jobs/{name}") for name in many], Path("fleet"))
    assert 1 <= sum(map(unchanged, chosen)) < len(many)


def test_workers_that_are_being_born_do_not_hear_ctrl_c(folder: Path) -> None:
    """While they read their modules, long before they could say what to do about it."""
    (folder / "jobs/other.toml").write_bytes((folder / "jobs/plain.toml").read_bytes())
    listening = f"import signal; signal.signal(signal.SIGINT, signal.default_int_handler); {MAIN}"
    command = [sys.executable, "-W", "error", "-c", listening, "fleet", *jobs("plain.toml", "other.toml"), "-j", "2"]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, process_group=0)
    parent = psutil.Process(running.pid)
    while running.poll() is None and not parent.children():
        time.sleep(0.001)
    os.killpg(running.pid, signal.SIGINT)
    said = "Error: interrupted; what is finished is kept, and the same command goes on with the rest.\n"
    assert (running.wait(), *running.communicate()) == (130, "", said)


def test_ctrl_c_before_a_task_is_taken_leaves_one_sentence(folder: Path) -> None:
    """The thread that hands tasks to workers stumbles over one that it has not taken yet when it is told to end."""
    (folder / "jobs/other.toml").write_bytes((folder / "jobs/plain.toml").read_bytes())
    slow = (
        "from joblib.externals.loky.process_executor import _ExecutorManagerThread as T; "
        "taken = T.add_call_item_to_queue; "
        "T.add_call_item_to_queue = lambda self: taken(self) if self.executor_flags.shutdown else None"
    )
    listening = f"import signal; signal.signal(signal.SIGINT, signal.default_int_handler); {slow}; {MAIN}"
    command = [sys.executable, "-W", "error", "-c", listening, "fleet", *jobs("plain.toml", "other.toml"), "-j", "2"]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, process_group=0)
    parent = psutil.Process(running.pid)
    while running.poll() is None and len(parent.children()) < 3:  # two workers, and what minds their resources
        time.sleep(0.001)
    os.killpg(running.pid, signal.SIGINT)
    said = "Error: interrupted; what is finished is kept, and the same command goes on with the rest.\n"
    assert (running.wait(), *running.communicate()) == (130, "", said)


def test_ctrl_c_pressed_again_leaves_one_sentence(folder: Path) -> None:
    """While workers are ended: they would have found no more what they share, and said so on standard output."""
    (folder / "jobs/other.toml").write_bytes((folder / "jobs/plain.toml").read_bytes())
    again = (
        "import os, time; from joblib.externals.loky.process_executor import _ExecutorManagerThread as T; "
        "ended = T.kill_workers; "
        "T.kill_workers = lambda self, **why: "
        "([(os.kill(os.getpid(), signal.SIGINT), time.sleep(0.3)) for _ in range(3)], ended(self, **why))"
    )
    listening = f"import signal; signal.signal(signal.SIGINT, signal.default_int_handler); {again}; {MAIN}"
    command = [sys.executable, "-W", "error", "-c", listening, "fleet", *jobs("plain.toml", "other.toml"), "-j", "2"]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, process_group=0)
    parent = psutil.Process(running.pid)
    while running.poll() is None and len(parent.children()) < 4:
        time.sleep(0.001)
    os.killpg(running.pid, signal.SIGINT)
    said = "Error: interrupted; what is finished is kept, and the same command goes on with the rest.\n"
    assert (running.wait(), *running.communicate()) == (130, "", said)


def test_a_system_without_threads_is_told_and_not_waited_for(folder: Path) -> None:
    """The thread that hands tasks to workers ended, and all of them were waited for without end."""
    (folder / "jobs/other.toml").write_bytes((folder / "jobs/plain.toml").read_bytes())
    none_left = (
        "from joblib.externals.loky.process_executor import _ExecutorManagerThread as T\n"
        'def none(self): raise RuntimeError("can\'t start new thread")\n'
        f"T.add_call_item_to_queue = none\n{MAIN}"
    )
    command = [sys.executable, "-W", "error", "-c", none_left, "fleet", *jobs("plain.toml", "other.toml"), "-j", "2"]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120.0)
    said = "Error: calib fleet: its processes cannot be started or spoken to (can't start new thread).\n"
    assert (ended.returncode, ended.stdout, ended.stderr) == (1, "", said)


def test_ending_without_workers_makes_none() -> None:
    """Also of an executor that was ended before: a new one would have semaphores, and a process that minds them."""
    from joblib.externals.loky import reusable_executor

    before = reusable_executor._executor
    fleets._end_workers()
    fleets._end_workers()
    assert reusable_executor._executor is before


# A cluster. -------------------------------------------------------------------------------------------------------


def test_on_a_dask_cluster_the_same_bytes(folder: Path) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", **QUIET) as cluster:
        said = run("fleet", *jobs("bad.toml", *GOOD), "--dask", cluster.scheduler_address)
        assert (said.code, said.err) == (1, "")
    for name in ("plain", "fewer"):
        assert run("calibrate", f"jobs/{name}.toml", "-o", f"single/{name}", "-q").code == 0
        assert tree(folder / "fleet" / name) == tree(folder / "single" / name)


def test_two_fleets_on_one_cluster_have_their_own_results(folder: Path) -> None:
    """Also where their jobs have the same names and the second begins while those of the first one wait."""
    distributed = pytest.importorskip("distributed")
    others = Path(shutil.copytree(folder / "jobs", folder / "others"))
    (others / "plain.toml").write_bytes((others / "fewer.toml").read_bytes())
    first = fleet_jobs([Path("jobs") / name for name in GOOD], Path("one"))
    second = fleet_jobs([Path("others") / name for name in GOOD], Path("two"))
    ended: list[Done] = []
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, host="127.0.0.1", **QUIET) as cluster:

        def begin(_: str) -> None:
            if not ended:
                ended.extend(run_fleet(second, dask=cluster.scheduler_address))

        found = run_fleet(first, dask=cluster.scheduler_address, progress=begin)
    assert [(done.job, done.failure) for done in (*found, *ended)] == [(job, None) for job in (*first, *second)]
    assert all(map(unchanged, (*first, *second)))


def test_a_worker_with_many_threads_runs_one_job_at_a_time(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Relative paths would lead to the files of another fleet, as a process is in one folder with all its threads."""
    (job,) = fleet_jobs([Path("jobs/plain.toml")], folder / "all")
    seen: list[tuple[str, str]] = []

    def slow(path: Path, *_: object, meant: Path) -> tuple[Any, Any]:
        before = Path.cwd()
        time.sleep(0.3)
        seen.append((str(before), str(Path.cwd())))
        return SimpleNamespace(origin=SimpleNamespace(hashes={})), None

    monkeypatch.setattr(fleets, "calibrated", slow)
    places = [str(folder / "jobs"), str(folder)]
    threads = [threading.Thread(target=fleets._on_worker, args=(job, to, __version__)) for to in places]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(seen) == sorted((to, to) for to in places)


def test_a_worker_of_another_version_writes_nothing(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, host="127.0.0.1", **QUIET) as cluster:
        ours = fleets.__version__
        monkeypatch.setattr(fleets, "__version__", "9.0")
        said = run("fleet", *jobs(GOOD[0]), "--dask", cluster.scheduler_address)
    assert said.code == 1
    why = f"jobs/plain.toml: its worker has version {ours} of this toolkit, not 9.0; install it there."
    assert why in " ".join(said.out.split())
    assert not (folder / "fleet/plain").exists()


def alive(pids: list[int]) -> list[int]:
    return [pid for pid in pids if psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE]


def test_a_worker_that_is_killed_in_the_middle_costs_no_job(folder: Path) -> None:
    """The other worker, and the one that its nanny starts again, finish them all."""
    distributed = pytest.importorskip("distributed")
    many = [f"job_{k}.toml" for k in range(6)]
    for name in many:
        (folder / "jobs" / name).write_bytes((folder / "jobs/plain.toml").read_bytes())
    chosen = fleet_jobs([Path(f"jobs/{name}") for name in many], Path("all"))
    killed: list[int] = []
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", **QUIET) as cluster:

        def kill(_: str) -> None:
            if not killed:  # when the first job has ended, and both workers have others
                killed.append(next(iter(cluster.workers.values())).pid)
                os.kill(killed[0], signal.SIGKILL)

        found = run_fleet(chosen, dask=cluster.scheduler_address, progress=kill)
    assert killed and not alive(killed)
    assert [done.failure for done in found] == [None] * len(many)
    assert all(map(unchanged, chosen))


def test_a_cluster_that_loses_all_its_workers_is_not_waited_for(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(fleets, "_PATIENCE", 2.0)
    many = [f"job_{k}.toml" for k in range(8)]
    for name in many:
        (folder / "jobs" / name).write_bytes((folder / "jobs/plain.toml").read_bytes())
    chosen = fleet_jobs([Path(f"jobs/{name}") for name in many], Path("all"))
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", **QUIET) as cluster:
        address = cluster.scheduler_address
        with pytest.raises(JobError) as caught:
            run_fleet(chosen, dask=address, progress=lambda _: cluster.scale(0))
    assert str(caught.value) == f"{address}: the Dask cluster has no worker."
    assert 1 <= sum(map(unchanged, chosen)) < len(many)


def test_a_scheduler_that_dies_in_the_middle_is_said(folder: Path) -> None:
    pytest.importorskip("distributed")
    many = [f"job_{k}.toml" for k in range(4)]
    for name in many:
        (folder / "jobs" / name).write_bytes((folder / "jobs/plain.toml").read_bytes())
    chosen = fleet_jobs([Path(f"jobs/{name}") for name in many], Path("all"))
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    dask = [sys.executable, "-m"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    told = ["--host", address, "--no-dashboard"]
    scheduler = subprocess.Popen([*dask, "distributed.cli.dask_scheduler", *told], **quiet)  # type: ignore[call-overload]
    last = ["--nthreads", "1", "--no-nanny", "--no-dashboard", "--death-timeout", "30"]
    worker = subprocess.Popen([*dask, "distributed.cli.dask_worker", address, *last], **quiet)  # type: ignore[call-overload]
    try:
        with pytest.raises(JobError, match="the Dask scheduler is gone; what is finished is kept"):
            run_fleet(chosen, dask=address, progress=lambda _: scheduler.kill())
    finally:
        for process in (scheduler, worker):
            process.kill()
            process.wait()
    assert sum(map(unchanged, chosen)) >= 1


class Told:
    """A job on a cluster as its client sees it, one look after the other; errors are raised when it is asked."""

    key = "calib-0-plain"

    def __init__(self, *looks: tuple[str, object]) -> None:
        self.looks = list(looks)

    @property
    def status(self) -> str:
        return self.looks[0][0]

    def result(self, timeout: float) -> object:
        found = self.looks.pop(0)[1]
        if isinstance(found, BaseException):
            raise found
        return found


def test_what_a_worker_had_found_is_lost_with_it_and_found_again(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A worker may go, and the scheduler too, in the moment between the end of a job and the asking for it."""
    distributed = pytest.importorskip("distributed")
    (job,) = fleet_jobs([Path("jobs/plain.toml")], folder / "all")
    done = Done(job)

    def looked(told: Told) -> list[Done]:
        def look(*_: object, **__: object) -> None:
            if told.status == "lost":
                told.looks.pop(0)

        monkeypatch.setattr(distributed, "wait", look)
        client = SimpleNamespace(
            submit=lambda *_, **__: told,
            as_current=nullcontext,
            status="running",
            scheduler=SimpleNamespace(identity=None),
            sync=lambda *_, **__: {"workers": {"one": {}}},
            cancel=lambda _: None,
        )
        return list(fleets._on_cluster(client, "tcp://here", [job]))

    asleep = TimeoutError()  # its worker does not answer
    assert looked(Told(("finished", asleep), ("lost", None), ("lost", None), ("finished", done))) == [done]
    for gone in (distributed.comm.core.CommClosedError("Stream is closed"), distributed.CancelledError("plain")):
        with pytest.raises(JobError, match="tcp://here: the Dask scheduler is gone; what is finished is kept"):
            looked(Told(("finished", gone)))


def test_dask_says_nothing_where_a_sentence_follows() -> None:
    """It sets levels of its own when it is loaded, which is after the command has begun."""
    pytest.importorskip("distributed")
    code = (
        "import logging; from calib.job.fleet import quieten_dask; quieten_dask(); import distributed; "
        "[logging.getLogger(f'distributed{n}').error('a traceback') for n in ('', '.client', '.core', '.comm.tcp')]"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (said.stdout, said.stderr) == ("", "")


def test_a_scheduler_that_is_stopped_is_not_waited_for(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its connection stays, as the system holds it, and nothing answers."""
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(fleets, "_PATIENCE", 2.0)
    chosen = fleet_jobs([Path("jobs/plain.toml"), Path("jobs/fewer.toml")], Path("all"))
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    told = ["distributed.cli.dask_scheduler", "--host", address, "--no-dashboard"]
    scheduler = subprocess.Popen([sys.executable, "-m", *told], **quiet)  # type: ignore[call-overload]
    try:
        distributed.Client(address, timeout=60, set_as_default=False).close()  # it is there
        submit = distributed.Client.submit

        def stopping(*given: Any, **more: Any) -> Any:
            scheduler.send_signal(signal.SIGSTOP)
            return submit(*given, **more)

        monkeypatch.setattr(distributed.Client, "submit", stopping)
        with pytest.raises(JobError, match="the Dask scheduler is gone; what is finished is kept"):
            run_fleet(chosen, dask=address)
    finally:
        scheduler.send_signal(signal.SIGCONT)
        scheduler.kill()
        scheduler.wait()


def _greet(server: socket.socket, said: bytes) -> None:
    with server.accept()[0] as connection:
        connection.sendall(said)
        connection.recv(1024)


def test_no_cluster(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(fleets, "_PATIENCE", 1)
    chosen = fleet_jobs([Path("jobs/plain.toml")], Path("all"))
    for address in ("tcp://127.0.0.1:1", "nonsense://x", "tls://127.0.0.1:1"):  # TLS without certificates
        for some in (chosen, ()):  # also where nothing is left to do
            with pytest.raises(JobError, match="no Dask scheduler answers there"):
                run_fleet(some, dask=address)
    with socket.create_server(("127.0.0.1", 0)) as silent, pytest.raises(JobError, match="no Dask scheduler answers"):
        run_fleet(chosen, dask=f"tcp://127.0.0.1:{silent.getsockname()[1]}")  # some program that waits to be asked
    for greeting in (b"SSH-2.0-OpenSSH_9.2\r\n", bytes(64)):
        with socket.create_server(("127.0.0.1", 0)) as other:
            greeter = threading.Thread(target=_greet, args=(other, greeting))
            greeter.start()
            with pytest.raises(JobError, match="no Dask scheduler answers"):
                run_fleet(chosen, dask=f"tcp://127.0.0.1:{other.getsockname()[1]}")
            greeter.join()
    with distributed.LocalCluster(n_workers=0, host="127.0.0.1", **QUIET) as cluster:
        with pytest.raises(JobError) as caught:
            run_fleet(chosen, dask=cluster.scheduler_address)
        assert str(caught.value) == f"{cluster.scheduler_address}: the Dask cluster has no worker."
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(JobError) as caught:
        run_fleet(chosen, dask="tcp://127.0.0.1:1")
    assert str(caught.value) == "dask: needs a package that is not installed: pip install 'urdf-calib[dask]'."


# What is shown. ---------------------------------------------------------------------------------------------------

POSE = (
    QuantityError("position", "m", 20, 0.002, 0.0001, 0.0003),
    QuantityError("orientation", "rad", 20, 0.01, 0.001, 0.002),
)
LINES = (
    JobLine("a <b>", "jobs/a.toml", "trusted", (), "validation", POSE, 30, 36, 2, "a <b>/report.html"),
    JobLine("c", "jobs/c.toml", "not trusted", ("It is worse.",), "validation", POSE[:1], 27, 36, 0, "c/report.html"),
    JobLine("d", "jobs/d.toml", "failed", ("d.toml: there is no such file.",)),
)


def test_page_has_every_figure_once_and_leads_to_the_reports() -> None:
    page = render_page(fleet_report(LINES))
    assert page.count("<a href=") == 3 + 2  # two rows of one job, one of another, and the sections
    assert 'href="a%20%3Cb%3E/report.html"' in page
    assert "<b>" not in page
    for figure in ("2.0000", "0.1000", "0.5730", "0.0573", "30/36"):
        assert figure in page
    assert "c: not trusted. It is worse." in page
    assert page.count("<script>") == 1
    assert "[a \\<b\\>](a%20%3Cb%3E/report.html)" in render_markdown(fleet_report(LINES))


@pytest.mark.skipif(sys.platform == "darwin", reason="its file system takes no such names")
def test_a_job_whose_name_is_no_text_is_calibrated_as_others(folder: Path) -> None:
    (folder / "jobs/plain.toml").rename(folder / "jobs/\udcff.toml")
    for earlier in (False, True):
        finished = run_fleet(fleet_jobs([Path("jobs/\udcff.toml")], Path("all")), workers=1)
        assert finished[0].earlier == earlier
        assert fleet_lines(finished)[0].word == "trusted"


def test_a_name_that_is_no_text_leads_to_its_report() -> None:
    name = "caf\udce9"  # as Latin-1 has it
    line = JobLine(name, f"{name}.toml", "trusted", (), "validation", POSE, 30, 36, 0, f"{name}/report.html")
    assert 'href="caf%E9/report.html"' in render_page(fleet_report([line]))


def test_terminal_table_fits() -> None:
    text = plain(sheet_table(fleet_sheet(LINES)))
    assert max(map(len, text.splitlines())) <= 80
    assert re.search(r"orientation \[deg\] +0\.5730 +0\.0573", text)
    assert "outliers: a <b> 2\n" in text
