"""Sockets, lengths, gauges, planes, balls and indicators: derivatives, ranks, truths found again, and invariances."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.identification import system
from calib.identification.machine import Frames
from calib.identification.parameters import scales
from calib.identification.relations import Relation
from calib.identification.start import posed
from calib.identification.system import Problem
from calib.identification.targets import Target, unknowns
from calib.identification.machine import Layout
from calib.robot.deviation import axis_frame
from tests.identification import machines
from tests.identification.machines import Array, anywhere, pose
from tests.identification.touching import (
    ANCHOR, BALL, HEIGHTS, NORMALS, RADIUS, SOCKETS, UR10, Lab, between, lab, unit,
)

# ---- (a) derivatives

ROOT = Path(__file__).resolve().parents[2]
PARALLELOGRAM = calib.ClosedLoop("parallelogram", ("rod_end", "rear_lever_pin"), ("x", "z"), ("elbow", "rod"))
TOOLS = ("near", "far")
ROWS = 6
# Kind, extra columns, whether a length is unknown, whether the target may be known.
COLUMNS: dict[str, dict[str, list[float]]] = {
    "socket": {},
    "distance": {"length [m]": [0.7] * ROWS},
    "pair_distance": {"length [m]": [0.7] * ROWS},
    "plane": {"ball [m]": [0.004] * ROWS},
    "sphere": {"diameter [m]": [0.03] * ROWS, "ball [m]": [0.004] * ROWS},
    "indicator": {"indicated [m]": [0.01] * ROWS},
}
CASES = [
    (kind, known, offset)
    for kind in COLUMNS
    for known in ((False, True) if kind != "pair_distance" else (False,))
    for offset in ((False, True) if kind in ("distance", "pair_distance", "sphere") else (False,))
]


def robots() -> dict[str, Callable[[], tuple[calib.Robot, machines.Arm | None]]]:
    return {
        "ur10": lambda: (machines.load(*UR10), machines.arm(*UR10)),
        "skew": lambda: (machines.load(machines.INLINE["skew"], "tip"), machines.arm(machines.INLINE["skew"], "tip")),
        "loop": lambda: (
            calib.load_robot(ROOT / "robots" / "irb2400" / "irb2400.urdf", "tool0", loops=[PARALLELOGRAM]),
            None,
        ),
    }


def observed(robot: calib.Robot, q: Array, kind: str, name: str, offset: str | None) -> calib.Measurements:
    columns: dict[str, object] = {
        f"{reading.name} [{'rad' if reading.dimension == 'angle' else 'm'}]": q[:, k]
        for k, reading in enumerate(robot.readings)
    }
    columns |= {"point": (TOOLS * ROWS)[:ROWS]} | COLUMNS[kind]
    if kind == "pair_distance":
        columns["pair"] = ["p", "q", "r"] * 2
    else:
        columns["target"] = [f"{name} 1", f"{name} 2"] * (ROWS // 2)
    if offset and kind == "sphere":
        columns.pop("diameter [m]")
    return calib.read_measurements(columns, robot, kind, sigma=1e-3, offset=offset)


def at_random(
    name: str, kind: str, *, known: bool, offset: bool, dh: bool = False, relations: Sequence[Relation] = ()
) -> tuple[Problem, Array]:
    """Everything free at a point far from zero; a loop stays where it can close."""
    rng = np.random.default_rng(5)
    robot, arm = robots()[name]()
    far = 0.3 if arm is not None else 0.01
    q = rng.uniform(-0.4, 0.4, (ROWS, len(robot.readings))) if arm is None else arm.draw(rng, ROWS)
    data = observed(robot, q, kind, "t", "length" if offset else None)
    free = {"dh": "all"} if dh else {"placements": ["*"]}
    pose_of = {t: Target(anywhere(rng), kind != "indicator") for t in data.targets}
    model = calib.error_model(
        robot, offsets="all", tool="pose", targets=pose_of if known or kind == "indicator" else {}, **free
    )
    reference = Frames(
        anywhere(rng),
        np.stack([anywhere(rng, 0.3) for _ in TOOLS]),
        np.array([anywhere(rng) for _ in data.targets]).reshape(-1, 4, 4),
        np.array([0.07] * offset),
    )
    layout = Layout.of(model.robot, reference)
    parameters = (*model.parameters(TOOLS), *unknowns((data,), model.targets, layout))
    x = rng.uniform(-0.3, 0.3, len(parameters))
    x[[p.of_robot for p in parameters]] *= far / 0.3
    return Problem(model, parameters, reference, (data,), relations=tuple(relations)), x


def check(analytic: Array, of: Callable[[Array], Array], x: Array, names: Sequence[str]) -> None:
    """Analytic and numeric columns agree to 1e-6 of the column, or of 1 mm per m where a column is smaller."""
    h = 1e-5
    for k, name in enumerate(names):
        step = h * (np.arange(len(x)) == k)
        numeric = (of(x + step) - of(x - step)) / (2 * h)
        error = np.abs(analytic[:, k] - numeric).max()
        assert error <= 1e-6 * max(np.abs(numeric).max(), 1e-3), name


def check_columns(found: Problem, x: Array) -> None:
    def residuals(at: Array) -> Array:
        return system.residuals(found.model.robot, found.measurements, found.machine(at))[0].ravel()

    (J,) = system.jacobian(found, x)
    check(J.reshape(-1, len(x)), residuals, x, [parameter.name for parameter in found.parameters])


@pytest.mark.parametrize(("kind", "known", "offset"), CASES)
@pytest.mark.parametrize("name", ["ur10", "skew", "loop"])
def test_columns_match_central_differences(name: str, kind: str, known: bool, offset: bool) -> None:
    found, x = at_random(name, kind, known=known, offset=offset)
    of_targets = [parameter.name for parameter in found.parameters if parameter.kind == "target"]
    free = {"pair_distance": 0, "plane": 6, "indicator": 2}.get(kind, 6)
    assert len(of_targets) == (0 if known and kind != "indicator" else free) + offset
    check_columns(found, x)


@pytest.mark.parametrize("kind", COLUMNS)
def test_columns_of_dh_parameters_match_central_differences(kind: str) -> None:
    check_columns(*at_random("ur10", kind, known=False, offset=False, dh=True))


@pytest.mark.parametrize(
    ("kind", "of", "value"),
    [
        ("distance", "socket", 0.4),
        ("angle", "plane", 1.1),
        ("angle", "plane", 0.0),
        ("angle", "plane", np.pi),
        ("offset", "plane", -0.2),
    ],
)
def test_relations_match_central_differences(kind: str, of: str, value: float) -> None:
    relation = Relation(kind, ("t 2", "t 1"), value, 0.01)
    found, x = at_random("ur10", of, known=False, offset=False, relations=[relation])
    sigmas = [data.sigma for data in found.measurements]

    def residuals(at: Array) -> Array:
        return system.evaluate(found, sigmas, at).relations[:, -1]

    J = system.evaluate(found, sigmas, x).relations[:, :-1] / scales(found.parameters)
    assert len(J) == (2 if value in (0.0, np.pi) and kind == "angle" else 1)
    assert np.abs(J).max() > 1.0
    check(J, residuals, x, [parameter.name for parameter in found.parameters])


# ---- (b) the truth is found

KNOWN = {
    "anchor": Target(pose(ANCHOR)),
    "ball": Target(pose(BALL)),
    **{name: Target(pose(c)) for name, c in SOCKETS.items()},
    **{
        name: Target(axis_frame(unit(n)) @ pose((0.0, 0.0, HEIGHTS[name]))) for name, n in NORMALS.items()
    },
}
DIRECTION = {"floor": Target(axis_frame(unit(NORMALS["floor"])), height_is_known=False)}
Measure = Callable[[Lab], "calib.Measurements"]
# What is measured; which targets are known; whether the size is seen; rank without targets and lengths; with them.
KINDS: dict[str, tuple[Measure, dict[str, Target], bool, int, int]] = {
    "one socket": (lambda l: l.sockets(60, "a"), {}, False, 20, 3),
    "one known socket": (lambda l: l.sockets(60, "a"), {"a": KNOWN["a"]}, False, 23, 0),
    "three sockets": (lambda l: l.sockets(25), {}, False, 20, 9),
    "three known sockets": (lambda l: l.sockets(25), {n: KNOWN[n] for n in SOCKETS}, True, 27, 0),
    "bar": (lambda l: l.distances(80), {}, True, 21, 3),
    "bar of unknown length": (lambda l: l.distances(80, 0.0123, "bar"), {}, True, 21, 4),
    "bar on a known anchor": (lambda l: l.distances(80), {"anchor": KNOWN["anchor"]}, True, 24, 0),
    "gauges": (lambda l: l.pairs(80), {}, True, 21, 0),
    "gauges of unknown length": (lambda l: l.pairs(80, 0.0123, "wire"), {}, True, 21, 1),
    "one plane": (lambda l: l.planes(80), {}, False, 20, 3),
    "one plane touched by a ball": (lambda l: l.planes(80, ball=0.006), {}, False, 20, 3),
    "one known plane": (lambda l: l.planes(80), {"floor": KNOWN["floor"]}, False, 23, 0),
    "three planes": (lambda l: l.planes(40, tuple(NORMALS)), {}, False, 20, 9),
    "ball": (lambda l: l.sphere(80), {}, True, 21, 3),
    "known ball": (lambda l: l.sphere(80), {"ball": KNOWN["ball"]}, True, 24, 0),
    "ball of unknown radius": (lambda l: l.sphere(80, "ball"), {}, False, 20, 4),
    "known ball of unknown radius": (lambda l: l.sphere(80, "ball"), {"ball": KNOWN["ball"]}, False, 23, 1),
    "indicator": (lambda l: l.indicator(80), DIRECTION, True, 23, 1),
}


@pytest.mark.parametrize("name", KINDS)
def test_without_noise_the_truth_is_found_and_the_rank_is_as_tabulated(name: str) -> None:
    measure, targets, sized, rank, own = KINDS[name]
    here = lab()
    fit = calib.identify(calib.error_model(here.robot, offsets="all", placements="all", targets=targets), measure(here))
    print(fit.rank, fit.usable_rank, rank + own, fit.evaluations, here.miss(fit, sized=sized), here.miss(fit))
    assert fit.converged
    assert (fit.rank, fit.usable_rank) == (rank + own, rank + own)
    assert here.miss(fit, sized=sized) < 1e-9
    # Where the size is not seen, the nominal one is kept, and the truth is another.
    assert sized or here.miss(fit) > 1e-6
