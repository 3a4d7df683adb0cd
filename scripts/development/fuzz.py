"""Fuzz the readers, guided by coverage: any bytes give a value or one of our errors, in bounded time and memory.

    python scripts/development/fuzz.py                            every reader for 600 s, one after the other
    python scripts/development/fuzz.py --reader urdf --seconds 60

Needs the group ``fuzz`` of the dependencies (atheris, which is libFuzzer for Python). A reader runs in a process of its
own with a limit on memory, and every input has a limit on time. An input that is read badly is made as small as it gets
and stored in ``tests/corpus/READER/``, where a test reads it from then on.
"""

import argparse
import hashlib
import json
import os
import random
import re
import resource
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

ROOT = Path(__file__).resolve().parents[2]
CORPUS = ROOT / "tests" / "corpus"
MEMORY = 4_000_000_000  # of addresses; the libraries take the first of them
RESIDENT_MB = 2_000
_MOST_TRIALS = 2_000
# The fuzzer looks at the clock, which runs on while a busy machine does something else.
_BUSY = 20


def main() -> int:
    """Fuzz what is asked for, print what came of it, and return 1 where something was found."""
    if len(sys.argv) > 2 and sys.argv[1] == "--child":
        return _fuzz(sys.argv[2], Path(sys.argv[3]), sys.argv[4:])
    from scripts.development.fuzz_readers import READERS  # noqa: PLC0415

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--reader", choices=sorted(READERS), action="append", help="default: every one")
    parser.add_argument("--seconds", type=int, default=600, help="of processor time, for each reader")
    parser.add_argument("--corpus", type=Path, help="a folder that keeps what was reached, for the next time")
    asked = parser.parse_args()
    found = 0
    with tempfile.TemporaryDirectory() as kept:
        for name in asked.reader or READERS:
            found += _supervise(name, asked.seconds, (asked.corpus or Path(kept)) / name)
    return int(found > 0)


def _supervise(name: str, seconds: int, corpus: Path) -> int:
    """Fuzz one reader in processes of its own until its time is over; return how many faults were found."""
    from scripts.development.fuzz_readers import READERS  # noqa: PLC0415

    corpus.mkdir(parents=True, exist_ok=True)
    for seed in READERS[name].seeds():
        (corpus / hashlib.sha256(seed).hexdigest()[:16]).write_bytes(seed)
    words = corpus.parent / f"{name}.dict"
    words.write_text(
        "".join(f'"{_escaped(word)}"\n' for word in READERS[name].words if len(word) < 60), encoding="ascii"
    )
    faults, runs, begun = 0, 0, _spent()
    paths = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    threads = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory() as folder:
        spilled = Path(folder)
        # The fuzzer counts by the clock, and begins again while processor time is left.
        while (left := int(seconds - _spent() + begun)) > 0:
            options = [
                f"-max_total_time={left}",
                f"-timeout={READERS[name].seconds * _BUSY}",
                f"-report_slow_units={READERS[name].seconds * _BUSY}",
                f"-rss_limit_mb={RESIDENT_MB}",
            ]
            options += [f"-max_len={READERS[name].largest}", f"-dict={words}", f"-artifact_prefix={folder}/"]
            options += ["-print_final_stats=1", "-verbosity=0", str(corpus)]
            child = subprocess.run(
                [sys.executable, __file__, "--child", name, folder, *options],
                cwd=ROOT,
                env=os.environ | {"PYTHONPATH": paths} | threads,
                capture_output=True,
                text=True,
                errors="replace",
                check=False,
            )
            executed = re.findall(r"number_of_executed_units: *(\d+)", child.stderr)
            runs += int(executed[-1]) if executed else 0
            ended = [path for path in spilled.iterdir() if path.suffix != ".fault"]
            for path in ended:
                print(f"{name}: {path.name.partition('-')[0]}: {_store(name, path.read_bytes())}")
                faults += 1
                path.unlink()
            if child.returncode and not ended:
                print(child.stderr[-3000:])
                raise SystemExit(f"{name}: the fuzzer itself ended with {child.returncode}.")
        for path in sorted(spilled.glob("*.fault")):
            what = json.loads(path.read_text(encoding="utf-8"))
            data = bytes.fromhex(what["data"])
            small = minimised(data, lambda data, what=what: _fault(name, data) == what["fault"])
            print(f"{name}: {what['fault']}: {_store(name, small)}")
            faults += 1
    print(f"{name}: {runs} inputs in {seconds} s, {runs / seconds:.0f} a second; {faults} faults", flush=True)
    return faults


