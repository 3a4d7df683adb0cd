"""How the command starts and how Ctrl-C ends it: one line and 130, whenever it comes."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import calib.cli
from calib.cli.application import COMMANDS
from tests.support.cases import JOB, copy_case

# Whoever runs the tests in the background has taught them to ignore Ctrl-C; a person's terminal has not.
TERMINAL = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
AT_IMPORT = """
import os, signal, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
"""
AT_OPEN = """
import os, signal, sys
def hook(event, arguments):
    if event == "open" and str(arguments[0]).endswith({name!r}):
        os.kill(os.getpid(), signal.SIGINT)
sys.addaudithook(hook)
"""
MAIN = "from calib_start import main; main()"


def start(code: str, *arguments: str, options: tuple[str, ...] = ("-W", "error")) -> tuple[int, str, str]:
    command = [sys.executable, *options, "-c", code, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("module", ["calib", "numpy", "pinocchio", "pydantic", "calib.cli.check"])
def test_interrupted_while_it_is_loaded(module: str) -> None:
    done = start(TERMINAL + AT_IMPORT.format(module=module) + MAIN, "check", "nothing.toml")
    assert done == (130, "", "Error: interrupted.\n")


def test_interrupted_while_streams_are_opened() -> None:
    at_first = "import os\nfstat = os.fstat\nos.fstat = lambda n: (os.kill(os.getpid(), signal.SIGINT), fstat(n))[1]\n"
    done = subprocess.run(
        [sys.executable, "-c", TERMINAL + at_first + MAIN], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "Error: interrupted.\n")


def test_interrupted_while_it_works(tmp_path: Path) -> None:
    job = copy_case(tmp_path)
    before = sorted(path.name for path in tmp_path.iterdir())
    code = TERMINAL + AT_OPEN.format(name="identification.csv") + MAIN
    assert start(code, "calibrate", str(job), "-o", str(tmp_path / "out")) == (130, "", "Error: interrupted.\n")
    assert sorted(path.name for path in tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    "loads",
    [
        "from calib.presentation.meshes import primitive; primitive('box', (1.0, 1.0, 1.0), (0, 0, 0))",
        "from calib.robot.mesh_files import parse_mesh; parse_mesh(b'OFF 3 1 0 0 0 0 1 0 0 0 1 0 3 0 1 2', '.off', ())",
    ],
)
def test_interrupted_while_a_library_is_loaded_that_does_without_parts_of_its_own(loads: str) -> None:
    """trimesh takes whatever comes while it loads a part for a part that is missing, and fails where it needs that."""
    code = TERMINAL + AT_IMPORT.format(module="trimesh.path")
    heard = f"try:\n    {loads}\nexcept KeyboardInterrupt:\n    import trimesh.base\n    print(trimesh.base.Path3D)\n"
    done = start(code + heard)
    assert done == (0, "<class 'trimesh.path.path.Path3D'>\n", "")


def test_interrupted_before_its_options_are_known() -> None:
    at_first = (
        "import os, typer.main\n"
        "made = typer.main.get_command\n"
        "typer.main.get_command = lambda app: (os.kill(os.getpid(), signal.SIGINT), made(app))[1]\n"
    )
    assert start(TERMINAL + at_first + MAIN, "check", "nothing.toml") == (130, "", "Error: interrupted.\n")


def test_the_package_is_the_command() -> None:
    done = subprocess.run([sys.executable, "-m", "calib", "-h"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("Usage: calib [OPTIONS] COMMAND")


def test_pressed_again_while_it_ends(tmp_path: Path) -> None:
    """While the sentence is told, for which more is loaded."""
    job = copy_case(tmp_path)
    again = AT_IMPORT.format(module="rich.console")
    code = TERMINAL + AT_OPEN.format(name="identification.csv") + again + MAIN
    assert start(code, "check", str(job), "-q") == (130, "", "Error: interrupted.\n")


def test_pressed_again_much_later_ends_it_at_once(tmp_path: Path) -> None:
    stuck = (
        "import calib.cli, os, time\ncalib.cli._say = lambda _: (os.kill(os.getpid(), signal.SIGINT), time.sleep(60))\n"
    )
    later = "import calib_start\ncalib_start._PATIENCE = -1.0\n"
    code = TERMINAL + stuck + later + AT_OPEN.format(name=JOB) + MAIN
    assert start(code, "check", str(copy_case(tmp_path))) == (130, "", "Error: interrupted.\n")


AGAIN_IN_THE_LOOP = """
import asyncio, os, signal
run, pressed = asyncio.Handle._run, []
def step(self):
    if not pressed and any(task.cancelling() for task in asyncio.all_tasks()):
        pressed.append(os.kill(os.getpid(), signal.SIGINT))
    run(self)
