"""Many jobs over many processes, here or on a Dask cluster: each as if it ran alone, and none in the way of another."""

import asyncio
import logging
import os
import re
import signal
import struct
import sys
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from multiprocessing import resource_tracker
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn
from unicodedata import normalize
from uuid import uuid4

from calib.foundations.errors import CalibError, JobError, OutputError
from calib.foundations.files import LARGEST_JSON, name_as_text, read_bytes, sha256
from calib.foundations.folders import clear_left, reading_folder, real_folder, refuse_unwritable
from calib.foundations.json_text import NotJsonError, parse_json
from calib.foundations.lazy import needed
from calib.foundations.version import __version__
from calib.foundations.words import shown
from calib.job.calibrate import calibrated
from calib.job.read import Progress
from calib.results.calibration import versions
from calib.results.folder import ALWAYS, TO_BE_SEEN
from calib.results.result_file import RESULT_FILE, read_result
from calib.robot.sources import EXAMPLE, resolve

# How long a cluster may take to answer, and may be without any worker, in s.
_PATIENCE = 20.0
# How often a worker looks whether its parent is still there, and we whether the cluster is, in s.
_LOOK = 1.0
# As a shell has it.
_BY_SIGNAL = 128
# The folder in which a process is, and its threads of linear algebra, are those of all its jobs; a worker of Dask takes
# as many at once as it has threads.
_ALONE = threading.Lock()
_DIED = "{}: its process died; the memory may not suffice."
_GONE = "{}: the Dask scheduler is gone; what is finished is kept."
# A job that is called so, as those in robots/ are, says nothing of its arm; its folder does.
_USUAL = re.compile(r"calibration(?![^_.-])")
SUMMARY_JSON = "summary.json"
SUMMARY_CSV = "summary.csv"
PAGE = "fleet.html"
SUMMARIES = (SUMMARY_JSON, SUMMARY_CSV, PAGE)


@dataclass(frozen=True, slots=True)
class FleetJob:
    """A job of a fleet: its file, what it is called, and the folder that its results belong in.

    ``meant``: to what that folder led when the fleet began; None where the machine that it runs on says so.
    """

    path: Path
    name: str
    out: Path
    meant: Path | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Done:
    """What has become of a job. ``failure``: why it has no results, in a sentence.

    ``earlier``: an earlier run made its results, of the very same inputs by the very same versions. ``inputs``: SHA-256
    of what its results were made of, by name; others may be in its folder by the time that it is read.
    """

    job: FleetJob
    failure: str | None = None
    earlier: bool = False
    inputs: Mapping[str, str] | None = None


def fleet_jobs(paths: Sequence[Path], out: Path) -> tuple[FleetJob, ...]:
    """Return the jobs of a fleet whose results go to folders of their names in ``out``.

    A job is called as its file; of ``calibration.toml`` or ``calibration_fast.toml`` in the folder ``ur10`` that is
    ``ur10`` and ``ur10_fast``. Raises JobError when a job has no usable name or two would be written to one folder,
    OutputError when ``out`` cannot take the summary, or has a link where a folder of results belongs.
    """
    own = real_folder(out)
    found: dict[str, FleetJob] = {name: FleetJob(out / name, name, out / name) for name in SUMMARIES}
    for path in paths:
        name = path.stem
        if usual := _USUAL.match(name):
            name = path.absolute().parent.name + name[usual.end() :]
        if not name or name.startswith("."):
            raise JobError(f"{path}: {name!r} is no name for a folder of results; rename it.")
        key = normalize("NFC", name).casefold()  # some file systems know no capitals, or one way to write an accent
        if key in SUMMARIES:
            raise JobError(f"{path}: its results would be written to {out / name}, where a summary belongs; rename it.")
        if key in found and found[key].path.absolute() == path.absolute():
            raise JobError(f"{path}: is named twice; name every job once.")
        if key in found:
            raise JobError(f"{found[key].path} and {path}: both would be written to {out / name}; rename one of them.")
        found[key] = FleetJob(path, name, out / name, own / name)
    _refuse_fleet(out)
    jobs = tuple(found.values())[len(SUMMARIES) :]
    for job in jobs:
        _refuse_link(job)
    return jobs


def _refuse_link(job: FleetJob) -> None:
    """Raise OutputError where a folder of results is a link: the folder of the fleet was named, and not the other."""
    if job.out.is_symlink():
        raise OutputError(f"{job.out}: is a link, and results would replace what it leads to; remove it.")