def _spent() -> float:
    """Return the processor time (s) of all processes that were started and have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _escaped(word: bytes) -> str:
    return "".join(f"\\x{byte:02x}" for byte in word)


def _store(name: str, data: bytes) -> Path:
    path = CORPUS / name / hashlib.sha256(data).hexdigest()[:12]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path.relative_to(ROOT)


def _fault(name: str, data: bytes) -> str | None:
    """Return what is wrong with the reading of an input, and where; None where nothing is."""
    from scripts.development.fuzz_readers import READERS, judge  # noqa: PLC0415

    try:
        judge(READERS[name].read, data)
    except Exception as e:  # noqa: BLE001 - whatever escapes is what is looked for
        own = [frame for frame in traceback.extract_tb(e.__traceback__) if str(ROOT) in frame.filename]
        at = own[-1]
        return f"{type(e).__name__} at {Path(at.filename).relative_to(ROOT)}:{at.lineno} ({str(e)[:80]!r})"[:200]
    return None


def minimised(data: bytes, bad: Callable[[bytes], bool]) -> bytes:
    """Return a part of ``data`` that is still ``bad`` and loses it with any piece taken away, as far as trials last."""
    trials, size = 0, max(len(data) // 2, 1)
    while size and trials < _MOST_TRIALS:
        start, shorter = 0, False
        while start < len(data) and trials < _MOST_TRIALS:
            less = data[:start] + data[start + size :]
            trials += 1
            if bad(less):
                data, shorter = less, True
            else:
                start += size
        if not shorter or size > len(data):
            size //= 2
    return data


def _changed(name: str) -> Callable[[bytes, int, int], bytes]:
    """Return a way to change inputs: as atheris does, and as a damaged or hostile file is changed, in turn."""
    import atheris  # noqa: PLC0415

    from scripts.development.fuzz_readers import READERS, mutated  # noqa: PLC0415

    def changed(data: bytes, most: int, seed: int) -> bytes:
        if seed % 2:
            return bytes(atheris.Mutate(data, most))
        return mutated(data, READERS[name].words, random.Random(seed))[:most]

    return changed


def _fuzz(name: str, folder: Path, options: list[str]) -> int:
    """Be the process that fuzzes: note every new kind of fault, and go on."""
    import atheris  # noqa: PLC0415

    with atheris.instrument_imports(include=["calib", "tomllib", "trimesh.exchange", "collada", "rosbags"]):
        from scripts.development.fuzz_readers import READERS  # noqa: PLC0415
    # What the shipped files need is made and loaded before memory is limited and time is counted.
    for seed in READERS[name].seeds():
        _fault(name, seed)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))

    def one(data: bytes) -> None:
        begun = time.process_time()
        fault = _fault(name, data)
        if fault is None and time.process_time() - begun > READERS[name].seconds:
            fault = "takes too long"
        # One of each kind: lines tell them apart, words often hold the input.
        kind = None if fault is None else fault.partition(" (")[0]
        path = folder / f"{hashlib.sha256(str(kind).encode()).hexdigest()[:12]}.fault"
        if fault is not None and not path.exists():
            path.write_text(json.dumps({"fault": fault, "data": data.hex()}), encoding="utf-8")

    atheris.Setup([sys.argv[0], *options], one, custom_mutator=_changed(name))
    atheris.Fuzz()
    return 0


if __name__ == "__main__":
    sys.exit(main())
