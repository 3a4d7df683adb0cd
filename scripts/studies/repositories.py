"""Data of others in their repositories, and arms by their data sheets."""

import subprocess
from collections.abc import Sequence
from pathlib import Path


def stored(repository: Path, name: str) -> bytes:
    """A file of the repository, a folder or its git directory."""
    if (repository / name).is_file():
        return (repository / name).read_bytes()
    git = ["git", f"--git-dir={repository}", "show", f"HEAD:{name}"]
    return subprocess.run(git, check=True, stdout=subprocess.PIPE).stdout


def urdf_of(name: str, axes: Sequence[tuple[tuple[float, ...], tuple[int, ...]]]) -> str:
    """An arm whose frames are parallel: of each axis where it is in the frame before, in m, and its direction."""
    links = "".join(f'<link name="link_{k}"/>' for k in range(len(axes) + 1))
    joints = "".join(
        f'<joint name="joint_{k + 1}" type="continuous"><parent link="link_{k}"/><child link="link_{k + 1}"/>'
        f'<origin xyz="{" ".join(map(str, at))}"/><axis xyz="{" ".join(map(str, axis))}"/></joint>'
        for k, (at, axis) in enumerate(axes)
    )
    return f'<robot name="{name}">{links}{joints}</robot>'
