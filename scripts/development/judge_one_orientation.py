"""Does calib stay sane where data say little? Flanges that never turn, and other sets that leave directions open.

    python scripts/development/judge_one_orientation.py [--cases 60] [--seed 0] [--only lines]
        [--out one_orientation.csv]

Lines, arcs and planes are followed at one orientation of the flange, to 1e-6 deg of the readings, by UR5, UR10, Panda
and IRB2400 of known truth. Their joints have what no geometry explains: harmonics of 0.05 to 0.15 mrad, or compliance
of as much, either correlated along the path. Held-out rows are of other paths of the same kind in the same volume. A
session is right where calib converges, in at most 100 evaluations, and its held-out rms is at most 1.15 times that of a
fit that is told the tool. Other scenarios: a wrist that turns by 0.1 deg, a tool on the last axis, one joint that alone
moves, three joints on one axis. Truth, paths and predictions are those of :mod:`scripts.development.judge_machines`.
"""

import argparse
import csv
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

import calib
from calib.robot.urdf import parse_urdf
from scripts.development.judge_cases import (
    OF_LOOP,
    UR5,
    Errors,
    draw,
    free_placements,
    known_arm,
    machine,
    pose,
    reading_columns,
)
from scripts.development.judge_machines import (
    Arm,
    Array,
    Layout,
    State,
    arm,
    placed,
    predict,
    rotation_vector,
)
from scripts.development.judge_verdict import state_of

MOST_RATIO, MOST_EVALUATIONS = 1.15, 100
ORDERS = (1, 2, 5, 11, 37)
# A payload of 100 N at the tip bends joints by this much per Nm: 0.1 mrad where it is a metre away.
FORCE, COMPLIANCE = 100.0, 1e-6
# Held-out rms below this, in m, is rounding, of data without noise.
NOTHING = 1e-8


@dataclass(frozen=True)
class Session:
    """A set to identify, a set to judge by, and what calib is told."""

    scenario: str
    seed: int
    label: Mapping[str, Any]
    layout: Layout
    true: State
    robot: calib.Robot
    free: Mapping[str, Any]
    sigma: float
    stated: bool
    readings: Array
    positions: Array
    held_out: Array
    held_out_positions: Array

    @property
    def data(self) -> calib.Measurements:
        """What calib is given."""
        columns = reading_columns(self.layout.arm, self.readings)
        columns |= {f"{axis} [m]": self.positions[:, k] for k, axis in enumerate("xyz")}
        return calib.read_measurements(columns, self.robot, sigma=self.sigma if self.stated else 0.0)


@dataclass(frozen=True)
class Result:
    """What came of a session; errors in mm, distances from the flange in m."""

    scenario: str
    seed: int
    outcome: str
    held_out: float
    knowing_tool: float
    ratio: float
    in_sample: float
    tool: float
    true_tool: float
    tool_error: float
    converged: bool | None
    evaluations: int | None
    rank: int | None
    numerical_rank: int | None
    seconds: float
    said: str


# ---- robots


def coaxial(where: str) -> str:
    """An arm with three joints on one axis: at its base, all in one point of it, at its wrist, or no others at all."""
    plain = [("0 0 0.3", "0 0 1"), ("0 0 0.2", "0 1 0"), ("0.4 0 0", "0 1 0"), ("0.35 0 0", "1 0 0")]
    three = [("0 0 0.1", "0 0 1"), ("0 0 0.15", "0 0 1"), ("0 0 0.1", "0 0 1")]
    point = [("0 0 0.3", "0 0 1"), ("0 0 0", "0 0 1"), ("0 0 0", "0 0 1")]
    on_x = [("0.1 0 0", "1 0 0"), ("0.08 0 0", "1 0 0"), ("0.1 0 0", "1 0 0")]
    joints = {
        "wrist": [*plain[:3], *on_x],
        "base": [*three, *plain[1:]],
        "point": [*point, *plain[1:]],
        "alone": three,
    }[where]
    links = ["base", *(f"l{k}" for k in range(1, len(joints))), "tip"]
    limit = '<limit lower="-2.8" upper="2.8" effort="1" velocity="1"/>'
    text = [f'<link name="{link}"/>' for link in links]
    for k, (xyz, axis) in enumerate(joints):
        text.append(
            f'<joint name="j{k + 1}" type="revolute"><parent link="{links[k]}"/><child link="{links[k + 1]}"/>'
            f'<origin xyz="{xyz}" rpy="0 0 0"/><axis xyz="{axis}"/>{limit}</joint>'
        )
    return f'<robot name="coaxial">{"".join(text)}</robot>'


