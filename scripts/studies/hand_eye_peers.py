"""OpenCV's five hand-eye methods beside ours, on the same photographs: a table of docs/cameras.md.

    python scripts/studies/hand_eye_peers.py FOLDER --opencv PYTHON [--seed 3] [--markdown docs/cameras.md]

Photographs are rendered into FOLDER by scripts/simulate/photographs.py. ``PYTHON``: of an environment with numpy and
opencv-python-headless below 5, in which scripts/benchmarks/peers/run_opencv.py finds corners, the lens and the camera
on the flange by OpenCV alone. Flange poses are those of the nominal URDF at the readings, as a controller states them
that does not know its arm's errors. A third of the photographs is held out; there, pixels are compared with where
corners truly are. The camera's place on the flange is compared with the true one.
"""

import argparse
import csv
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import calib
from calib.foundations.linear import one_thread
from calib.job.read import read_board
from calib.measurement.boards import places_of
from scripts.simulate import photographs as simulation
from scripts.studies.blame import write

ROOT = Path(__file__).resolve().parents[2]
RUNNER = ROOT / "scripts" / "benchmarks" / "peers" / "run_opencv.py"
BEGIN, END = "<!-- peers: by scripts/studies/hand_eye_peers.py -->", "<!-- peers: end -->"
IMAGES = 24
Array = simulation.Array


def is_held_out(k: int) -> bool:
    """Every third photograph."""
    return k % 3 == 2


def rms(errors: list[Array]) -> float:
    """Return the two-dimensional rms of errors (n, 2)."""
    return float(np.sqrt(np.mean(np.sum(np.concatenate(errors) ** 2, axis=1))))


def by_opencv(folder: Path, some: simulation.Session, python: Path) -> list[tuple[str, float, float]]:
    """Return what each method leaves of photographs held out, in px, and how far the camera is off, in mm."""
    nominal = [some.arm.tip(q, nominal=True) for q in some.readings]
    poses, out = folder / "nominal.csv", folder / "opencv.json"
    with poses.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["image", *(f"m{i}{j}" for i in range(4) for j in range(4))])
        table.writerows([f"image_{k:03d}.png", *T.ravel()] for k, T in enumerate(nominal) if not is_held_out(k))
    subprocess.run([python, RUNNER, folder, poses, out], check=True)
    told = json.loads(out.read_text())
    K, bent = np.array(told["K"]), tuple(told["bent"][:5])
    lens = simulation.Lens(K[0, 0], K[1, 1], K[0, 2], K[1, 2], bent, some.lens.size)
    marks = np.column_stack([some.sheet.corners(), np.zeros(len(some.sheet.corners()))])
    found = []
    for name, matrix in told["hand_eye"].items():
        X = np.array(matrix)
        seen = np.stack([F @ X @ B for F, B in zip(np.array(told["flange"]), np.array(told["boards"]), strict=True)])
        board = np.eye(4)
        board[:3, :3] = Rotation.from_matrix(seen[:, :3, :3]).mean().as_matrix()
        board[:3, 3] = seen[:, :3, 3].mean(axis=0)
        errors = []
        for k, F in enumerate(nominal):
            if is_held_out(k):
                T = np.linalg.inv(F @ X) @ board
                errors.append(lens.see(marks @ T[:3, :3].T + T[:3, 3]) - truth(some, k))
        off = 1e3 * float(np.linalg.norm(X[:3, 3] - some.camera[:3, 3]))
        found.append((f"OpenCV {told['version']}, {name.capitalize()}", rms(errors), off))
    return found


def truth(some: simulation.Session, k: int) -> Array:
    """Return where corners truly are in a photograph (n, 2), in px."""
    T = np.linalg.inv(some.arm.tip(some.readings[k]) @ some.camera) @ some.board
    return some.lens.see(some.sheet.place(some.sheet.corners()) @ T[:3, :3].T + T[:3, 3])


def by_calib(folder: Path, some: simulation.Session) -> tuple[str, float, float]:
    """Return the same of the job that ``calib import images`` writes, on the same photographs."""
    kept, made = folder / "kept", folder / "marks"
    for place in (kept, made):
        place.mkdir()
    for k in range(len(some.readings)):
        if not is_held_out(k):
            name = f"image_{k:03d}.png"
            (kept / name).write_bytes((folder / "photographs" / name).read_bytes())
    start = [sys.executable, "-m", "calib"]
    table, job, out = made / "marks.csv", made / "marks.toml", made / "out"
    arm = ["--robot", simulation.UR5, "--tip", simulation.TIP]
    given = ["--board", folder / "board.toml", "--readings", folder / "readings.csv", "-o", table]
    subprocess.run([*start, "import", "images", kept, *given, *arm, "-q"], check=True, cwd=ROOT)
    job.write_text(job.read_text().replace("hold_out = 0.25\n", ""))
    if subprocess.run([*start, "calibrate", job, "-o", out, "-q"], check=False, cwd=ROOT).returncode not in (0, 3):
        raise SystemExit(1)
    machine, result = calib.load_machine(out), json.loads((out / "result.json").read_text())
    value = {one["name"]: one["value"] for one in result["parameters"]}
    choice = result["optics"][0]
    shape = choice["candidates"][choice["chosen"]]["shape"]
    board = calib.measuring.Board(marks=read_board(folder / "board.toml").marks, shape=shape)
    shaped = np.array([value[f"board.{name}"] for name in ("scale", *board.mode_names)])
    marks = places_of(board.marks, board.modes, shaped)[0]
    lens = simulation.Lens(
        *(value[f"lens.{name}"] for name in ("fx", "fy", "cx", "cy")),
        k=tuple(value[f"lens.{name}"] for name in ("k1", "k2", "p1", "p2", "k3")),
    )
    (target,) = result["targets"].values()
    w, *xyz = target["quaternion"]
    at = simulation.pose(np.array(target["position"]), Rotation.from_quat([*xyz, w]).as_rotvec())
    errors = []
    for k, camera in enumerate(machine.predict(some.readings)):
        if is_held_out(k):
            T = np.linalg.inv(camera) @ at
            errors.append(lens.see(marks @ T[:3, :3].T + T[:3, 3]) - truth(some, k))
    off = 1e3 * float(np.linalg.norm(machine.tools["tool"][:3, 3] - some.camera[:3, 3]))
    return "calib: arm, lens, board and hand-eye at once", rms(errors), off


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--opencv", type=Path, required=True, metavar="PYTHON")
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--markdown", type=Path, help="the page of the table")
    given = parser.parse_args()
    some = simulation.session(given.seed, IMAGES)
    if not (given.folder / "truth.json").exists():
        simulation.write(given.folder, some, given.seed)
    with one_thread():
        found = [*by_opencv(given.folder, some, given.opencv), by_calib(given.folder, some)]
    rows = [f"| {name} | {pixels:.2f} | {off:.2f} |" for name, pixels, off in found]
    table = "\n".join(["| program | held out [px] | camera off [mm] |", "|---|--:|--:|", *rows])
    print(table)
    if given.markdown is not None:
        write(given.markdown, table, BEGIN, END)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
