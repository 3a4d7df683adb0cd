"""How often is an identifiable parameter more than four of its sigmas off, where a height of the tool is not seen?

    python scripts/studies/sigmas.py [--sessions 100] [--markdown docs/theory.md]

Positions do not tell how long the tool is along the parallel axes of the first four arms. Of no arm with a last joint
that turns do they tell its zero from a turn of the tool. A session has 20 to 60 of them (30 to 60 where all placements
are free), with 0.02 to 0.1 mm of noise, which is stated. The machine is off in what its model frees and in nothing
else: zeros by 3 mrad, angles by 1 to 3 mrad and lengths by 0.1 to 1 mm, one standard deviation. The tool is up to 0.2 m
longer or shorter than stated. The base leans by 1 to 10 mrad in about half of the sessions, and lies anyhow in the
others.

Counted are the sessions of which a parameter is more than four sigmas off, and those of which one is more than four
times the noise's part of its sigma off. The same sessions with learned priors follow: there a share of parameters is
counted, as one width is the sigma of all that do not show. --markdown writes the tables into a page, between the
comments that name this script. Machines are made and walked by scripts/development/judge_machines.py: nothing of
calib's mathematics.
"""

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from scipy.spatial.transform import Rotation

import calib
from calib.foundations.linear import one_thread
from calib.robot.urdf import parse_urdf
from scripts.development.judge_cases import pose
from scripts.development.judge_machines import (
    COMPONENTS,
    Arm,
    Array,
    Layout,
    State,
    arm,
    placed,
    predict,
    rx_ry_rz,
)
from scripts.studies.blame import write

FAR = 4.0
# Residuals of so many times the variance of the noise are of no least-squares solution.
MISFIT = 2.0
# One standard deviation, or the range that it is drawn from.
ZERO, ANGLES, LENGTHS = 3e-3, (1e-3, 3e-3), (0.1e-3, 1e-3)
LEANS, SIGMAS = (1e-3, 10e-3), (0.02e-3, 0.1e-3)
# Of the tool: beside the tip and along it, and by how much what is stated is off there.
BESIDE, ALONG, BESIDE_OFF, ALONG_OFF = 0.03, (0.0, 0.1), 2e-3, 0.2
TIP = "tip"
BEGIN, END = "<!-- scripts/studies/sigmas.py -->", "<!-- end -->"


@dataclass(frozen=True)
class Joint:
    """A joint about or along the z of its origin; ``follows``: a joint whose travel it undoes, as parallelograms do."""

    name: str
    kind: str
    xyz: tuple[float, float, float]
    limits: tuple[float, float]
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    follows: str | None = None


def turns(name: str, *xyz: float, within: float = 2.4) -> Joint:
    """A vertical axis."""
    x, y, z = xyz
    return Joint(name, "revolute", (x, y, z), (-within, within))


def slides(name: str, *xyz: float, within: tuple[float, float]) -> Joint:
    """A vertical slide."""
    x, y, z = xyz
    return Joint(name, "prismatic", (x, y, z), within)


def levels(name: str, of: str, x: float, y: float) -> Joint:
    """An axis parallel to that of another joint, whose turn it undoes."""
    return Joint(name, "revolute", (x, y, 0.0), (-3.0, 3.0), follows=of)


