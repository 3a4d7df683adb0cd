"""From photographs to an arm nearer to its truth: many arms, prints and lenses, as a user would do it.

    python scripts/studies/photographs_rehearsal.py --store rehearsal.jsonl [--seeds 8] [--rendered 1]
        [--only TEXT] [--markdown docs/cameras.md]

Every case and seed is one line of the store; what is there already is not simulated again. A small arm, a UR3, takes
24 photographs; 16 identify and 8 are held out, in three splits by whole photographs. The job is the one that ``calib
import images`` writes. The first seeds are rendered, and go through the commands ``calib import images`` and ``calib
calibrate``; of the others corners are simulated, each found to 0.05 px, by the same mathematics, which is not the
toolkit's.

*Off*: rms distance of the flange from the truth at the poses of the photographs and at 40 others that see the board,
base and flange of the two arms aligned first, by poses with a lever of 0.1 m. *Told*: which of the 95 % intervals hold
of the print's scale, the lens's numbers, and distances between places of the camera.
"""

import argparse
import csv
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from calib.foundations.errors import CalibError
from calib.foundations.linear import one_thread
from calib.job.inputs import load
from calib.job.run import run
from calib.machine.tool_uncertainty import tool_errors
from calib.measurement.lens import NAMES
from calib.results.calibration import Calibration
from scripts.simulate import photographs as simulation
from scripts.studies.blame import write

UR3 = "example:ur_description/urdf/ur3_robot.urdf"
ROOT = Path(__file__).resolve().parents[2]
COMMAND = [sys.executable, "-c", "import sys; from calib_start import main; sys.exit(main())"]
IMAGES, ELSEWHERE, SPLITS, HELD_OUT = 24, 40, 3, 8
SIGMA, LEVER, NORMAL = 0.05, 0.1, 1.959964
# Two arms are alike that are aligned to that, in m.
ROUNDING = 1e-6
# What a command ends with whose verdict has doubts: no refusal.
DOUBTED = 3
Array = simulation.Array
BEGIN, END = "<!-- rehearsal: by scripts/studies/photographs_rehearsal.py -->", "<!-- rehearsal: end -->"
# Of a wide lens, as a camera's maker states eight numbers.
EIGHT = (2.1, 0.9, 3e-4, -2e-4, 0.05, 2.35, 1.45, 0.2)

PRINT = simulation.Sheet(scale=0.003, aspect=3e-4, shear=-2e-4, bend=(0.1, -0.05, 0.08))
LENS, LOOK = simulation.Lens(), simulation.Look()


@dataclass(frozen=True)
class Case:
    """What is unlike an ordinary job. Lengths in m, angles in rad.

    ``arm``: standard deviation of the placements' errors, lengths and angles alike; ``repeats``: of the flange from
    photograph to photograph, length and angle; ``flat``: of how many photographs the board is seen from straight above;
    ``distance``: between which the board is seen; ``job``: changes to the text of the job; ``flange``: readings are the
    controller's poses.
    """

    arm: float = 0.6e-3
    repeats: tuple[float, float] = (0.05e-3, 0.2e-3)
    zeros: float = 0.0
    sheet: simulation.Sheet = PRINT
    lens: simulation.Lens = LENS
    look: simulation.Look = LOOK
    flat: int = 0
    distance: tuple[float, float] = (0.15, 0.5)
    images: int = IMAGES
    covered: bool = False
    flange: bool = False
    job: tuple[tuple[str, str], ...] = ()