@cache
def robot_of(which: str) -> tuple[Arm, calib.Robot]:
    """An arm as the judge and as calib read it."""
    if which.startswith("coaxial"):
        text = coaxial(which.removeprefix("coaxial "))
        return arm(text, "tip"), calib.load_robot(parse_urdf(text.encode(), "coaxial.urdf"), "tip")
    if which == "ur10":
        source = UR5[0].replace("ur5", "ur10")
        return arm(source, "tool0"), calib.load_robot(source, "tool0")
    return known_arm(which)


# ---- paths


def jacobian(found: Arm, q: Array) -> tuple[Array, Array]:
    """Nominal tips (N, 4, 4) and their derivatives (N, 6, k), linear part first, in the base's axes."""
    n, k = q.shape
    h = 1e-6
    every = (q + h * np.vstack([np.zeros(k), np.eye(k), -np.eye(k)])[:, None]).reshape(-1, k)
    T = found.tips(every)[0].reshape(2 * k + 1, n, 4, 4)
    up, down = T[1 : k + 1], T[k + 1 :]
    linear = (up[..., :3, 3] - down[..., :3, 3]) / (2 * h)
    turn = rotation_vector(up[..., :3, :3] @ np.swapaxes(down[..., :3, :3], -1, -2)) / (2 * h)
    return T[0], np.moveaxis(np.concatenate([linear, turn], axis=-1), 0, -1)


def follow(found: Arm, begin: Array, poses: Array) -> Array | None:
    """Readings (N, k) at which the nominal tip is at poses (N, 4, 4), all led there from ``begin`` (k,) in steps.

    None where it cannot be, or nearly not.
    """
    q = np.repeat(begin[None], len(poses), axis=0)
    T0 = found.tips(begin[None])[0, 0]
    low, high = np.transpose(list(found.ranges.values()))
    for share in (*np.linspace(0.05, 1.0, 20), 1.0, 1.0):
        for _ in range(3 if share == 1.0 else 1):
            T, J = jacobian(found, q)
            goal = T0[:3, 3] + share * (poses[:, :3, 3] - T0[:3, 3])
            turn = rotation_vector(poses[:, :3, :3] @ np.swapaxes(T[:, :3, :3], -1, -2))
            r = np.concatenate([goal - T[:, :3, 3], turn], axis=1)
            if np.linalg.svd(J, compute_uv=False)[:, 5].min() < 0.03:
                return None
            q = q + (np.linalg.pinv(J) @ r[..., None])[..., 0]
            if not np.all((q > low) & (q < high)):
                return None
    T, _ = jacobian(found, q)
    there = np.abs(T[:, :3, 3] - poses[:, :3, 3]).max() < 1e-7
    return q if there else None


def shape(kind: str, rng: np.random.Generator, size: float, n: int, frame: Array) -> Array:
    """Points (n, 3) about the origin within a box of that size: of several lines or arcs, or over one plane."""
    if kind == "planes":
        m = max(int(np.sqrt(n / 4)), 3)
        u = np.linspace(-0.5, 0.5, n)
        across = (np.floor(np.linspace(0, m - 1e-9, n)) + rng.uniform()) / m - 0.5
        along = np.abs(((u + 0.5) * m + rng.uniform()) % 2.0 - 1.0) - 0.5
        return size * np.stack([along, across, np.zeros(n)], axis=1) @ frame.T
    found = []
    several = int(rng.integers(4, 9))
    for part in np.array_split(np.arange(n), several):
        s = np.linspace(0.0, 1.0, len(part))[:, None]
        if kind == "lines":
            a, b = rng.uniform(-0.5, 0.5, (2, 3))
            found.append(size * (a + s * (b - a)))
        else:
            radius, (u, v) = rng.uniform(0.15, 0.45), np.linalg.qr(rng.normal(size=(3, 2)))[0].T
            angle = rng.uniform(0.0, 2.0 * np.pi) + s * rng.uniform(1.5, 6.0)
            found.append(size * radius * (np.cos(angle) * u + np.sin(angle) * v))
    return np.concatenate(found)


