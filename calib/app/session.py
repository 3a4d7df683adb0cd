"""One person's files and answers, and the one child process that works on them; what the page shows is its state."""

import asyncio
import contextlib
import json
import os
import re
import sys
import time
import weakref
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from calib.app.folder import JOB, RESULT, SESSION, apart, chosen, is_there, kind_of, remove, stamps, take, unpacked
from calib.foundations.errors import JobError, OutputError
from calib.foundations.files import DAMAGED, LARGEST_JSON, read_inside, write_atomically
from calib.foundations.words import shown
from calib.measurement.cells import MOST_COLUMNS
from calib.robot.sources import EXAMPLE

UNKNOWN = "The page does not know this request."
_CHILD = (sys.executable, "-P", "-W", "ignore", "-m", "calib.app.child")
# A line of a child has at most all columns of all tables.
_LONGEST_LINE = 50_000_000
# How long a child that is to end may tidy up, in s.
_PATIENCE = 5.0
_ANSWERS = ("tip", "angles", "lengths", "orientation", "observes")
_LONGEST_TEXT, _LONGEST_JOB = 500, 500_000
_CAMERAS = ("tip", "floor")
# As the system does where memory is short.
_DIED = "The process that worked on this was killed; the memory may not suffice."
_ERROR = re.compile(r"[^\n]*\S\s*\Z")