# What the verdict tells whoever has an arm that is as its URDF.
KEPT = (('offsets = "all"\n', ""), ('placements = "all"\n', ""))
LARGE = replace(Case().sheet, scale=0.01)
STATED = (('"learned", angle = "learned"', '"1 mm", angle = "1 mrad"'),)
CASES: Mapping[str, Case] = {
    "ordinary": Case(),
    "errors of 1 mm and 1 mrad": Case(arm=1e-3),
    "arm repeats to 0.2 mm, 0.5 mrad": Case(repeats=(0.2e-3, 0.5e-3)),
    "URDF is right": Case(arm=0.0),
    "URDF is right, repeats to 0.2 mm, 0.5 mrad": Case(arm=0.0, repeats=(0.2e-3, 0.5e-3)),
    "URDF is right and is kept": Case(arm=0.0, job=KEPT),
    "print 1 % too large": Case(sheet=LARGE),
    "URDF is right, print 1 % too large": Case(arm=0.0, sheet=LARGE),
    "print in waves of 0.5 mm": Case(sheet=replace(Case().sheet, wave=0.5e-3)),
    "lens of eight numbers": Case(lens=replace(Case().lens, k=EIGHT)),
    "20 of 24 from straight above": Case(flat=20),
    "all from one distance": Case(distance=(0.30, 0.34)),
    "zeros off by 5 mrad": Case(zeros=5e-3),
    "blurred, noisy, partly covered": Case(look=replace(Case().look, blur=1.6, noise=6.0), covered=True),
    "8 photographs to identify": Case(images=16),
    "6 photographs to identify": Case(images=12),
    "errors of 3 mm and 3 mrad": Case(arm=3e-3),
    "errors of 5 mm and 5 mrad": Case(arm=5e-3),
    "priors of 1 mm and 1 mrad stated": Case(job=STATED),
    "6 photographs, priors of 1 mm and 1 mrad stated": Case(images=12, job=STATED),
    "errors of 3 mm and 3 mrad, priors of 1 mm and 1 mrad stated": Case(arm=3e-3, job=STATED),
    "errors of 5 mm and 5 mrad, priors of 1 mm and 1 mrad stated": Case(arm=5e-3, job=STATED),
    "no priors stated": Case(job=(("prior = {", "# prior = {"),)),
    "URDF is right, no priors stated": Case(arm=0.0, job=(("prior = {", "# prior = {"),)),
    "poses of the flange instead of joints": Case(flange=True),
}


# ---- what is there


@dataclass
class Scene:
    """An arm, what it sees, and where it was: ``cameras`` (m, 4, 4) in the base, of the photographs alone."""

    some: simulation.Session
    cameras: Array
    elsewhere: Array


def tips(arm: simulation.Arm, q: Array, *, nominal: bool = False) -> Array:
    """Return where the flange is (N, 4, 4) at readings (N, nr)."""
    return np.stack([arm.tip(one, nominal=nominal) for one in q])


def scene(case: Case, seed: int) -> Scene:
    """Draw an arm, a camera, a board, and poses that see it."""
    rng = np.random.default_rng([seed, 16])
    arm = simulation.Arm(rng, case.arm, case.arm, case.zeros, urdf=UR3)
    camera = simulation.pose(
        np.array([0.005, -0.065, 0.04]) + rng.normal(scale=5e-3, size=3), rng.normal(scale=0.03, size=3)
    )
    down = Rotation.from_euler("xyz", (180, 0, 90), degrees=True).as_rotvec()
    board = simulation.pose(
        np.array([0.30, -0.05, 0.0]) + rng.normal(scale=0.02, size=3), down + rng.normal(scale=0.05, size=3)
    )
    lens, sheet, found, flat = case.lens, case.sheet, [], 0
    size = np.array(lens.size)
    while len(found) < case.images + ELSEWHERE:
        # The camera somewhere above the board, looking near its middle: then the joints that bring it there.
        above, k = flat < case.flat and len(found) < case.images, len(found)
        tilt = rng.uniform(0.0, 0.1) if above else rng.uniform(0.15, 0.8)
        around, far, roll = rng.uniform(-np.pi, np.pi), rng.uniform(*case.distance), rng.uniform(-np.pi, np.pi)
        z = np.array([np.sin(tilt) * np.cos(around), np.sin(tilt) * np.sin(around), np.cos(tilt)])
        x = np.cross(z, [0.3, 1.0, 0.2])
        x /= np.linalg.norm(x)
        R = np.column_stack([x, np.cross(z, x), z]) @ Rotation.from_rotvec([0, 0, roll]).as_matrix()
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R, -far * z + np.append(rng.normal(scale=0.02, size=2), 0.0)
        q = _joints(arm, board @ T @ np.linalg.inv(camera), rng)
        if q is None:
            continue
        T = np.linalg.inv(arm.tip(q) @ camera) @ board
        seen = lens.see(sheet.place(sheet.corners()) @ T[:3, :3].T + T[:3, 3])
        if np.all((seen > 15) & (seen < size - 15)):
            found.append(q)
            flat += above and k < case.images
    # Photographs from straight above come first: splits shall not depend on it.
    readings = np.array(found)
    readings[: case.images] = rng.permutation(readings[: case.images])
    some = simulation.Session(arm, lens, sheet, case.look, camera, board, readings[: case.images])
    lengths, angles = case.repeats
    cameras = [
        T @ simulation.pose(rng.normal(scale=lengths, size=3), rng.normal(scale=angles, size=3)) @ camera
        for T in tips(arm, some.readings)
    ]
    return Scene(some, np.stack(cameras), readings[case.images :])