def _refuse_fleet(out: Path) -> None:
    """Refuse a folder that is none, is read-only, or in which the summary would take the place of somebody's file."""
    refuse_unwritable(out, exchanged=False)
    if os.path.lexists(out / RESULT_FILE):
        raise OutputError(f"{out}: holds the results of one job, which nothing else may be in; choose another folder.")
    refuse_other_summary(out)


def refuse_other_summary(out: Path) -> None:
    """Raise OutputError where the summary of a fleet would take the place of a file that is none."""
    there = [name for name in SUMMARIES if os.path.lexists(out / name)]
    if there and not _is_summary(out / SUMMARY_JSON):
        raise OutputError(f"{out / there[0]}: is no summary of a fleet, and would be replaced by one; choose a folder.")


def _is_summary(path: Path) -> bool:
    try:
        contents = parse_json(read_bytes(path, OutputError, LARGEST_JSON))
        return isinstance(contents, dict) and isinstance(contents.get("fleet"), list)
    except (OutputError, NotJsonError):
        return False


def unchanged(job: FleetJob) -> bool:
    """Return whether a job's folder holds whole results of its very inputs, byte by byte, made by these versions."""
    return _made_of(job) is not None


def _made_of(job: FleetJob) -> Mapping[str, str] | None:
    """Return the hashes of a job's inputs where its results are :func:`unchanged`."""
    try:
        with reading_folder(job.out):
            there = {entry.name for entry in job.out.iterdir()}
            result = read_result(job.out)
        same = (
            there.issuperset((*ALWAYS, *TO_BE_SEEN))
            and result.versions == versions()
            and name_as_text(job.path) in result.inputs
            and all(_hash(job, name) == known for name, known in result.inputs.items())
        )
        return result.inputs if same else None
    except (CalibError, OSError, ValueError):
        return None


def _hash(job: FleetJob, name: str) -> str:
    """Return the hash of an input by its name in the result. While the job is the same, it names the same inputs."""
    path = job.path if name == name_as_text(job.path) else job.path.parent / name
    return sha256(read_bytes(resolve(name) if name.startswith(EXAMPLE) else path, JobError))


def run_fleet(
    jobs: Sequence[FleetJob],
    workers: int | None = None,
    dask: str | None = None,
    progress: Progress = lambda _: None,
    *,
    again: bool = False,
) -> tuple[Done, ...]:
    """Calibrate every job and return what has become of each, in their order.

    ``workers``: processes on this machine, one for every core when None; each has one thread of linear algebra. Or
    ``dask``: the address of a scheduler whose workers see the same files. A job that fails, or whose process dies,
    does not stop the others. A job whose results are :func:`unchanged` is not run, unless ``again``. ``progress`` is
    told of every job that has ended. Raises JobError when the cluster cannot be reached or has no worker left.
    """
    made = {} if again else {job.name: _made_of(job) for job in jobs}
    done = {job.name: Done(job, earlier=True, inputs=made[job.name]) for job in jobs if made.get(job.name) is not None}
    for one in done.values():  # nobody else comes to write there
        clear_left(one.job.out, patience=0.0)
    waiting = [job for job in jobs if job.name not in done]
    if waiting or dask is not None:  # an address with a mistake is told also where there is nothing to do
        with _local(workers, waiting) if dask is None else _cluster(dask, waiting) as finished:
            for one in finished:
                done[one.job.name] = one
                progress(f"{len(done)} of {len(jobs)} jobs: {one.job.name}")
    return tuple(done[job.name] for job in jobs)


def _run(jobs: Sequence[FleetJob]) -> Generator[Done, None, None]:
    """Yield what has become of jobs over processes of this machine, as they end."""
    import joblib  # noqa: PLC0415 - calib must not load it on import

    waiting, folder = list(jobs), str(Path.cwd())

    def tasks(chosen: Iterable[FleetJob], begun: list[FleetJob]) -> Iterator[Any]:
        for job in chosen:
            begun.append(job)
            yield joblib.delayed(_one)(job, folder)

    while waiting:
        begun: list[FleetJob] = []
        try:
            with closing(_together(tasks(tuple(waiting), begun))) as finished:
                for done in finished:
                    waiting.remove(done.job)
                    yield done
        except BrokenProcessPool:
            # Which of those that had begun it was, only each by itself tells; the rest then goes on together.
            for job in [job for job in begun if job in waiting]:
                try:
                    (done,) = _together(tasks((job,), []))
                except BrokenProcessPool:
                    done = Done(job, _DIED.format(job.path))
                waiting.remove(job)
                yield done