asyncio.Handle._run = step
"""


def test_pressed_twice_ends_what_serves_a_page(tmp_path: Path) -> None:
    """An exception out of the midst of the loop of events lost what it was about to do: it waited without end."""
    command = [sys.executable, "-W", "error", "-u", "-c", TERMINAL + AGAIN_IN_THE_LOOP + MAIN, "app"]
    places = {**os.environ, "TMPDIR": str(tmp_path)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=places) as page:
        assert page.stdout is not None
        while "Ctrl-C" not in page.stdout.readline():
            pass
        page.send_signal(signal.SIGINT)
        try:
            assert page.communicate(timeout=60)[1] == ""
        finally:
            page.kill()
    assert (page.returncode, list(tmp_path.iterdir())) == (0, [])


def test_pressed_when_all_is_done_changes_nothing() -> None:
    at_last = (
        "import os, threading\n"
        "last = threading._shutdown\n"
        "threading._shutdown = lambda: (os.kill(os.getpid(), signal.SIGINT), last())\n"
    )
    code, out, err = start(TERMINAL + at_last + MAIN, "--version")
    assert (code, err) == (0, "")
    assert out == f"{calib.__version__}\n"


def test_pressed_where_the_end_does_not_come() -> None:
    """As where some library waits for a thread of its own."""
    stuck = (
        "import os, threading, time, calib_start\n"
        "calib_start._PATIENCE = -1.0\n"
        "threading._shutdown = lambda: (os.kill(os.getpid(), signal.SIGINT), time.sleep(60))\n"
    )
    code, out, err = start(TERMINAL + stuck + MAIN, "--version")
    assert (code, out, err) == (130, f"{calib.__version__}\n", "Error: interrupted.\n")


def test_where_interrupts_are_ignored_they_stay_so(tmp_path: Path) -> None:
    ignoring = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
    for trap in (AT_IMPORT.format(module="numpy"), AT_OPEN.format(name=JOB)):
        code, out, err = start(ignoring + trap + MAIN, "check", str(copy_case(tmp_path)))
        assert (code, err) == (0, "")
        assert "no findings" in out


@pytest.mark.parametrize("collects", [True, False])
def test_what_is_loaded_is_never_looked_through(collects: bool) -> None:
    code = (
        "import gc; from calib_start import loading\n"
        f"gc.{'enable' if collects else 'disable'}()\n"
        "with loading():\n    meanwhile = gc.isenabled()\n    import calib.job.read\n"
        "found = {id(vars(module)) for module in gc.get_objects() if isinstance(module, type(gc))}\n"
        "print(meanwhile, gc.isenabled(), gc.get_freeze_count() > 10_000, id(vars(calib.job.read)) in found)"
    )
    assert start(code) == (0, f"False {collects} True False\n", "")


def test_windows_is_sent_to_wsl() -> None:
    said = (
        "calib runs on Linux and macOS. On Windows, install and run it in WSL, the Windows Subsystem for Linux "
        "(docs/windows.md).\n"
    )
    windows = "import sys; sys.platform = 'win32'\n"
    assert start(windows + MAIN, "--version") == (1, "", f"Error: {said}")
    code, out, err = start(windows + "import calib")
    assert (code, out) == (1, "")
    assert err.endswith(f"ImportError: {said}")


def test_a_python_without_locks_is_told_in_a_sentence() -> None:
    said = (
        "calib needs the locks of files of Linux and macOS, and this Python has no module fcntl; use another Python.\n"
    )
    without = "import sys; sys.modules['fcntl'] = None\n"
    assert start(without + MAIN, "check", "nothing.toml") == (1, "", f"Error: {said}")
    code, out, err = start(without + "import calib")
    assert (code, out) == (1, "")
    assert err.endswith(f"ImportError: {said}")


def test_a_python_without_locks_is_told_in_a_sentence_by_the_module_as_well(tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text("import sys\nsys.modules['fcntl'] = None\n", encoding="utf-8")
    path = os.pathsep.join((str(tmp_path), str(Path(calib.cli.__file__).parents[2])))
    done = subprocess.run(
        [sys.executable, "-m", "calib", "check"],
        capture_output=True, text=True, check=False, env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("Error: calib needs the locks of files")
    assert done.stderr.count("\n") == 1


def test_what_cannot_be_imported_elsewhere_is_a_bug_and_shown() -> None:
    code, out, err = start("import sys; sys.modules['scipy'] = None\n" + MAIN, "check", "nothing.toml")
    assert (code, out) == (1, "")
    assert "Traceback" in err


LOADED = """
import atexit, sys
from calib_start import main
def loaded():
    parts = ("scipy.linalg", "scipy.special", "scipy.sparse", "scipy.spatial", "scipy.interpolate")
    ours = ("calib.job.run", "calib.results.folder", "calib.assessment.acceptance", "calib.presentation.scene")
    print([name for name in (*parts, *ours, "logging") if name in sys.modules])