class Session:
    """What was dropped and said so far. One child works at a time: a new look ends the look before it.

    It is kept in the folder, so that a page that is served there again goes on with it.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        # Held open, so that no other folder gets its number.
        self._own = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        weakref.finalize(self, os.close, self._own)
        self._files: dict[str, int] = {}
        # What they are called where they come from: two names may become one when they are made plain.
        self._called: dict[str, str] = {}
        self._asked: dict[str, Any] = {
            "robot": "",
            "answers": {},
            "stack": False,
            "each_point": False,
            "camera_on": "tip",
        }
        self._look: dict[str, Any] | None = None
        self._results: dict[str, Any] | None = None
        # Stamps of the files: as a child began, and those that what was found is of.
        self._before: dict[str, list[int] | None] = {}
        self._of: dict[str, list[int] | None] = {}
        self._sentence = self._left_out = ""
        self._busy: dict[str, Any] | None = None
        self._begun = 0.0
        self._work: asyncio.Task[None] | None = None
        self._over = False
        if (folder / SESSION).exists():
            self._go_on()

    def state(self) -> dict[str, Any]:
        """Return all that the page shows, as plain data; of a folder that is gone nothing but that."""
        busy = None
        if self._gone:
            self._files, self._called, self._asked["robot"] = {}, {}, ""
            self._changed()
            self._sentence = self._gone
        if self._busy is not None:
            busy = {**self._busy, "seconds": round(time.monotonic() - self._begun)}
        return {
            "files": [{"name": name, "kind": kind_of(name), "size": size} for name, size in self._files.items()],
            **self._asked,
            "look": self._look,
            "results": self.results,
            "sentence": self._sentence,
            "left_out": self._left_out,
            "busy": busy,
        }

    @property
    def results(self) -> dict[str, Any] | None:
        """The verdict of the results in the folder; of others, or where a file is not what it was, there is none."""
        if self._results is not None and self.seen() != self._of:
            self._results = None
        return self._results

    def seen(self) -> dict[str, list[int] | None]:
        """Return stamps of all files that count."""
        return stamps(self.folder, self._files)

    @property
    def _gone(self) -> str:
        """A sentence where the folder is no more, or another one is in its place; else nothing."""
        with contextlib.suppress(OSError):
            if os.path.samestat(os.fstat(self._own), self.folder.stat()):
                return ""
        return f"{self.folder}: is gone, with all files of this page; end calib app, and begin it again."

    def refuse_gone(self) -> None:
        """Raise OutputError where the folder is no more."""
        if self._gone:
            raise OutputError(self._gone)

    def offer(self, paths: Sequence[str]) -> dict[str, str]:
        """Return which of the files that a person is about to drop are to be sent, and by which names."""
        names = chosen(paths)
        wanted = apart(names, self._names())
        self._called |= {wanted[path]: name for path, name in names.items()}
        self._leave_out(len(paths) - len(wanted))
        return wanted

    def _names(self) -> dict[str, str]:
        """Return what the files that are here are called."""
        return {name: self._called.get(name, name) for name in self._files}

    async def drop(self, name: str, data: bytes) -> None:
        """Take a dropped file, or those in an archive. Raises CalibError."""
        await self._alone()
        self._changed()
        if kind_of(name) != "archive":
            self._keep(name, data)
            self._write()
            return
        files = unpacked(data, name, self._names())
        try:
            while (file := await asyncio.to_thread(next, files, None)) is not None:
                kept, called, contents = file
                await self._alone()  # another window may have begun something meanwhile
                self._changed()
                self._called[kept] = called
                self._keep(kept, contents)
        finally:
            self._write()

    def _keep(self, name: str, data: bytes) -> None:
        plain = take(self.folder, name, data, self._files)
        self._files[plain] = len(data)
        if kind_of(plain) == "robot":
            self._asked["robot"] = plain

    async def remove(self, name: str) -> None:
        """Remove a dropped file."""
        await self._alone()
        if name not in self._files:
            raise OutputError(f"{shown(name)}: there is no such file.")
        remove(self.folder, name)
        del self._files[name]
        if self._asked["robot"] == name:
            self._asked["robot"] = next((file for file in self._files if kind_of(file) == "robot"), "")
        self._left_out = ""
        self._changed()
        self._write()

    async def look(self, said: Mapping[str, Any]) -> None:
        """Begin to look at the files with what the page says of them. Raises CalibError."""
        await self._alone()
        self._asked = self._understood(said)
        self._changed()
        kinds = {"table": "tables", "photograph": "photographs", "settings": "settings", "mesh": "meshes"}
        of = {plural: [name for name in self._files if kind_of(name) == kind] for kind, plural in kinds.items()}
        self._begin("look", {**self._asked, **of})

    async def check(self, job: str) -> None:
        """Begin to check a job as the page has it. Raises CalibError."""
        await self._alone()
        if len(job) > _LONGEST_JOB:
            raise JobError(f"The job is longer than {_LONGEST_JOB} characters.")
        write_atomically(self.folder / JOB, job)
        self._results = None
        if self._look is not None:
            self._look = {**self._look, "job": job, "findings": None}
        self._begin("check", {})

    async def calibrate(self) -> None:
        """Begin the calibration. Raises CalibError."""
        await self._alone()
        if self._look is None or self._look.get("findings") is None:
            raise JobError("There is no job to calibrate yet.")
        self._results = None
        self._begin("calibrate", {})

    async def end(self) -> None:
        """End the child process, and begin none any more.

        Requests that are still answered would: asyncio waits without end for a child that is begun while its loop ends.
        """
        self._over = True
        await self.cancel()

    async def cancel(self) -> None:
        """End the child process, if there is one, and wait until it has."""
        while self._work is not None:
            await self._end_work(self._work)

    async def _alone(self) -> None:
        """End a look that is under way; refuse to change files under a calibration, or where folder or page is no more.

        Whoever waits for the end of a look may find that another window has begun something since.
        """
        while True:
            self.refuse_gone()
            if self._over:
                raise JobError("The page has ended.")
            if self._busy is not None and self._busy["verb"] == "calibrate":
                raise JobError("A calibration is under way; wait for its end, or cancel it.")
            if self._work is None:
                return
            await self._end_work(self._work)

    async def _end_work(self, work: asyncio.Task[None]) -> None:
        work.cancel()
        try:
            with contextlib.suppress(asyncio.CancelledError):
                await work
        finally:
            if self._work is work:
                self._work = self._busy = None  # also where it had not begun yet

    def _changed(self) -> None:
        self._look = self._results = None
        self._sentence = ""

    def _leave_out(self, count: int) -> None:
        files = "file is" if count == 1 else "files are"
        self._left_out = f"{count} {files} left out: neither robot, mesh, table, photograph nor job." if count else ""

    def _write(self) -> None:
        """Keep what was dropped, said and found."""
        kept = {
            "files": self._files,
            "called": self._names(),
            "asked": self._asked,
            "look": self._look,
            "results": self._results,
            "of": self._of,
        }
        write_atomically(self.folder / SESSION, json.dumps({**kept, "sentence": self._sentence}))

    def _go_on(self) -> None:
        """Take up what was kept, as far as the files are still there. Raises OutputError."""
        where = self.folder / SESSION
        try:
            kept = json.loads(read_inside(self.folder, SESSION, OutputError, LARGEST_JSON))
            files, look, results = kept["files"], kept["look"], kept["results"]
            self._files = {name: int(size) for name, size in files.items() if is_there(self.folder, name)}
            self._called = {name: str(kept.get("called", {}).get(name, name)) for name in self._files}
            if kept["asked"]["robot"] in files and kept["asked"]["robot"] not in self._files:
                kept["asked"]["robot"] = ""
            self._asked = self._understood(kept["asked"])
            self._sentence = str(kept["sentence"])
        except DAMAGED as e:
            raise OutputError(f"{where}: was not written by this page; choose another folder.") from e
        # What was found holds for all files that were there, as they were.
        of, now = kept.get("of"), self.seen()
        if isinstance(of, dict) and {**of, RESULT: None} == {**now, RESULT: None} and now[JOB] is not None:
            self._of = of
            self._look = look if isinstance(look, dict) else None
            self._results = results if isinstance(results, dict) else None

    def _understood(self, said: Mapping[str, Any]) -> dict[str, Any]:
        """Return what the page says, each of its kind. Raises JobError; what it means the look finds out."""
        robot, camera_on = said.get("robot", ""), said.get("camera_on", "tip")
        answers = said.get("answers", {})
        if not (isinstance(robot, str) and isinstance(answers, dict) and camera_on in _CAMERAS):
            raise JobError(UNKNOWN)
        if not (robot in ("", *self._files) or robot.startswith(EXAMPLE)):
            raise JobError(f"{shown(robot)}: is neither a dropped file nor an example.")
        columns = answers.get("columns", {})
        texts = [answers[key] for key in _ANSWERS if key in answers]
        if not isinstance(columns, dict) or len(columns) > MOST_COLUMNS:
            raise JobError(UNKNOWN)
        texts += [*columns, *columns.values()]
        if not all(isinstance(text, str) and len(text) <= _LONGEST_TEXT for text in texts):
            raise JobError(f"An answer must be text of at most {_LONGEST_TEXT} characters.")
        kept = {key: answers[key] for key in _ANSWERS if answers.get(key)} | ({"columns": columns} if columns else {})
        ticked = {key: said.get(key) is True for key in ("stack", "each_point")}
        return {"robot": robot, "answers": kept, **ticked, "camera_on": camera_on}

    def _begin(self, verb: str, asked: Mapping[str, Any]) -> None:
        self._sentence = ""
        self._busy = {"verb": verb, "step": "starting", "done": 0, "of": 1}
        self._begun = time.monotonic()
        self._before = self.seen()
        self._work = asyncio.create_task(self._run(verb, asked))

    async def _run(self, verb: str, asked: Mapping[str, Any]) -> None:
        pipe = asyncio.subprocess.PIPE
        # Ctrl-C in the terminal is for the server, which ends the child in its turn.
        own: dict[str, Any] = {"cwd": self.folder, "limit": _LONGEST_LINE, "start_new_session": True}
        try:
            child = await asyncio.create_subprocess_exec(*_CHILD, stdin=pipe, stdout=pipe, stderr=pipe, **own)
        except OSError as e:  # as where the folder has just been removed
            self._busy, self._sentence = None, f"No process can be started ({e.strerror})."
            return
        assert child.stdin is not None
        assert child.stdout is not None
        assert child.stderr is not None
        # Both are read at once: a child that has said much to one would wait for its reader.
        trouble = asyncio.create_task(child.stderr.read())
        told: dict[str, Any] = {}
        try:
            child.stdin.write(json.dumps({"verb": verb, **asked}).encode())
            child.stdin.close()
            async for line in child.stdout:
                if not line.endswith(b"\n"):
                    break  # killed while it wrote
                told = json.loads(line)
                if "step" in told:
                    self._busy = {"verb": verb, **told}
            ended = await child.wait()
            self._take(verb, told, _why(ended, (await trouble).decode(errors="replace")))
        finally:
            await _ended(child)
            trouble.cancel()
            self._busy = None
            with contextlib.suppress(OutputError):  # on a full disk the page goes on, and is not kept
                self._write()

    def _take(self, verb: str, told: Mapping[str, Any], why: str) -> None:
        """Keep what a child has found, or the sentence that it told; ``why``: that of one that told none."""
        found, now = told.get("found"), self.seen()
        # A look writes the job, and tables and the robot of other files.
        self._of = now if verb == "look" else {**self._before, RESULT: now[RESULT]}
        if found is None:
            self._sentence = told.get("sentence") or why
        elif verb == "calibrate":
            self._results = found
            if self.results is None:
                self._sentence = "Files changed while this worked, and the results are not of those that are there now."
        elif verb == "look":
            self._look = found
        else:
            self._look = {**(self._look or {}), **found}


def _why(code: int, trouble: str) -> str:
    """Return a sentence on a child that ended with ``code`` and ``trouble`` on its standard error."""
    if code < 0:
        return _DIED
    last = _ERROR.search(trouble)
    why = f" ({last[0].strip()[:_LONGEST_TEXT]})" if last else ""
    return f"This ended by an error of the program; please report it{why}."


async def _ended(child: asyncio.subprocess.Process) -> None:
    """End a child that still works: it tidies up, or is killed."""
    if child.returncode is not None:
        return
    with contextlib.suppress(ProcessLookupError):
        child.terminate()
        try:
            await asyncio.wait_for(child.wait(), _PATIENCE)
        except TimeoutError:
            child.kill()
            await child.wait()