def one_orientation(
    which: str, kind: str, rng: np.random.Generator, counts: Sequence[int], wobble: float
) -> tuple[list[Array], float]:
    """Readings of several paths in one volume at one orientation, and the size of the volume (m)."""
    found, _ = robot_of(which)
    while True:
        begin = 0.6 * draw(which, found, rng, 1)[0]
        if which.startswith("ur"):
            # A UR works with its elbow bent and its flange down.
            begin = np.array([rng.uniform(-2.5, 2.5), -1.4, 1.6, -1.8, -1.57, rng.uniform(-2, 2)])
            begin = begin + rng.uniform(-0.4, 0.4, 6)
        size = float(rng.uniform(0.2, 0.5))
        T0 = found.tips(begin[None])[0, 0]
        frame = pose(rng, 1.0)[:3, :3]
        paths: list[Array] = []
        for n in counts:
            points = T0[:3, 3] + shape(kind, rng, size, n, frame)
            turns = T0[:3, :3] @ placed_turns(wobble * smooth(rng, n))
            q = follow(found, begin, placed(turns, points))
            if q is None:
                break
            # As a controller writes them.
            paths.append(np.radians(np.round(np.degrees(q), 7)))
        if len(paths) == len(counts):
            return paths, size


def smooth(rng: np.random.Generator, n: int) -> Array:
    """Three waves (n, 3) of size one along a path."""
    s = np.linspace(0.0, 2.0 * np.pi, n)[:, None]
    return np.sin(rng.uniform(1.0, 4.0, 3) * s + rng.uniform(0.0, 2.0 * np.pi, 3))


def placed_turns(vectors: Array) -> Array:
    """Rotations (n, 3, 3) by small rotation vectors (n, 3)."""
    from scipy.spatial.transform import Rotation  # noqa: PLC0415

    return Rotation.from_rotvec(vectors).as_matrix()


# ---- what no geometry explains


def unmodelled(found: Arm, kind: str, rng: np.random.Generator) -> Callable[[Array], Array]:
    """What is added to readings (N, k) on their way to the joints."""
    k = len(found.ranges)
    amplitudes = rng.uniform(0.05e-3, 0.15e-3, (2, k)) if kind in ("harmonics", "both") else np.zeros((2, k))
    orders, phases = rng.choice(ORDERS, (2, k)), rng.uniform(0.0, 2.0 * np.pi, (2, k))
    soft = rng.uniform(0.3, 1.0, k) * COMPLIANCE if kind in ("compliance", "both") else np.zeros(k)
    down = np.array([0.0, 0.0, -FORCE])

    def added(q: Array) -> Array:
        waves = np.sum(amplitudes * np.cos(orders * q[:, None] + phases), axis=1)
        _, J = jacobian(found, q)
        return waves + soft * (np.swapaxes(J[:, :3], -1, -2) @ down)

    return added


# ---- sessions


def session(
    scenario: str, seed: int, which: str, rng: np.random.Generator, paths: Sequence[Array], **said: Any
) -> Session:
    """Measure two sets of readings with a machine of known truth."""
    found, robot = robot_of(which)
    with_noise = said.pop("noise", True)
    on_axis = said.pop("on_axis", False)
    kind = said.pop("model_error", "none")
    errors = said.pop("errors", Errors(5e-3, 0.3e-3, 0.5e-3))
    placements = free_placements(which, found)
    far = rng.uniform((-0.1, -0.1, 0.05), (0.1, 0.1, 0.25))
    if on_axis:
        # Of all these robots the last joint turns about the tip's z, or x for those of this file.
        far = np.array([0.15, 0.0, 0.0]) if which.startswith("coaxial") else np.array([0.0, 0.0, 0.15])
    true = machine(rng, found, errors, placements, pose(rng, 2.0), placed(np.eye(3), far)[None])
    added = unmodelled(found, kind, rng)
    sigma = float(rng.choice([0.02e-3, 0.05e-3])) if with_noise else 0.0
    stated = with_noise and bool(rng.random() < 0.6)
    prior = bool(said.pop("priors", True) and rng.random() < 0.3)
    none = [np.zeros(len(q), dtype=np.intp) for q in paths]
    seen = [predict(found, true, q + added(q), zero)[0, :, :3, 3] for q, zero in zip(paths, none, strict=True)]
    seen = [points + sigma * rng.standard_normal(points.shape) for points in seen]
    loop = which == "irb2400"
    free: dict[str, Any] = {
        "offsets": ["joint_*"] if loop else "all",
        "placements": list(OF_LOOP) if loop else "all",
        "base": "pose",
        "tool": "position",
    }
    if prior:
        free["priors"] = calib.Priors(0.3e-3, 3e-3)
    nominal = State(np.zeros_like(true.deviations), np.zeros_like(true.offsets), true.base, true.tools, true.targets)
    label = {
        "robot": which,
        "rows": len(paths[0]),
        "model error": kind,
        "sigma [mm]": sigma * 1e3,
        "stated": stated,
        "prior": prior,
        **said,
    }
    layout = Layout(found, (), nominal, ("tool",), ())
    return Session(
        scenario, seed, label, layout, true, robot, free, sigma, stated, paths[0], seen[0], paths[1], seen[1]
    )


