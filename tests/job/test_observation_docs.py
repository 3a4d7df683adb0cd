"""The examples of docs/observations.md are run, on tables of a simulated UR10."""

import csv
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from scipy.spatial.transform import Rotation

from calib.job.inputs import load
from calib.job.run import run
from tests.support import machines, touching
from tests.support.machines import Array

DOCS = (Path(__file__).resolve().parents[2] / "docs" / "observations.md").read_text(encoding="utf-8")
HEADER, *EXAMPLES = re.findall(r"```toml\n(.*?)```", DOCS, re.DOTALL)
NOISE = 3e-5


class Written(touching.Lab):
    """A lab whose measurements are columns of a table."""

    def read(self, q: Array, observes: str, offset: str | None = None, **more: object) -> Any:
        return self.columns(q, **more)


def poses(at: Written, n: int) -> Any:
    """Positions, and turns that are as sharp as positions are."""
    q = at.draw(n)
    seen = at.machine.see(q)
    seen[:, :3, 3] += at.scatter(n, 3)
    seen[:, :3, :3] @= Rotation.from_rotvec(at.scatter(n, 3)).as_matrix()
    return machines.table(at.machine.arm, q, seen, "pose")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = touching.lab(8, noise=NOISE)
    at = Written(made.machine, made.robot, made.rng, made.noise)
    folder = tmp_path_factory.mktemp("observations")
    tables = {
        "sockets": at.sockets(25),
        "bar": at.distances(60, 0.0123),
        "gauges": at.pairs(60),
        "planes": at.planes(30, tuple(touching.NORMALS)),
        "ball": at.sphere(60),
        "ball_of_unknown_size": at.sphere(60, "ball"),
        "dial": at.indicator(60),
        "tracker": at.positions(30),
        "poses": poses(at, 30),
        "left": at.positions(30),
    }
    second = Written(replace(made.machine, base=machines.anywhere(made.rng)), made.robot, made.rng, made.noise)
    tables["right"] = second.positions(30)
    for name, columns in tables.items():
        with (folder / f"{name}.csv").open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(columns)
            writer.writerows(zip(*columns.values(), strict=True))
    return folder


def test_there_is_an_example_for_every_kind() -> None:
    assert "[robot]" in HEADER
    said = set(re.findall(r'observes = "(\w+)"', "".join(EXAMPLES)))
    assert said == {"position", "pose", "socket", "distance", "pair_distance", "plane", "sphere", "indicator"}


@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_example(folder: Path, number: int) -> None:
    path = folder / f"example_{number}.toml"
    turned = 'tool = "pose"\n' if 'observes = "pose"' in EXAMPLES[number] else ""
    path.write_text(HEADER + turned + EXAMPLES[number], encoding="utf-8")
    outcome = run(load(path))
    assert not outcome.doubts
    for quantity, after in outcome.metrics["identification"]["after"].items():
        assert after.rms < 2.0 * NOISE
        assert after.rms < 0.1 * outcome.metrics["identification"]["before"][quantity].rms
