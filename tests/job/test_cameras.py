"""Three cameras and three boards in one job: on the flange, on the forearm, beside the arm; every lens free."""

import json
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

pytest.importorskip("cv2")

from scripts.simulate import photographs as simulation
from tests.support import cameras, machines
from tests.support.cases import run, write_table

Array = NDArray[np.float64]
SIGMA = 0.05
FOREARM = "forearm_link"
# By camera: how it is mounted, as the job says it, and its lens.
LENSES = {
    "wrist": simulation.Lens(),
    "elbow": simulation.Lens(fx=1100.0, fy=1104.0, cx=630.0, cy=352.0, k=(-0.11, 0.12, -5e-4, 3e-4, -0.02)),
    "beside": simulation.Lens(fx=990.0, fy=987.0, cx=648.0, cy=371.0, k=(-0.03, 0.05, 2e-4, 6e-4, 0.01)),
}
ON = {"wrist": '"tip"', "elbow": f'{{ link = "{FOREARM}" }}', "beside": '"floor"'}
# By board: its print, and by how much it is too large.
SHEETS = {
    "table": simulation.Sheet(scale=0.004),
    "wall": simulation.Sheet(squares=(6, 5), square=0.04, marker=0.028, scale=-0.003),
    "hand": simulation.Sheet(squares=(6, 4), square=0.035, marker=0.025, scale=0.002),
}
# Which camera sees which board: in each table one of them is on the flange.
TABLES = {"a": ("wrist", "table"), "b": ("wrist", "wall"), "c": ("elbow", "hand"), "d": ("beside", "hand")}
# About what readings each table is photographed.
HOME = {
    "a": np.array([0.0, -1.6, 1.6, -1.5, -1.5, 0.3]),
    "b": np.array([0.9, -1.4, 1.3, -0.4, -1.4, -0.4]),
    "c": np.array([-0.5, -1.2, 1.5, -0.9, 1.0, 0.6]),
    "d": np.array([0.4, -1.8, 1.9, -1.2, -1.0, 1.8]),
}
JOB = """
schema = 1
[robot]
urdf = "example:ur_description/urdf/ur5_robot.urdf"
tip = "tool0"
[error_model]
offsets = "all"
placements = "all"
tool = "pose"
[error_model.prior]
length = "1 mm"
angle = "1 mrad"
"""


@dataclass
class Cell:
    """What is where: cameras and boards on the flange or forearm, and in the base."""

    arm: simulation.Arm
    at: dict[str, Array]

    def before(self, table: str, q: Array) -> Array:
        """The middle of a table's board in its camera (4, 4)."""
        camera, board = TABLES[table]
        tip = self.arm.tip(q)
        seat = {"wrist": tip, "elbow": self.arm.tip(q, link=FOREARM), "beside": np.eye(4)}[camera] @ self.at[camera]
        return np.linalg.inv(seat) @ (tip if board == "hand" else np.eye(4)) @ self.at[board]

    def seen(self, table: str, q: Array) -> Array:
        """The pixels (m, 2) of a photograph."""
        camera, board = TABLES[table]
        sheet, T = SHEETS[board], self.before(table, q)
        return LENSES[camera].see(sheet.place(sheet.corners()) @ T[:3, :3].T + T[:3, 3])

    def draw(self, table: str, rng: np.random.Generator, n: int) -> Array:
        """Readings (n, 6) about a table's own at which its board is seen whole, and from the front."""
        found: list[Array] = []
        while len(found) < n:
            q = HOME[table] + rng.normal(scale=0.4, size=6)
            T = self.before(table, q)
            if 0.15 < T[2, 3] < 0.9 and (T[:3, 2] @ T[:3, 3]) / np.linalg.norm(T[:3, 3]) > 0.6:
                uv = self.seen(table, q)
                if np.all((uv > 15) & (uv < np.array(LENSES["wrist"].size) - 15)):
                    found.append(q)
        return np.array(found)