def _together(tasks: Iterable[Any]) -> Generator[Done, None, None]:
    """Yield what comes of tasks that run at the same time.

    Raises BrokenProcessPool when a process of theirs died, JobError where the system has none to give.
    """
    import joblib  # noqa: PLC0415 - calib must not load it on import

    parallel = joblib.Parallel(return_as="generator_unordered", batch_size=1, pre_dispatch="n_jobs")
    found: Generator[Done, None, None] | None = None
    try:
        with _born_deaf():
            found = parallel(tasks)
        yield from found
    except OSError as e:
        raise JobError(f"calib fleet: its processes cannot be started or spoken to ({e.strerror or e}).") from e
    finally:
        if found is not None:
            found.close()


def _one(job: FleetJob, folder: str) -> Done:
    """Calibrate one job in a process that may be anywhere; ``folder``: where the paths of the fleet begin."""
    try:
        os.chdir(folder)  # files are then named as in a run of the job alone
    except OSError as e:
        return Done(job, f"{job.path}: its process does not see {folder} ({e.strerror}); workers need the same files.")
    try:
        _refuse_link(job)
        # Nor may it become a link from now on.
        meant = job.meant or real_folder(job.out.parent) / job.out.name
        found, _ = calibrated(job.path, job.out, lambda _: None, lambda _: None, meant=meant)
    except CalibError as e:
        return Done(job, str(e))
    except Exception as e:  # noqa: BLE001 - a fault of this program in one job is not to cost the others
        return Done(
            job, f"{job.path}: met a fault of this program ({type(e).__name__}: {e}); calib calibrate shows it."
        )
    return Done(job, inputs=dict(found.origin.hashes))


def _on_worker(job: FleetJob, folder: str, version: str) -> Done:
    """Calibrate one job on a worker of a cluster, which has to be of the ``version`` that asks it to."""
    job = replace(job, meant=None)  # the same folder may have another name there
    if version != __version__:
        return Done(
            job, f"{job.path}: its worker has version {__version__} of this toolkit, not {version}; install it there."
        )
    with _ALONE:
        return _one(job, folder)


@contextmanager
def _local(workers: int | None, jobs: Sequence[FleetJob]) -> Iterator[Iterable[Done]]:
    """Run jobs over processes of this machine; what is given yields what has become of them, as they end.

    Raises JobError where the system has no processes to give, or the environment says of them what makes no sense.
    """
    try:
        import joblib  # noqa: PLC0415 - calib must not load it on import
        from joblib.parallel import BACKENDS  # noqa: PLC0415

        cores = joblib.cpu_count()
    except ValueError as e:
        raise JobError(
            "calib fleet: joblib, which shares the work between processes, cannot use what the environment tells it "
            f"({shown(str(e))}); unset the variables that begin with JOBLIB_ and LOKY_."
        ) from e
    if "loky" not in BACKENDS:  # joblib found no semaphores
        raise JobError(
            "calib fleet: cannot share work between processes here, as no semaphore can be made; let /dev/shm be "
            "writable and have room, leave JOBLIB_MULTIPROCESSING unset, or run the jobs by calib calibrate."
        )
    # All would be started, also those for which there is no job; two at least, or the job would run in this process.
    wanted = cores if workers is None else workers
    count = min(wanted, max(2, len(jobs)))
    started = {"initializer": _serve, "initargs": (os.getpid(),)}

    loky = joblib.parallel_config("loky", n_jobs=count, inner_max_num_threads=1, **started)
    _mind_quietly()
    with loky, _ending_in_order(), _ending_quietly(), warnings.catch_warnings():
        # Whoever interrupts knows that tasks are left undone.
        warnings.filterwarnings("ignore", r".*tasks (which were still|have been successfully)")
        try:
            with closing(_run(jobs)) as finished:
                yield finished
        finally:
            _end_workers()


