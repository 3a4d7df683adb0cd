"""Time and memory of a whole job of streams of very many rows, reports and all: a line for docs/clocks.md.

    python scripts/benchmarks/long_stream.py [ROWS] [--folder FOLDER]

A UR10 at 149 Hz and its tracker at 60 Hz, a quarter of the rows held out (scripts/simulate/streams.py); a million rows,
4.6 hours, where no number is given. A folder keeps the streams and the results; streams that are there are used again.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from scripts.simulate.streams import write_case

ROOT = Path(__file__).resolve().parents[2]
_CALIBRATE = "from calib_start import main; main()"


def measured(folder: Path) -> tuple[float, float]:
    """Processor time in s and the largest resident memory in MB of ``calib calibrate`` on a job, in its own process."""
    command = ["calibrate", str(folder / "calibration.toml"), "-o", str(folder / "out"), "--quiet"]
    # The installed package may be another one than that of this script.
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    process = subprocess.Popen([sys.executable, "-P", "-c", _CALIBRATE, *command], cwd=ROOT, env=environment)
    _, status, used = os.wait4(process.pid, 0)
    if os.waitstatus_to_exitcode(status) not in (0, 3):
        sys.exit(f"calib calibrate ended with exit code {os.waitstatus_to_exitcode(status)}.")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1e3


def main() -> None:
    """Simulate, calibrate, and print what it took."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rows", type=int, nargs="?", default=1_000_000)
    parser.add_argument("--folder", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = given.folder or Path(scratch)
        if not (folder / "calibration.toml").exists():
            # Of 60 samples a second, 2 % are lost.
            write_case(folder, 1, given.rows / (0.98 * 60.0) + 2.0)
        size = sum(path.stat().st_size for path in folder.glob("*.csv")) / 1e6
        seconds, memory = measured(folder)
    print("| rows | hours | files MB | CPU s | memory MB |\n|--:|--:|--:|--:|--:|")
    print(f"| {given.rows:,} | {given.rows / (0.98 * 216e3):.1f} | {size:.0f} | {seconds:.0f} | {memory:.0f} |")


if __name__ == "__main__":
    main()