def made(rng: np.random.Generator) -> Cell:
    """An arm with errors within the priors, and cameras that have boards before them at the readings of HOME."""
    cell = Cell(simulation.Arm(rng, 0.5e-3, 0.5e-3, 0.5e-3), {})
    turn = Rotation.from_euler("xyz", (5.0, 95.0, 20.0), degrees=True).as_rotvec()
    cell.at |= {
        "hand": simulation.pose((-0.04, 0.01, 0.06), turn),
        "wrist": simulation.pose((0.0, -0.065, 0.04), 0.05 * np.ones(3)),
    }
    for table, (camera, board) in TABLES.items():
        ahead = simulation.pose((*rng.normal(scale=0.01, size=2), 0.42), rng.normal(scale=0.3, size=3))
        tip = cell.arm.tip(HOME[table])
        if camera == "wrist":
            cell.at[board] = tip @ cell.at[camera] @ ahead
        else:
            seat = cell.arm.tip(HOME[table], link=FOREARM) if camera == "elbow" else np.eye(4)
            cell.at[camera] = np.linalg.inv(seat) @ tip @ cell.at[board] @ np.linalg.inv(ahead)
    return cell


def written(folder: Path, cell: Cell, rng: np.random.Generator) -> Path:
    """Write boards, tables and a job of them."""
    text = JOB
    for camera, place in ON.items():
        text += f'[instruments.{camera}]\nkind = "camera"\ncamera_on = {place}\nlens = "free"\n'
        text += f'size = [1280, 720]\nsigma = "{SIGMA} px"\n'
    for board, sheet in SHEETS.items():
        (folder / f"{board}.toml").write_text(
            f'kind = "charuco"\nsquares = {list(sheet.squares)}\nsquare = "{sheet.square} m"\nshape = "flat"\n'
            f'marker = "{sheet.marker} m"\ndictionary = "{sheet.dictionary}"\n',
            encoding="utf-8",
        )
    for table, (camera, board) in TABLES.items():
        q, drawn = cell.draw(table, rng, 12), SHEETS[board].corners()
        uv = np.concatenate([cell.seen(table, one) for one in q])
        uv += rng.normal(scale=SIGMA, size=uv.shape)
        many, places = np.repeat(q, len(drawn), axis=0), np.tile(drawn, (len(q), 1))
        columns = {f"{name} [rad]": many[:, k] for k, name in enumerate(cell.arm.names)}
        columns |= {"u [px]": uv[:, 0], "v [px]": uv[:, 1]}
        columns |= {"board_x [m]": places[:, 0], "board_y [m]": places[:, 1]}
        write_table(folder / f"{table}.csv", columns)
        tool, target = (camera, board) if camera == "wrist" else (board, camera)
        text += (
            f'[[measurements]]\nfile = "{table}.csv"\nobserves = "pixels"\ninstrument = "{camera}"\n'
            f'board = "{board}.toml"\ntool = "{tool}"\ntargets = {{ target = "{target}" }}\nhold_out = 0.25\n'
        )
    job = folder / "job.toml"
    job.write_text(text, encoding="utf-8")
    return job


def test_cameras_and_boards_of_one_job(tmp_path: Path) -> None:
    """Every lens, every print's size and every place is within its interval, and held-out pixels are foretold.

    The scale of all is not seen, and known by the priors of arm and prints alone: intervals count that.
    """
    rng = np.random.default_rng(7)
    cell = made(rng)
    out = tmp_path / "out"
    said = run("calibrate", written(tmp_path, cell, rng), "-o", out)
    assert (said.code, said.err) == (0, "")
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    # One arm, one camera on it and a board are 30 without a base; each further one is 6; sizes of prints, less that of
    # all; and nine numbers of each lens.
    assert result["rank"] == 30 + 4 * 6 + 2 + 3 * 9
    assert result["metrics"]["validation"]["after"]["pixels"]["rms"] < 1.2 * np.sqrt(2.0) * SIGMA

    told = {one["name"]: (one["value"], one["sigma"]) for one in result["parameters"]}
    true = {f"board.{name}.scale": sheet.scale for name, sheet in SHEETS.items()}
    for name, lens in LENSES.items():
        numbers = dict(
            zip(
                ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"),
                (lens.fx, lens.fy, lens.cx, lens.cy, *lens.k),
                strict=True,
            )
        )
        true |= {f"lens.{name}.{key}": value for key, value in numbers.items()}
    far = {name: (told[name][0] - value) / told[name][1] for name, value in true.items()}
    assert max(map(abs, far.values())) < 4.0, far

    seats = result["cameras"]
    assert {name: one["on"] for name, one in seats.items()} == {
        "wrist": "tool0",
        "elbow": FOREARM,
        "beside": "world",
    }
    for name, one in seats.items():
        w, *xyz = one["pose"]["quaternion"]
        turn = Rotation.from_quat([*xyz, w]).as_rotvec()
        off = np.linalg.inv(cell.at[name]) @ simulation.pose(np.array(one["pose"]["position"]), turn)
        assert np.linalg.norm(off[:3, 3]) < 5e-3, name
        assert Rotation.from_matrix(off[:3, :3]).magnitude() < 5e-3, name
        assert one["lens"]["fx"] == pytest.approx(LENSES[name].fx, rel=2e-3)
        assert one["rms"]["px"] < 1.2 * np.sqrt(2.0) * SIGMA
    report = (out / "report.html").read_text(encoding="utf-8")
    assert all(f"{name} in {one['on']}" in report for name, one in seats.items())
    scene = (out / "scene.html").read_text(encoding="utf-8")
    # Each has its name once: what is on the tip is a tool.
    labels = dict(json.loads(re.search(r'"labels":(\[\[.*?\]\])', scene)[1]))
    beside = {f"robot/{FOREARM}/cameras/elbow", "marks/cameras/beside", "marks/boards/table", "marks/boards/wall"}
    assert beside | {"frames/tip/tools/wrist", "frames/tip/tools/hand"} <= set(labels)
    assert sorted(labels.values()) == sorted({*labels.values()})
    # The errors in it are those of all pixels, where the marks are.
    assert '"judged":true' in scene
    assert "errors are across the line of sight" in scene