def _mind_quietly() -> None:
    """Start the helper of joblib that takes back what processes share, without warnings: of what it finds gone, too.

    A signal may come between taking something back and telling the helper of it. It outlives this process, also where a
    terminal that is closed tells all of them to end: what follows it would know of nothing, and say so by tracebacks.
    """
    from joblib.externals.loky.backend import resource_tracker  # noqa: PLC0415 - calib must not load it on import

    given = sys.warnoptions
    sys.warnoptions = [*given, "ignore"]  # it is started with these; what -X dev and -b give, Python takes off again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})
    try:
        resource_tracker.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        sys.warnoptions = given


@contextmanager
def _ending_in_order() -> Iterator[None]:
    """Let SIGTERM end the block as Ctrl-C does, so that it ends its processes and takes back what they shared.

    So does a terminal that is closed. Else the helper of joblib, which lives longer, tells of all that was left. The
    exit code is the one of the signal. Ctrl-C is heard once: pressed again, it would leave workers that live and have
    no more what they share, and say so.
    """

    def told(number: int, _: FrameType | None) -> NoReturn:
        signal.signal(number, signal.SIG_DFL)  # who asks twice does not wait
        raise SystemExit(_BY_SIGNAL + number)

    def pressed(number: int, _: FrameType | None) -> NoReturn:
        signal.signal(number, signal.SIG_IGN)
        raise KeyboardInterrupt

    ends, closed = (_heard(number, signal.SIG_DFL, told) for number in (signal.SIGTERM, signal.SIGHUP))
    with ends, closed, _heard(signal.SIGINT, signal.default_int_handler, pressed):
        yield


@contextmanager
def _heard(number: int, usual: Any, ours: Callable[[int, FrameType | None], NoReturn]) -> Iterator[None]:
    """Handle a signal by ``ours`` while the block runs, where it is handled as usual: what others have set stays."""
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(number) != usual:
        yield
        return
    signal.signal(number, ours)
    try:
        yield
    finally:
        signal.signal(number, usual)


@contextmanager
def _ending_quietly() -> Iterator[None]:
    """Let the thread in which joblib looks after its processes end without a traceback, and never alone.

    Told to end before it has taken the task that was given last, it has ended all processes and given up all tasks, and
    then still looks that one up (loky 3.5). Of whatever else ends it, as of a system that has no threads left, nobody
    would hear, and all tasks would be waited for without end: they are given up with what it met.
    """
    before = threading.excepthook

    def met(said: threading.ExceptHookArgs) -> None:
        told = getattr(getattr(said.thread, "executor_flags", None), "kill_workers", False)
        if told and issubclass(said.exc_type, KeyError):
            return
        give_up = getattr(said.thread, "terminate_broken", None)
        if give_up is None:
            before(said)
        else:
            give_up(OSError(str(said.exc_value)))

    threading.excepthook = met
    try:
        yield
    finally:
        threading.excepthook = before


def quieten_dask() -> None:
    """Let Dask say nothing in this process: of a lost scheduler, and of Ctrl-C meanwhile, it tells by tracebacks.

    For commands, which tell by a sentence. Dask is loaded first, as it then sets levels of its own.
    """
    with suppress(ImportError):  # that it is not there is told later
        import distributed  # noqa: F401, PLC0415 - an optional dependency
    for name in ("distributed", "distributed.client", "tornado.application"):
        logging.getLogger(name).setLevel(logging.CRITICAL)


@contextmanager
def _cluster(address: str, jobs: Sequence[FleetJob]) -> Iterator[Iterable[Done]]:
    """Run jobs over the workers of a Dask cluster, as :func:`_local`."""
    with needed(JobError, "dask: needs a package", " that is not installed: pip install 'urdf-calib[dask]'"):
        from distributed import Client  # noqa: PLC0415 - an optional dependency
        from distributed.utils import LoopRunner  # noqa: PLC0415 - an optional dependency
        from tornado.websocket import WebSocketError  # noqa: PLC0415 - only Dask speaks it here
    try:
        LoopRunner(asynchronous=False).run_sync(_greeted, address)
        client = Client(address, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError, TypeError, MemoryError, struct.error, WebSocketError) as e:
        # What Dask makes of an address that is none, of TLS without certificates, and of another program's greeting.
        raise JobError(f"{address}: no Dask scheduler answers there, as at tcp://host:8786.") from e
    with client, closing(_on_cluster(client, address, jobs)) as finished:
        yield finished