def _joints(arm: simulation.Arm, T: Array, rng: np.random.Generator) -> Array | None:
    """Return readings that bring the flange to T (4, 4), None where none are found."""

    def missed(q: Array) -> Array:
        at = arm.tip(q, nominal=True)
        turn = Rotation.from_matrix(at[:3, :3].T @ T[:3, :3]).as_rotvec()
        return np.concatenate([10.0 * (at[:3, 3] - T[:3, 3]), turn])

    start = np.array([0.0, -1.5, 1.5, -1.6, -1.6, 0.0]) + rng.normal(scale=0.3, size=6)
    found = least_squares(missed, start, xtol=1e-9, ftol=1e-9, max_nfev=40)
    return found.x if np.max(np.abs(found.fun)) < 1e-5 and np.max(np.abs(found.x)) < 3.1 else None


# ---- what a user has


def photographed(there: Scene, case: Case, folder: Path, seed: int) -> tuple[Path, Path, str]:
    """Render photographs, and import them by the command; returns the table, the job and what was said."""
    some, rng = there.some, np.random.default_rng([seed, 17])
    renderer = simulation.Renderer(some.lens, some.sheet, some.look)
    (folder / "photographs").mkdir()
    for k, T in enumerate(there.cameras):
        grey = renderer.image(np.linalg.inv(T) @ some.board, rng)
        if case.covered and k % 3 == 0:
            middle = renderer.corners(np.linalg.inv(T) @ some.board).mean(axis=0)
            corner = tuple(int(x) for x in middle + rng.uniform(20, 60, 2))
            cv2.rectangle(grey, corner, (some.lens.size[0], some.lens.size[1]), 90, thickness=-1)
        cv2.imwrite(str(folder / "photographs" / f"image_{k:03d}.png"), grey)
    titles = ["image", *(f"{name} [rad]" for name in some.arm.names)]
    rows: list[list[object]] = [[f"image_{k:03d}.png", *q] for k, q in enumerate(some.readings)]
    if case.flange:
        titles = ["image", "x [m]", "y [m]", "z [m]", "qx", "qy", "qz", "qw"]
        at = tips(some.arm, some.readings)
        rows = [[f"image_{k:03d}.png", *T[:3, 3], *Rotation.from_matrix(T[:3, :3]).as_quat()] for k, T in enumerate(at)]
    _csv(folder / "readings.csv", titles, rows)
    sheet = some.sheet
    (folder / "board.toml").write_text(
        f'kind = "charuco"\nsquares = {list(sheet.squares)}\nsquare = "{1e3 * sheet.square:g} mm"\n'
        f'marker = "{1e3 * sheet.marker:g} mm"\ndictionary = "{sheet.dictionary}"\n'
    )
    said = _command(
        folder,
        *("import", "images", "photographs", "--board", "board.toml", "--readings", "readings.csv"),
        *("--robot", UR3, "--tip", simulation.TIP, "-o", "marks.csv"),
    )
    return folder / "marks.csv", folder / "marks.toml", said