@pytest.mark.parametrize(("fx", "view"), [("1.1", "180"), ("999000", "0.0734")])
def test_focal_lengths_in_another_unit_are_refused(fx: str, view: str, tmp_path: Path) -> None:
    """Such a lens put marks behind the camera, and the sentence asked for all but the lens."""
    rng = np.random.default_rng(2)
    job = written(tmp_path, made(rng), rng)
    lens = f'lens = "free"\nfx = "{fx} px"\nfy = "1100 px"\ncx = "640 px"\ncy = "360 px"\n'
    job.write_text(job.read_text(encoding="utf-8").replace('lens = "free"\n', lens, 1), encoding="utf-8")
    said = run("check", job)
    assert said.code == 1
    why = f"instruments.{next(iter(ON))}.fx: {fx} px would see {view} deg in images of 1280 px; allowed are 0.1 to 100 "
    assert why in " ".join(said.err.split())


@pytest.mark.parametrize(
    ("camera_on", "what", "answer"),
    [("floor", "target", 'targets = { target = "right" }'), ("tip", "tool", 'tool = "right"')],
)
def test_two_cameras_at_one_place_are_told(camera_on: str, what: str, answer: str, tmp_path: Path) -> None:
    """Jobs of one camera each, put together: all of it contradicts itself, and nothing said why."""
    rng = np.random.default_rng(3)
    arm = machines.arm("example:ur_description/urdf/ur5_robot.urdf", "tool0")
    left = cameras.scene(rng, arm, camera_on)
    aside = machines.pose((0.1, 0.0, 0.02), (0.0, 0.1, 0.0))
    right = replace(left, **{what: getattr(left, what) @ aside})
    readings = left.draw(rng, 60)
    readings = readings[right.visible(readings)][:12]
    text = "\n".join(line for line in JOB.splitlines() if "all" not in line).replace(
        "[error_model.prior]", 'base = "fixed"'
    )
    text = "\n".join(line for line in text.splitlines() if "1 m" not in line)
    for name, scene in (("left", left), ("right", right)):
        write_table(tmp_path / f"{name}.csv", scene.columns(readings))
        c = scene.camera
        numbers = "".join(f'{key} = "{getattr(c, key)} px"\n' for key in ("fx", "fy", "cx", "cy"))
        numbers += "".join(f"{key} = {getattr(c, key)}\n" for key in ("k1", "k2", "p1", "p2", "k3"))
        text += f'\n[instruments.{name}]\nkind = "camera"\ncamera_on = "{camera_on}"\nsigma = "0.1 px"\n{numbers}'
        text += f'[[measurements]]\nfile = "{name}.csv"\nobserves = "pixels"\ninstrument = "{name}"\n'
    job = tmp_path / "job.toml"
    job.write_text(text, encoding="utf-8")
    said = run("check", job)
    assert f"cameras 'left', 'right' are at one place, the {what} '{what}'" in " ".join(said.out.split())
    assert f"write {answer} for" in " ".join(said.out.split())
    job.write_text(f"{text}{answer}\n", encoding="utf-8")
    again = run("check", job)
    assert (again.code, "at one place" in again.out) == (0, False)
