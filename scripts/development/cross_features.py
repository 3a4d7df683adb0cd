"""Every two features of a job together, through every command: all rows, all steps, twins included.

    python scripts/development/cross_features.py            # some twenty minutes
    python scripts/development/cross_features.py 3 17       # rows by their numbers

The test suite takes the same rows without twins through some of the steps (tests/crossed).
"""

import functools
import sys
import tempfile
import traceback
import warnings
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from calib.assessment import choice
from tests.crossed.rows import rows, told
from tests.crossed.simulate import build
from tests.crossed.walk import walk


def main(numbers: list[int]) -> int:
    """Walk rows, all when there are no numbers, and return how many failed."""
    warnings.simplefilter("error")
    choice.candidates = functools.partial(choice.candidates, options={"harmonic_orders": (1,)})  # type: ignore[assignment]
    every, failed = rows(twins=True), 0
    for number in numbers or range(len(every)):
        with tempfile.TemporaryDirectory() as folder:
            try:
                walk(build(every[number], Path(folder) / "job", seed=number))
                print(f"{number} of {len(every)}: well", flush=True)
            except Exception as error:  # noqa: BLE001 - a script that finds faults goes on to the next one
                failed += 1
                print(
                    f"{number} of {len(every)}: {told(every[number])}\n{_where(error)}{traceback.format_exc(limit=-4)}"
                )
    print(f"{failed} failed")
    return failed


def _where(error: Exception) -> str:
    """Return the step of the walk that failed, which the end of a long traceback does not show."""
    frames = traceback.extract_tb(error.__traceback__)
    return "".join(f"in {frame.name}, line {frame.lineno}\n" for frame in frames if frame.filename.endswith("walk.py"))


if __name__ == "__main__":
    sys.exit(min(main([int(word) for word in sys.argv[1:]]), 1))