atexit.register(loaded)
sys.argv[0] = "calib"
main()
"""


@pytest.fixture(scope="module")
def folder_of_results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shipped case with its results."""
    folder = tmp_path_factory.mktemp("case")
    job = copy_case(folder)
    assert start(MAIN, "calibrate", str(job), "-o", str(folder / "out"))[0] == 0
    return folder


@pytest.mark.parametrize("command", ["uncertainty out --samples 10", "sensitivity {job}", "check {job}"])
def test_commands_that_solve_nothing_wait_for_no_scipy(folder_of_results: Path, command: str) -> None:
    arguments = command.format(job=JOB).split()
    done = subprocess.run(
        [sys.executable, "-c", LOADED, *arguments], cwd=folder_of_results, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[-1] == "[]"


COMMANDS_LOADED = """
import atexit, sys
from calib_start import main
from calib.cli.application import COMMANDS
atexit.register(lambda: print([name for name, module in COMMANDS.items() if module in sys.modules]))
sys.argv[0] = "calib"
main()
"""


def test_a_command_waits_for_no_other() -> None:
    for name in ("view", "uncertainty", "import", "five-point"):
        code, out, err = start(COMMANDS_LOADED, name, "--help")
        assert (code, err, out.splitlines()[-1]) == (0, "", str([name]))


def test_every_command_is_known_by_the_name_of_its_module() -> None:
    written = {}
    for path in Path(calib.cli.__file__).parent.glob("*.py"):
        for name in re.findall(r'^@command\("([a-z0-9-]+)"', path.read_text(encoding="utf-8"), re.MULTILINE):
            written[name] = f"calib.cli.{path.stem}"
    assert written == COMMANDS


def test_the_help_has_one_order_whatever_was_typed_before() -> None:
    typed = """
import contextlib, sys
from calib.cli import main
for arguments in (["five-point", "--help"], ["app", "--help"], ["--help"]):
    sys.argv[1:] = arguments
    with contextlib.suppress(SystemExit):
        main()
"""
    said, alone = start(typed), start(MAIN, "--help")
    assert (said[0], said[2]) == (0, "")
    assert said[1].endswith(alone[1])
    assert start(MAIN, "vieww", "--help")[2].endswith("No such command 'vieww'. Did you mean 'view'?\n")


FITS = """
import atexit, sys
from calib_start import main
ours = [f"calib.identification.{name}" for name in ("fit", "system", "error_model", "identify", "identifiability")]
atexit.register(lambda: print([name for name in (*ours, "numpy.ma") if name in sys.modules]))
sys.argv[0] = "calib"
main()
"""


def test_whoever_reads_a_machine_waits_for_nothing_that_fits(folder_of_results: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", FITS, "uncertainty", "out", "--samples", "10"],
        cwd=folder_of_results,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[-1] == "[]"


WARNING = """
import warnings, numpy as np, calib.cli
def app(prog_name):
    warnings.warn("a warning")
    np.float64(1.0) / np.float64(0.0)
    print("done")
calib.cli.app = app
calib.cli.main()
"""


def test_warnings_of_libraries_are_not_for_users() -> None:
    assert start(WARNING, options=()) == (0, "done\n", "")
    assert "a warning" in start(WARNING)[2]
    assert "divide by zero" in start(WARNING, options=("-W", "default"))[2]


@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_with_streams_closed(tmp_path: Path, closed: str) -> None:
    job, out = copy_case(tmp_path), tmp_path / "out"
    command = f'exec "$0" -W error -c "{MAIN}" calibrate "$1" -o "$2" {closed}'
    done = subprocess.run(
        ["sh", "-c", command, sys.executable, str(job), str(out)], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert ("Results are in" in done.stdout) == (">" not in closed.replace("2>", ""))
    assert b"Results are in" not in b"".join(path.read_bytes() for path in out.iterdir())


def test_an_error_with_streams_closed() -> None:
    command = f'exec "$0" -W error -c "{MAIN}" check nothing.toml 2>&-'
    done = subprocess.run(["sh", "-c", command, sys.executable], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (1, "", "")


@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_processes_of_a_command_have_the_streams_that_were_closed(closed: str) -> None:
    child = "import os; [os.fstat(number) for number in range(3)]"
    code = (
        "import subprocess, sys; from calib_start import _prepare; _prepare(); "
        f"sys.exit(subprocess.call([sys.executable, '-c', '{child}']))"
    )
    done = subprocess.run(["sh", "-c", f'exec "$0" -c "$1" {closed}', sys.executable, code], check=False)
    assert done.returncode == 0