def tabled(there: Scene, folder: Path, seed: int) -> tuple[Path, Path]:
    """Write the table and the job that an import of photographs would have, corners simulated."""
    some, rng = there.some, np.random.default_rng([seed, 17])
    drawn = some.sheet.corners()
    rows: list[list[object]] = []
    for k, (q, T) in enumerate(zip(some.readings, there.cameras, strict=True)):
        at = np.linalg.inv(T) @ some.board
        seen = some.lens.see(some.sheet.place(drawn) @ at[:3, :3].T + at[:3, 3])
        seen = seen + rng.normal(scale=SIGMA, size=seen.shape)
        for uv, (x, y) in zip(seen, 1e3 * drawn, strict=True):
            rows.append([*q, f"image_{k:03d}", *uv, x, y, 0.0, SIGMA])
    titles = [*(f"{name} [rad]" for name in some.arm.names), "group", "u [px]", "v [px]"]
    _csv(folder / "marks.csv", [*titles, "board_x [mm]", "board_y [mm]", "board_z [mm]", "sigma [px]"], rows)
    (folder / "board.toml").write_text(
        'kind = "charuco"\nsquares = [7, 5]\nsquare = "30 mm"\nmarker = "22 mm"\ndictionary = "DICT_4X4_50"\n'
    )
    w, h = some.lens.size
    (folder / "marks.toml").write_text(
        f'schema = 1\n[robot]\nurdf = "{UR3}"\ntip = "{simulation.TIP}"\n'
        '[error_model]\noffsets = "all"\nplacements = "all"\nbase = "fixed"\ntool = "pose"\n'
        'prior = { length = "learned", angle = "learned" }\n'
        f'[instruments.camera]\nkind = "camera"\ncamera_on = "tip"\nlens = "free"\nsize = [{w}, {h}]\n'
        '[[measurements]]\nfile = "marks.csv"\nobserves = "pixels"\ninstrument = "camera"\nboard = "board.toml"\n'
        "hold_out = 0.25\n"
    )
    return folder / "marks.csv", folder / "marks.toml"


def _csv(file: Path, titles: list[str], rows: list[list[object]]) -> None:
    with file.open("w", newline="") as out:
        csv.writer(out, lineterminator="\n").writerows([titles, *rows])


def _command(folder: Path, *words: str) -> str:
    done = subprocess.run([*COMMAND, *words], cwd=folder, capture_output=True, text=True, env=None, check=False)
    if done.returncode not in (0, DOUBTED):
        raise CalibError(done.stderr.strip() or done.stdout.strip())
    return done.stdout


