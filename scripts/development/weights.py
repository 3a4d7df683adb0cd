"""What an install brings, by weight: every distribution that the project needs, and what is an extra.

python scripts/development/weights.py           # a Markdown table of the environment that runs this
"""

import re
from importlib import metadata
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def size(name: str) -> float:
    """Return the size in MB of the files of an installed distribution."""
    files = metadata.distribution(name).files or []
    paths = (Path(str(file.locate())) for file in files)
    return sum(path.stat().st_size for path in paths if path.is_file()) / 1e6


def needs(name: str) -> set[str]:
    """Return the names of what an installed distribution needs, without extras."""
    found = set()
    for requirement in metadata.requires(name) or []:
        plain, _, marker = requirement.partition(";")
        if "extra" not in marker:
            found.add(canonical(re.split(r"[\s<>=!~\[(]", plain.strip(), maxsplit=1)[0]))
    return found


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def main() -> None:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    block = re.search(r"^dependencies = \[(.*?)^\]", text, re.DOTALL | re.MULTILINE)
    assert block is not None
    own = [canonical(re.split(r"[<>=!~\[]", line)[0]) for line in re.findall(r'"([^"]+)"', block[1])]
    seen: dict[str, set[str]] = {}
    for first in own:
        left = [first]
        while left:
            name = left.pop()
            if first in seen.setdefault(name, set()):
                continue
            seen[name].add(first)
            try:
                left += sorted(needs(name))
            except metadata.PackageNotFoundError:  # for another system or Python
                continue
    weights = {}
    for name in seen:
        try:
            weights[name] = size(name)
        except metadata.PackageNotFoundError:
            continue
    print(f"{len(weights)} distributions, {sum(weights.values()):.0f} MB.\n")
    print("| distribution | MB | through |\n|---|--:|---|")
    for name, weight in sorted(weights.items(), key=lambda item: -item[1])[:20]:
        print(f"| {name} | {weight:.0f} | {', '.join(sorted(seen[name])[:4])} |")


if __name__ == "__main__":
    main()