UP, DOWN = (np.pi / 2, 0.0, 0.0), (-np.pi / 2, 0.0, 0.0)
ARMS = {
    "SCARA": (
        turns("shoulder", 0.0, 0.0, 0.4, within=2.3),
        turns("elbow", 0.35, 0.0, 0.05),
        slides("quill", 0.3, 0.0, 0.0, within=(-0.25, 0.0)),
        turns("wrist", 0.0, 0.0, -0.1, within=3.0),
    ),
    "lift, then three parallel axes": (
        slides("lift", 0.0, 0.0, 0.4, within=(0.0, 0.4)),
        turns("shoulder", 0.1, 0.0, 0.05),
        turns("elbow", 0.4, 0.0, 0.0),
        turns("wrist", 0.35, 0.0, -0.1, within=3.0),
    ),
    "three parallel axes, then a quill": (
        turns("shoulder", 0.0, 0.0, 0.4, within=2.3),
        turns("elbow", 0.35, 0.0, 0.05),
        turns("wrist", 0.3, 0.0, 0.0),
        slides("quill", 0.1, 0.0, -0.1, within=(-0.2, 0.0)),
    ),
    "palletiser with two parallelograms": (
        turns("waist", 0.0, 0.0, 0.7, within=2.5),
        Joint("shoulder", "revolute", (0.3, 0.0, 0.2), (-1.0, 0.6), DOWN),
        levels("shoulder_level", "shoulder", 0.0, -0.9),
        Joint("elbow", "revolute", (0.05, 0.0, 0.0), (-0.5, 1.0)),
        levels("elbow_level", "elbow", 0.9, 0.0),
        Joint("flange", "revolute", (0.2, 0.1, 0.0), (-3.0, 3.0), UP),
    ),
    "6R arm in random poses": (
        turns("waist", 0.0, 0.0, 0.128, within=3.0),
        Joint("shoulder", "revolute", (0.0, 0.0, 0.0), (-2.2, -0.5), UP),
        Joint("elbow", "revolute", (-0.612, 0.0, 0.0), (0.6, 2.3)),
        Joint("wrist_1", "revolute", (-0.572, 0.0, 0.0), (-3.0, 3.0)),
        Joint("wrist_2", "revolute", (0.0, 0.0, 0.164), (-3.0, 3.0), UP),
        Joint("wrist_3", "revolute", (0.0, 0.0, 0.116), (-3.0, 3.0), DOWN),
    ),
}
# By what is free: the placements of the model, and the components that are off.
PLACEMENTS: dict[str, tuple[str | list[str], tuple[str, ...]]] = {
    "offsets": ("none", ()),
    "offsets and tilts": (["*.rx", "*.ry"], ("rx", "ry")),
    "offsets and placements": ("all", COMPONENTS),
}
FEWEST, MOST = {"offsets": 20, "offsets and tilts": 20, "offsets and placements": 30}, 60


def urdf(joints: Sequence[Joint]) -> str:
    """The text of a URDF."""
    links = ["base", *(f"after_{joint.name}" for joint in joints[:-1]), TIP]
    text = [f'<link name="{link}"/>' for link in links]
    for joint, parent, child in zip(joints, links[:-1], links[1:], strict=True):
        origin = " ".join(
            f'{name}="{" ".join(map(str, value))}"' for name, value in (("xyz", joint.xyz), ("rpy", joint.rpy))
        )
        low, high = joint.limits
        text += [
            f'<joint name="{joint.name}" type="{joint.kind}"><parent link="{parent}"/><child link="{child}"/>',
            f'<origin {origin}/><axis xyz="0 0 1"/>',
            f'<limit lower="{low}" upper="{high}" effort="1" velocity="1"/>',
            f'<mimic joint="{joint.follows}" multiplier="-1"/>' if joint.follows is not None else "",
            "</joint>",
        ]
    return f'<robot name="arm">{"".join(text)}</robot>'


# ---- a session