def held_out(photographs: list[int], case: Case, number: int) -> set[int]:
    """Return which photographs a split holds out: 8 of 24, or as large a share; half where there are fewer."""
    count = min(HELD_OUT, len(photographs) // 3) if case.images >= IMAGES else len(photographs) // 2
    return set(np.random.default_rng([number, 8]).permutation(photographs)[:count].tolist())


def split(table: Path, job: Path, case: Case, number: int) -> Path:
    """Write tables and the job of one split of whole photographs: 16 of 24 identify, or as large a share."""
    with table.open() as source:
        titles, *rows = list(csv.reader(source))
    group = titles.index("group")
    names = list(dict.fromkeys(row[group] for row in rows))
    held = {names[k] for k in held_out(list(range(len(names))), case, number)}
    text = job.read_text()
    for old, new in case.job:
        text = text.replace(old, new)
    head, part = text.split("[[measurements]]")
    for use in ("identify", "validate"):
        kept = [row for row in rows if (row[group] in held) == (use == "validate")]
        _csv(table.with_name(f"{use}_{number}.csv"), titles, [list(row) for row in kept])
        own = part.replace('"marks.csv"', f'"{use}_{number}.csv"').replace("hold_out = 0.25", f'use = "{use}"')
        head += "[[measurements]]" + own
    path = job.with_name(f"split_{number}.toml")
    path.write_text(head)
    return path


# ---- how near to the truth


def off(found: Array, true: Array) -> float:
    """Return the rms distance of flanges (N, 4, 4) in m, once both ends of the two arms are aligned."""

    def missed(x: Array) -> Array:
        a, b = simulation.pose(x[:3], x[3:6]), simulation.pose(x[6:9], x[9:])
        at = a @ found @ b
        turn = Rotation.from_matrix(at[:, :3, :3].transpose(0, 2, 1) @ true[:, :3, :3]).as_rotvec()
        return np.concatenate([(at[:, :3, 3] - true[:, :3, 3]).ravel(), LEVER * turn.ravel()])

    best = least_squares(missed, np.zeros(12), xtol=1e-10, ftol=1e-10).fun
    return float(np.sqrt(np.sum(best[: 3 * len(found)] ** 2) / len(found)))


def judged(found: Calibration, there: Scene) -> dict[str, object]:
    """Return what one split comes to."""
    fit, some = found.fit, there.some
    everywhere = np.concatenate([some.readings, there.elsewhere])
    names, sigmas = [p.name for p in fit.parameters], np.sqrt(np.diag(fit.covariance))
    sure = dict(zip(names, sigmas.tolist(), strict=True))
    lens = some.lens
    numbers = dict(zip(NAMES, (lens.fx, lens.fy, lens.cx, lens.cy, *lens.k), strict=False))

    def holds(name: str, value: float) -> bool | None:
        return None if name not in sure else bool(abs(fit.value(name) - value) <= NORMAL * sure[name])

    # Of lenses the numbers of other models are others.
    own = len(lens.k) == sum(f"lens.{k}" in sure for k in NAMES[4:])
    told = [holds(f"lens.{name}", value) for name, value in numbers.items()] if own else []
    machine = found.machine
    at = machine.predict(there.elsewhere)[:, :3, 3]
    true = (tips(some.arm, there.elsewhere) @ some.camera)[:, :3, 3]
    common = tool_errors(machine, there.elsewhere)[:, :3]
    i, j = np.arange(ELSEWHERE), np.roll(np.arange(ELSEWHERE), 1)
    along = (at[i] - at[j]) / np.linalg.norm(at[i] - at[j], axis=1)[:, None]
    sigma = np.sqrt(np.sum(np.einsum("nd,ndr->nr", along, common[i] - common[j]) ** 2, axis=1))
    wrong = np.linalg.norm(at[i] - at[j], axis=1) - np.linalg.norm(true[i] - true[j], axis=1)
    (chosen,) = found.optics or (None,)
    best = None if chosen is None else chosen.candidates[chosen.chosen]
    return {
        "off": off(fit.robot.tips(everywhere, machine.deviations), tips(some.arm, everywhere)),
        "px": found.judged_by["after"]["pixels"].rms,
        "px_before": found.judged_by["before"]["pixels"].rms,
        "doubts": list(found.doubts),
        "scale": fit.value("board.scale") if "board.scale" in sure else None,
        "scale_sigma": sure.get("board.scale"),
        "scale_holds": holds("board.scale", some.sheet.scale),
        "lens_holds": [x for x in told if x is not None],
        "distances_hold": (np.abs(wrong) <= NORMAL * sigma).tolist(),
        "distances": [float(np.sqrt(np.mean(wrong**2))), float(np.sqrt(np.mean(sigma**2)))],
        "optics": None if best is None else [best.shape, best.distortion],
        "noise": [(noise.instrument, noise.model) for noise in fit.noise],
    }


def rehearse(
    case: Case, seed: int, *, rendered: bool, say: Callable[[str], None] = lambda _: None
) -> dict[str, object]:
    """Return what a case comes to, in all splits."""
    there = scene(case, seed)
    everywhere = np.concatenate([there.some.readings, there.elsewhere])
    untouched = off(tips(there.some.arm, everywhere, nominal=True), tips(there.some.arm, everywhere))
    with tempfile.TemporaryDirectory() as name:
        folder, splits = Path(name), []
        if rendered:
            table, job, said = photographed(there, case, folder, seed)
            say(said)
        else:
            table, job = tabled(there, folder, seed)
        for number in range(SPLITS):
            path = split(table, job, case, number)
            with one_thread():
                splits.append(judged(run(load(path, lambda _: None)), there))
            if rendered and number == 0:
                say(_command(folder, "calibrate", path.name, "-o", "out"))
    return {"untouched": untouched, "splits": splits}


# ---- the table


def table(lines: Sequence[Mapping[str, Any]]) -> str:
    """Return the table of a page: a row for every case, rendered or not, in the order of the cases."""
    head = ("case", "jobs", "untouched [mm]", "off [mm]", "held out before [px]", "held out [px]", "trusted")
    rows = ["| " + " | ".join(head) + " |", "|---|" + "--:|" * (len(head) - 1)]
    for name in CASES:
        for rendered in (False, True):
            own = [one for one in lines if one["case"] == name and one["rendered"] == rendered]
            told = [(one["untouched"], split) for one in own for split in one.get("splits", ())]
            refused = sum("refused" in one for one in own)
            if not own:
                continue
            jobs = f"{len(told)}" + (f", {refused} refused" if refused else "")
            cells = [
                _span([1e3 * before for before, _ in told], 2),
                _span([1e3 * split["off"] for _, split in told], 2),
                _span([split["px_before"] for _, split in told], 2),
                _span([split["px"] for _, split in told], 2),
                f"{sum(not split['doubts'] for _, split in told)} of {len(told)}",
            ]
            rows.append(f"| {name}{', rendered' if rendered else ''} | {jobs} | " + " | ".join(cells) + " |")
    worse = [
        split["off"] > before + ROUNDING and not split["doubts"]
        for one in lines
        for before, split in ((one["untouched"], split) for split in one.get("splits", ()))
    ]
    return "\n".join(
        [*rows, "", f"Of {len(worse)} jobs {sum(worse)} are trusted and yet worse than the untouched arm."]
    )


def _span(values: Sequence[float], digits: int) -> str:
    if not values:
        return ""
    low, high = (f"{value:.{digits}f}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--rendered", type=int, default=1, help="of the seeds, how many are rendered")
    parser.add_argument("--only", help="cases whose name holds this")
    parser.add_argument("--markdown", type=Path, help="the page of the table, which is then made of what is stored")
    given = parser.parse_args()
    given.store.touch()
    lines = [json.loads(line) for line in given.store.read_text().splitlines()]
    done = {(one["case"], one["seed"], one["rendered"]) for one in lines}
    for seed in range(0 if given.markdown is not None else given.seeds):
        for name, case in CASES.items():
            rendered = seed < given.rendered
            if (name, seed, rendered) in done or (given.only or "") not in name:
                continue
            if (case.flange or case.covered) and not rendered:
                continue
            try:
                found = rehearse(case, seed, rendered=rendered, say=print)
            except CalibError as e:
                found = {"refused": str(e)}
            lines.append({"case": name, "seed": seed, "rendered": rendered, **found})
            with given.store.open("a") as out:
                out.write(json.dumps(lines[-1]) + "\n")
    found_table = table(lines)
    print(found_table)
    if given.markdown is not None:
        write(given.markdown, found_table, BEGIN, END)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