def on_paths(kind: str, wobble: float = 0.0) -> Callable[[int], Session]:
    """Sessions at one orientation, or nearly: ``wobble`` in rad."""

    def made(seed: int) -> Session:
        rng = np.random.default_rng([seed, 11, *kind.encode(), int(wobble > 0)])
        which = str(rng.choice(["ur5", "ur10", "panda", "irb2400"]))
        model_error = str(rng.choice(["harmonics", "harmonics", "compliance", "both", "none"]))
        counts = int(rng.integers(60, 401)), 200
        drawn = kind if wobble == 0.0 else str(rng.choice(["lines", "arcs", "planes"]))
        paths, size = one_orientation(which, drawn, rng, counts, wobble)
        name = "turns by 0.1 deg" if wobble else kind
        return session(
            name, seed, which, rng, paths, model_error=model_error, path=drawn, **{"size [m]": round(size, 2)}
        )

    return made


def tool_on_axis(seed: int) -> Session:
    """A tool on the axis of the last joint, whose turning nothing sees then."""
    rng = np.random.default_rng([seed, 12])
    which = str(rng.choice(["ur5", "ur10", "panda"]))
    found, _ = robot_of(which)
    paths = [draw(which, found, rng, int(rng.integers(20, 61))), draw(which, found, rng, 200)]
    model_error = str(rng.choice(["none", "harmonics"]))
    return session("tool on last axis", seed, which, rng, paths, on_axis=True, model_error=model_error)


def one_joint(seed: int) -> Session:
    """All joints stand but one."""
    rng = np.random.default_rng([seed, 13])
    which = str(rng.choice(["ur5", "ur10", "panda"]))
    found, _ = robot_of(which)
    joint = int(rng.integers(0, 4))
    stand = found.draw(rng, 1)
    paths = []
    for n in (int(rng.integers(12, 61)), 200):
        q = np.repeat(stand, n, axis=0)
        q[:, joint] = draw(which, found, rng, n)[:, joint]
        paths.append(q)
    model_error = str(rng.choice(["none", "harmonics"]))
    return session("one joint moves", seed, which, rng, paths, model_error=model_error, joint=joint + 1)


def three_on_one_axis(seed: int) -> Session:
    """Three joints on one axis, with and without noise."""
    rng = np.random.default_rng([seed, 14])
    which = str(rng.choice(["coaxial base", "coaxial wrist", "coaxial point", "coaxial alone"]))
    found, _ = robot_of(which)
    paths = [found.draw(rng, int(rng.integers(25, 81))), found.draw(rng, 200)]
    size = float(rng.choice([0.3e-3, 2e-3]))
    return session(
        "three on one axis",
        seed,
        which,
        rng,
        paths,
        errors=Errors(float(rng.choice([5e-3, 0.05])), size, size),
        noise=bool(rng.random() < 0.6),
        on_axis=bool(which.endswith("wrist") and rng.random() < 0.3),
        priors=False,
    )


SCENARIOS: Mapping[str, Callable[[int], Session]] = {
    "lines": on_paths("lines"),
    "arcs": on_paths("arcs"),
    "planes": on_paths("planes"),
    "turns by 0.1 deg": on_paths("any", np.radians(0.1)),
    "tool on last axis": tool_on_axis,
    "one joint moves": one_joint,
    "three on one axis": three_on_one_axis,
}


# ---- the judge


def held_out_rms(of: Session, fit: calib.Fit, readings: Array, positions: Array) -> float:
    """3D rms in mm between measured and predicted positions."""
    state = state_of(of.layout, fit)
    points = predict(of.layout.arm, state, readings, np.zeros(len(readings), dtype=np.intp))[0, :, :3, 3]
    return float(1e3 * np.sqrt(np.mean(np.sum((points - positions) ** 2, axis=1))))