async def _greeted(address: str) -> None:
    """Return when something at an address has greeted as Dask does. A client waits for that without end."""
    from distributed.comm import connect  # noqa: PLC0415 - an optional dependency

    greeted = await asyncio.wait_for(connect(address, timeout=_PATIENCE), _PATIENCE)
    greeted.abort()


def _on_cluster(client: Any, address: str, jobs: Sequence[FleetJob]) -> Generator[Done, None, None]:
    """Yield what has become of jobs, as they end. The scheduler gives those of a worker that dies to another one.

    No wait is without end: raises JobError when there has been no worker for some time, or no scheduler.
    """
    from distributed import CancelledError, wait  # noqa: PLC0415 - an optional dependency

    # What has the key of something that is there already is not run: other fleets have jobs of the same names.
    folder, own = str(Path.cwd()), uuid4().hex
    waiting = {
        client.submit(_on_worker, job, folder, __version__, pure=False, key=f"calib-{own}-{k}-{job.name}"): job
        for k, job in enumerate(jobs)
    }
    last_seen = time.monotonic()
    try:
        while waiting:
            # Futures are cancelled when the connection to the scheduler is lost; their status says so too.
            with suppress(TimeoutError, CancelledError), client.as_current():
                wait(list(waiting), timeout=_LOOK, return_when="FIRST_COMPLETED")
            for future, job in list(waiting.items()):
                if (done := _ended(future, job, address)) is not None:
                    del waiting[future]
                    yield done
            if client.status != "running":
                raise JobError(_GONE.format(address))
            if _has_workers(client, address):
                last_seen = time.monotonic()
            elif time.monotonic() - last_seen > _PATIENCE:
                raise JobError(f"{address}: the Dask cluster has no worker.")
    finally:
        client.cancel(list(waiting))


def _has_workers(client: Any, address: str) -> bool:
    """Return whether a cluster has workers. A scheduler that is stopped keeps its connection and answers nothing."""
    try:
        return bool(client.sync(client.scheduler.identity, callback_timeout=_PATIENCE)["workers"])
    except OSError as e:  # also what times out
        raise JobError(_GONE.format(address)) from e


def _ended(future: Any, job: FleetJob, address: str) -> Done | None:
    """Return what has become of a job, or None where that is still to come.

    What has come of it is with its worker: when that one goes before it is asked, the job runs once more.
    """
    from distributed import CancelledError, KilledWorker  # noqa: PLC0415 - an optional dependency

    status = future.status
    if status in ("pending", "lost"):
        return None
    try:
        if status == "finished":
            done: Done = future.result(timeout=_PATIENCE)
            return done
        if status == "error":
            error = future.exception(timeout=_PATIENCE)
            if isinstance(error, KilledWorker):
                return Done(job, _DIED.format(job.path))
            return Done(job, f"{job.path}: cannot run on a worker of the cluster ({type(error).__name__}: {error}).")
    except TimeoutError:
        return None
    except (OSError, CancelledError) as e:
        raise JobError(_GONE.format(address)) from e
    raise JobError(_GONE.format(address))


@contextmanager
def _born_deaf() -> Iterator[None]:
    """Let processes that are started here not hear Ctrl-C until :func:`_serve` says what they do about it.

    What a thread blocks is inherited, also by a process that still reads its modules. This process, whose other threads
    hear the signal, heeds it when all are born: one that is half told what it is would complain.
    """
    # A helper of the standard library, which the workers ask for, minds itself, but unblocks the signal as it starts.
    resource_tracker.ensure_running()
    pressed: list[int] = []
    heeds = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, lambda number, _: pressed.append(number)) if heeds else None
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if heeds:
            signal.signal(signal.SIGINT, handler)
    if pressed:
        signal.raise_signal(signal.SIGINT)


def _serve(parent: int) -> None:
    """Let Ctrl-C, which every process of a terminal gets, be the business of the parent, and end when it is gone.

    What libraries warn of is shown where somebody asks for it with -W, as by the parent.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if not sys.warnoptions:
        warnings.simplefilter("ignore")

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_LOOK)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _end_workers() -> None:
    from joblib.externals.loky import reusable_executor  # noqa: PLC0415 - calib must not load it on import

    # Whoever asks for it by its function is given a new one, with semaphores, where it has ended or never begun.
    if (executor := reusable_executor._executor) is not None:
        executor.shutdown(kill_workers=True)
