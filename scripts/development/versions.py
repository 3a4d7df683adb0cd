"""Runs the whole suite on the lowest and on the newest versions of the dependencies that pyproject.toml allows.

    python scripts/development/versions.py [lowest] [newest] [--folder out/versions] [-- arguments of pytest]

Every set of versions has an environment of its own, made by uv with this Python. Lowest: every direct dependency at
its lower bound, what these need as new as it gets. Where bounds exclude each other, those left above their bound are
held at it in a further environment.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
KINDS = ("lowest", "newest")
BOUND = re.compile(r"([A-Za-z0-9_.-]+)>=([0-9.]+)")


def bounds() -> dict[str, str]:
    """The lower bounds of all direct dependencies, by name."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    found = [BOUND.match(line) for line in (*project["dependencies"], *project["optional-dependencies"]["dev"])]
    return {match[1]: match[2] for match in found if match is not None}


def release(version: str) -> str:
    """A version without zeros at its end: 2.0 and 2.0.0 are one."""
    return re.sub(r"(\.0)+$", "", version)


class Environment:
    """A set of versions in a folder."""

    def __init__(self, uv: Path, folder: Path) -> None:
        self._uv, self._folder, self.python = uv, folder, folder / "bin" / "python"

    def make(self, *options: str) -> None:
        subprocess.run([self._uv, "venv", "--quiet", "--clear", "--python", sys.executable, self._folder], check=True)
        install = [self._uv, "pip", "install", "--quiet", "--python", self.python, *options, "-e", ".[dev]"]
        subprocess.run(install, check=True, cwd=ROOT)

    def versions(self) -> dict[str, str]:
        listed = [self._uv, "pip", "list", "--format", "json", "--python", self.python]
        found = subprocess.run(listed, check=True, capture_output=True, text=True).stdout
        return {package["name"]: package["version"] for package in json.loads(found)}

    def test(self, arguments: Sequence[str]) -> int:
        command = [self.python, "-m", "pytest", "-q", *(arguments or ("-n", "auto"))]
        return subprocess.run(command, cwd=ROOT, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"}, check=False).returncode


def above(versions: dict[str, str]) -> dict[str, str]:
    """The bounds of those dependencies that are newer than theirs."""
    return {name: bound for name, bound in bounds().items() if release(versions[name.lower()]) != release(bound)}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", choices=[*KINDS, []], help="both when none is named")
    parser.add_argument("--folder", type=Path, default=ROOT / "out" / "versions")
    own = sys.argv[1 : sys.argv.index("--")] if "--" in sys.argv else sys.argv[1:]
    arguments, pytest = parser.parse_args(own), sys.argv[len(own) + 2 :]
    folder = arguments.folder.resolve()
    subprocess.run([sys.executable, "-m", "venv", folder / "uv"], check=True)
    subprocess.run([folder / "uv" / "bin" / "python", "-m", "pip", "install", "--quiet", "uv>=0.5"], check=True)
    uv = folder / "uv" / "bin" / "uv"
    failed = []

    def run(name: str, *options: str) -> dict[str, str]:
        environment = Environment(uv, folder / name)
        environment.make(*options)
        versions = environment.versions()
        print(f"{name}: " + ", ".join(f"{direct} {versions[direct.lower()]}" for direct in bounds()), flush=True)
        if environment.test(pytest):
            failed.append(name)
        return versions

    kinds = arguments.kinds or KINDS
    if "lowest" in kinds:
        left = above(run("lowest", "--resolution", "lowest-direct"))
        if left:
            held = folder / "held.txt"
            held.write_text("".join(f"{name}=={bound}\n" for name, bound in left.items()), encoding="utf-8")
            run("lowest-" + "-".join(left), "--resolution", "lowest-direct", "--constraint", str(held))
    if "newest" in kinds:
        run("newest", "--resolution", "highest")
    print(f"failed: {', '.join(failed)}" if failed else "all passed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