def judge(of: Session) -> Result:
    """Let calib solve a session with the tool free, and with the tool told."""
    began = time.perf_counter()
    nan = float("nan")
    true_tool = float(np.linalg.norm(of.true.tools[0, 0, :3, 3]))
    try:
        fit = calib.identify(calib.error_model(of.robot, **of.free), of.data)
        seconds = time.perf_counter() - began
        told = dict(of.free) | {"tool": "fixed", "known": calib.Known(tools={"tool": of.true.tools[0, 0]})}
        knowing = calib.identify(calib.error_model(of.robot, **told), of.data)
    except (calib.CalibError, ArithmeticError, ValueError) as e:
        said = f"{type(e).__name__}: {e}"
        spent = time.perf_counter() - began
        return Result(
            of.scenario, of.seed, "failed", nan, nan, nan, nan, nan, true_tool, nan, *(None,) * 4, spent, said
        )
    own, other = (held_out_rms(of, found, of.held_out, of.held_out_positions) for found in (fit, knowing))
    tool = fit.machine.frames.tools[0][:3, 3]
    wrong = []
    if own > MOST_RATIO * other + 1e3 * NOTHING:
        wrong.append("held out")
    if not fit.converged:
        wrong.append("not converged")
    if fit.evaluations > MOST_EVALUATIONS:
        wrong.append("evaluations")
    return Result(
        of.scenario,
        of.seed,
        ", ".join(wrong) or "right",
        own,
        other,
        own / max(other, 1e-9),
        held_out_rms(of, fit, of.readings, of.positions),
        float(np.linalg.norm(tool)),
        true_tool,
        float(np.linalg.norm(tool - of.true.tools[0, 0, :3, 3])),
        fit.converged,
        fit.evaluations,
        fit.rank,
        fit.numerical_rank,
        seconds,
        "",
    )


def summary(results: Sequence[Result]) -> str:
    """A table of scenarios in Markdown."""
    lines = [
        "| scenario | cases | right | held out too large | not converged | evaluations too many | failed | held-out "
        "ratio: median, most | held out, mm: median | knowing the tool | tool from the flange, m: median, most | "
        "evaluations: median, most |",
        "|---|" + "--:|" * 11,
    ]
    for name in dict.fromkeys(r.scenario for r in results):
        own = [r for r in results if r.scenario == name]
        solved = [r for r in own if r.evaluations is not None]
        ratios, tools = (np.array([getattr(r, of) for r in solved] or [np.nan]) for of in ("ratio", "tool"))
        rms, other = (np.median([getattr(r, of) for r in solved] or [np.nan]) for of in ("held_out", "knowing_tool"))
        evaluations = np.array([r.evaluations for r in solved] or [0])
        counts = [
            sum(word in r.outcome for r in own) for word in ("held out", "not converged", "evaluations", "failed")
        ]
        lines.append(
            f"| {name} | {len(own)} | {sum(r.outcome == 'right' for r in own)} | {' | '.join(map(str, counts))} | "
            f"{np.median(ratios):.3f}, {ratios.max():.3g} | {rms:.4f} | {other:.4f} | {np.median(tools):.3g}, "
            f"{tools.max():.3g} | {np.median(evaluations):.0f}, {evaluations.max()} |"
        )
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=70, help="of all scenarios together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first case of every scenario")
    parser.add_argument("--only", action="append", choices=list(SCENARIOS))
    parser.add_argument("--out", type=Path, default=Path("one_orientation.csv"))
    arguments = parser.parse_args()
    chosen = arguments.only or list(SCENARIOS)
    found: list[Result] = []
    with arguments.out.open("w", encoding="utf-8", newline="") as file:
        writer: csv.DictWriter[str] | None = None
        for k in range(arguments.cases):
            seed = arguments.seed * 1_000_000 + arguments.first + k // len(chosen)
            of = SCENARIOS[chosen[k % len(chosen)]](seed)
            result = judge(of)
            row = asdict(result) | {"label": "; ".join(f"{key} {value}" for key, value in of.label.items())}
            if writer is None:
                writer = csv.DictWriter(file, list(row))
                writer.writeheader()
            writer.writerow(row)
            file.flush()
            found.append(result)
            print(
                f"{k + 1} of {arguments.cases}: {result.scenario} {seed}: {result.outcome}; held out "
                f"{result.held_out:.4g} against {result.knowing_tool:.4g} mm, tool at {result.tool:.3g} m, converged "
                f"{result.converged}, {result.evaluations} evaluations, {row['label']} {result.said}",
                file=sys.stderr,
                flush=True,
            )
    print(summary(found))
    return int(any(r.outcome != "right" for r in found))


if __name__ == "__main__":
    sys.exit(main())
