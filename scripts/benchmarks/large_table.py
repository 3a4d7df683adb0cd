"""Time and memory of reading large tables, each in a process of its own: lines for docs/fuzzing.md.

python scripts/benchmarks/large_table.py              1, 3 and 10 million rows
python scripts/benchmarks/large_table.py 200000       so many
"""

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
_COLUMNS = 9


def main() -> None:
    """Write tables, read each in a new process, and print what it took."""
    if len(sys.argv) > 2 and sys.argv[1] == "--child":
        from calib.measurement.table import read_table  # noqa: PLC0415

        empty = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        start = time.process_time()
        rows = len(read_table(sys.argv[2]))
        taken = time.process_time() - start
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        print(f"| {rows:,} | {Path(sys.argv[2]).stat().st_size / 1e6:.0f} | {taken:.1f} | {(peak - empty) / 1e3:.0f} |")
        return
    print("| rows | file MB | CPU s | memory MB |\n|--:|--:|--:|--:|", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "table.csv"
        for rows in map(int, sys.argv[1:] or ("1000000", "3000000", "10000000")):
            row = ",".join(f"{-90.123456789 + 7.7 * k:.9g}" for k in range(_COLUMNS)) + "\n"
            with path.open("w", encoding="utf-8") as file:
                file.write(",".join(f"c{k} [mm]" for k in range(_COLUMNS)) + "\n")
                for _ in range(rows // 1000):
                    file.write(row * 1000)
            subprocess.run([sys.executable, __file__, "--child", str(path)], check=True, cwd=ROOT)


if __name__ == "__main__":
    main()