def machine(rng: np.random.Generator, found: Arm, off: Sequence[str]) -> State:
    """A machine somewhere before the instrument, of which zeros and some components of placements are off.

    A zero of a joint that follows another is the turn of its placement about its own axis.
    """
    length, angle = rng.uniform(*LENGTHS), rng.uniform(*ANGLES)
    d = np.zeros((1, len(found.joints), 6))
    zeros = dict.fromkeys(found.ranges, 0.0)
    for j, joint in enumerate(found.joints):
        own = "rz" if joint.kind == "revolute" else "tz"
        for c, component in enumerate(COMPONENTS):
            if component in off and component != own:
                d[0, j, c] = rng.normal(scale=length if component.startswith("t") else angle)
        zero = rng.normal(scale=ZERO if joint.kind == "revolute" else length)
        if joint.name in zeros:
            zeros[joint.name] = zero
        else:
            d[0, j, COMPONENTS.index(own)] = zero
    base = pose(rng, 3.0)
    if rng.integers(2):
        lean = Rotation.from_rotvec([*rng.normal(scale=rng.uniform(*LEANS), size=2), rng.uniform(-3.0, 3.0)])
        base = placed(lean.as_matrix(), base[:3, 3])
    tool = np.array([*rng.normal(scale=BESIDE, size=2), rng.uniform(*ALONG)])
    return State(
        d,
        np.array([list(zeros.values())]),
        base[None],
        placed(np.eye(3), tool)[None, None],
        np.zeros((1, 0, 4, 4)),
    )


def true_values(found: Arm, true: State, fit: calib.Fit) -> Array:
    """The true values (p,) of the parameters of a fit."""
    base = fit.machine.frames.bases[0]
    stated = base[:3, :3] @ rx_ry_rz(np.array([fit.value(f"base.{c}") for c in COMPONENTS[3:]])).T
    at = State(true.deviations, true.offsets, placed(stated, np.zeros(3))[None], true.tools, true.targets)
    names = []
    for parameter in fit.parameters:
        head, _, component = parameter.name.rpartition(".")
        follows = component == "offset" and head not in found.ranges
        names.append(f"{head}.rz" if follows else parameter.name)
    return Layout(found, tuple(names), at, ("tool",), ()).values(true)


@dataclass(frozen=True)
class Session:
    """The identifiable parameters of one session, each with its sigma in SI units.

    ``off``: by how many sigmas they are off, and ``off_by_noise``: by how many of the noise's part of a sigma.
    ``misfits``: whether the search has ended elsewhere than at the least-squares solution.
    """

    names: tuple[str, ...]
    sigmas: Array
    off: Array
    off_by_noise: Array
    misfits: bool


class Measured(NamedTuple):
    """The model and the data of a session, and what is true of them."""

    model: calib.ErrorModel
    data: calib.Measurements
    arm: Arm
    true: State


def measured(which: str, free: str, seed: int, *, learned: bool = False) -> Measured:
    """Measure a machine with a tool that is stated wrongly; the model may have priors of ``learned`` widths."""
    rng = np.random.default_rng([seed, *which.encode(), *free.encode()])
    text, (placements, off) = urdf(ARMS[which]), PLACEMENTS[free]
    found, robot = arm(text, TIP), calib.load_robot(parse_urdf(text.encode(), "arm.urdf"), TIP)
    true = machine(rng, found, off)
    stated = true.tools[0, 0, :3, 3] + [*rng.normal(scale=BESIDE_OFF, size=2), rng.uniform(-ALONG_OFF, ALONG_OFF)]
    n, sigma = int(rng.integers(FEWEST[free], MOST + 1)), rng.uniform(*SIGMAS)
    readings = found.draw(rng, n)
    seen = predict(found, true, readings, np.zeros(n, dtype=np.intp))[0, :, :3, 3] + rng.normal(
        scale=sigma, size=(n, 3)
    )
    units = {joint.name: "rad" if joint.kind == "revolute" else "m" for joint in found.joints}
    columns: dict[str, Any] = {f"{name} [{units[name]}]": readings[:, k] for k, name in enumerate(found.ranges)}
    columns |= {f"{axis} [m]": seen[:, k] for k, axis in enumerate("xyz")}
    data = calib.read_measurements(columns, robot, "position", sigma=sigma)
    model = calib.error_model(
        robot,
        offsets="all",
        placements=placements,
        known=calib.Known(tools={"tool": list(stated)}),
        priors=calib.Priors(length="learned", angle="learned") if learned else calib.Priors(),
    )
    return Measured(model, data, found, true)


def session(which: str, free: str, seed: int, *, learned: bool = False) -> Session:
    """Measure, identify, and compare with the truth; with priors of ``learned`` widths their parameters alone."""
    of = measured(which, free, seed, learned=learned)
    fit = calib.identify(of.model, of.data)
    own = ~fit.unidentifiable
    if learned:
        own &= [parameter.group is not None for parameter in fit.parameters]
    names = tuple(parameter.name for parameter, is_ in zip(fit.parameters, own, strict=True) if is_)
    errors = (fit.values - true_values(of.arm, of.true, fit))[own]
    return Session(
        names,
        fit.sigmas[own],
        errors / fit.sigmas[own],
        errors / np.sqrt(fit.spread.variances[own]),
        fit.noise[0].chi_square > MISFIT,
    )


# ---- the table


@dataclass(frozen=True)
class Counts:
    """Of sessions of a kind, in how many some parameter was far off, and how many misfit.

    ``parameters``: identifiable ones of all sessions, ``parameters_far`` of them far off.
    """

    far: int
    far_by_noise: int
    misfits: int
    parameters: int
    parameters_far: int


def counted(which: str, free: str, sessions: int, *, learned: bool = False) -> Counts:
    """Simulate sessions of a kind; those that are far off are printed."""
    far = far_by_noise = misfits = parameters = parameters_far = 0
    kind = f"{which}, {free}{', learned' if learned else ''}"
    for seed in range(sessions):
        found = session(which, free, seed, learned=learned)
        parameters += len(found.names)
        misfits += found.misfits
        beyond = np.abs(found.off) > FAR
        far += bool(np.any(beyond))
        parameters_far += int(np.count_nonzero(beyond))
        far_by_noise += bool(np.any(np.abs(found.off_by_noise) > FAR))
        for k in np.flatnonzero(beyond):
            print(
                f"{kind}, session {seed}: {found.names[k]} off by {found.off[k]:.1f} sigmas of {found.sigmas[k]:.2g}",
                flush=True,
            )
    return Counts(far, far_by_noise, misfits, parameters, parameters_far)


def table(found: Mapping[tuple[str, str], Counts]) -> str:
    """The counts of all kinds of sessions."""
    return _rows(found, lambda counts: f"{counts.far} ({counts.far_by_noise})")


def table_of_shares(found: Mapping[tuple[str, str], Counts]) -> str:
    """The shares of parameters that are far off."""
    return _rows(found, lambda counts: f"{counts.parameters_far / counts.parameters:.1%}".replace("%", " %"))


def _rows(found: Mapping[tuple[str, str], Counts], told: Callable[[Counts], str]) -> str:
    lines = [f"| arm | {' | '.join(PLACEMENTS)} |", f"|---{'|--:' * len(PLACEMENTS)}|"]
    lines += (f"| {which} | {' | '.join(told(found[which, free]) for free in PLACEMENTS)} |" for which in ARMS)
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=100, help="of every kind (default: 100)")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="also write the table into this page")
    arguments = parser.parse_args()
    with one_thread():
        found = {kind: counted(*kind, arguments.sessions) for kind in product(ARMS, PLACEMENTS)}
        learned = {kind: counted(*kind, arguments.sessions, learned=True) for kind in product(ARMS, PLACEMENTS)}
    parameters = sum(counts.parameters for counts in found.values())
    misfits = sum(counts.misfits for counts in found.values())
    text = (
        f"{table(found)}\n\n{arguments.sessions} sessions of each kind, {parameters} identifiable parameters in all.\n"
        f"The variance of the residuals is more than twice that of the noise in {misfits} sessions.\n\n"
        f"With learned priors, of the parameters that have these so many are more than 4 sigma off:\n\n"
        f"{table_of_shares(learned)}"
    )
    print(text)
    if arguments.markdown is not None:
        write(arguments.markdown, f"\n{text}\n", BEGIN, END)
    return 0


if __name__ == "__main__":
    sys.exit(main())
