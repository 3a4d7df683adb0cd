"""Sockets, lengths, gauges, planes, balls and indicators: derivatives, ranks, truths found again, and invariances."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calib
from calib.foundations.errors import JobError
from calib.identification import system
from calib.identification.initialisation.problem import initial_problem
from calib.identification.losses import scatter_weight, shrinkage, weight
from calib.identification.machine import Frames, Layout
from calib.identification.observability import observability, rank_findings
from calib.identification.parameters import scales
from calib.identification.relations import Relation
from calib.identification.system import Problem
from calib.identification.targets import Target, unknowns
from calib.robot.robot import TipModel
from tests.support import jacobians, machines
from tests.support.machines import Array, anywhere, pose
from tests.support.touching import NORMALS, RADIUS, SOCKETS, UR10, Lab, between, lab

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
    columns |= {"tool": (TOOLS * ROWS)[:ROWS]} | COLUMNS[kind]
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
    model = machines.model(
        robot, offsets="all", tool="pose", targets=pose_of if known or kind == "indicator" else {}, **free
    )
    reference = Frames(
        anywhere(rng)[None],
        np.stack([anywhere(rng, 0.3) for _ in TOOLS]),
        np.array([anywhere(rng) for _ in data.targets]).reshape(-1, 4, 4),
        np.array([0.07] * offset),
    )
    layout = Layout.of(model.robot, reference)
    parameters = (*model.parameters(TOOLS), *unknowns((data,), model.targets, layout))
    x = rng.uniform(-0.3, 0.3, len(parameters))
    x[[p.of_robot for p in parameters]] *= far / 0.3
    x = np.where([p.kind == "instrument" for p in parameters], np.abs(x), x)  # no ball has a radius below zero
    return Problem(model, parameters, reference, (data,), relations=tuple(relations)), x


@pytest.mark.parametrize(("kind", "known", "offset"), CASES)
@pytest.mark.parametrize("name", ["ur10", "skew", "loop"])
def test_columns_match_central_differences(name: str, kind: str, known: bool, offset: bool) -> None:
    found, x = at_random(name, kind, known=known, offset=offset)
    of_targets = [parameter.name for parameter in found.parameters if parameter.nuisance]
    free = {"pair_distance": 0, "plane": 6, "indicator": 2}.get(kind, 6)
    assert len(of_targets) == (0 if known and kind != "indicator" else free) + offset
    # Differences bend on a small ball, and where a loop is led towards what is out of its reach.
    jacobians.check(found, x, *((1e-6, 5e-6, 1e-2) if kind == "sphere" or name == "loop" else ()))


@pytest.mark.parametrize("kind", COLUMNS)
def test_columns_of_dh_parameters_match_central_differences(kind: str) -> None:
    jacobians.check(*at_random("ur10", kind, known=False, offset=False, dh=True))


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
    jacobians.compare(J, residuals, x, [parameter.name for parameter in found.parameters])


# ---- (b) the truth is found

Measure = Callable[[Lab], "calib.Measurements"]
# What is measured; which targets are known; whether the size is seen; rank without targets and lengths; number of them.
KINDS: dict[str, tuple[Measure, tuple[str, ...], bool, int, int]] = {
    "one socket": (lambda at: at.sockets(60, "a"), (), False, 20, 3),
    "one known socket": (lambda at: at.sockets(60, "a"), ("a",), False, 23, 0),
    "three sockets": (lambda at: at.sockets(25), (), False, 20, 9),
    "three known sockets": (lambda at: at.sockets(25), tuple(SOCKETS), True, 27, 0),
    "bar": (lambda at: at.distances(80), (), True, 21, 3),
    "bar of unknown length": (lambda at: at.distances(80, 0.0123, "bar"), (), True, 21, 4),
    "bar on a known anchor": (lambda at: at.distances(80), ("anchor",), True, 24, 0),
    "gauges": (lambda at: at.pairs(80), (), True, 21, 0),
    "gauges of unknown length": (lambda at: at.pairs(80, 0.0123, "wire"), (), True, 21, 1),
    "one plane": (lambda at: at.planes(80), (), False, 20, 3),
    "one plane touched by a ball": (lambda at: at.planes(80, ball=0.006), (), False, 20, 3),
    "one known plane": (lambda at: at.planes(80), ("floor",), False, 23, 0),
    "three planes": (lambda at: at.planes(40, tuple(NORMALS)), (), False, 20, 9),
    "ball": (lambda at: at.sphere(80), (), True, 21, 3),
    "known ball": (lambda at: at.sphere(80), ("ball",), True, 24, 0),
    "ball of unknown radius": (lambda at: at.sphere(80, "ball"), (), False, 20, 4),
    "known ball of unknown radius": (lambda at: at.sphere(80, "ball"), ("ball",), False, 23, 1),
    "indicator": (lambda at: at.indicator(80), ("floor",), True, 23, 1),
}


def model(here: Lab, known: Sequence[str] = (), *, height_is_known: bool = True, **options: object) -> calib.ErrorModel:
    targets = {n: replace(t, height_is_known=height_is_known) for n, t in here.known(*known).items()}
    return machines.model(here.robot, **({"offsets": "all", "placements": "all", "targets": targets} | options))


def fitted(here: Lab, name: str, **options: object) -> calib.Fit:
    measure, known, _, _, _ = KINDS[name]
    return calib.identify(model(here, known, height_is_known=name != "indicator"), measure(here), **options)


@pytest.mark.parametrize("name", KINDS)
def test_without_noise_the_truth_is_found_and_the_rank_is_as_tabulated(name: str) -> None:
    _, _, sized, rank, own = KINDS[name]
    here = lab(3)
    fit = fitted(here, name)
    assert fit.converged
    assert fit.evaluations <= 8
    assert (fit.rank, fit.numerical_rank) == (rank + own, rank + own)
    assert here.miss(fit, sized=sized) < 1e-9
    # Where the size is not identifiable, the nominal one is kept, and the truth is another.
    assert sized or here.miss(fit) > 1e-6


@pytest.mark.parametrize("name", KINDS)
def test_noise_makes_nothing_seen(name: str) -> None:
    """A machine shrunk to a point explains every socket, and a turn turns residuals: neither counts as seen."""
    _, _, sized, rank, own = KINDS[name]
    here = lab(3, noise=3e-5)
    fit = fitted(here, name)
    assert fit.converged
    assert fit.evaluations <= 9
    assert (fit.rank, fit.numerical_rank) == (rank + own, rank + own)
    assert here.miss(fit, sized=sized) < 2e-4


@pytest.mark.parametrize(
    ("name", "rank"), [("one socket", 20 + 3), ("three sockets", 20 + 9), ("one known socket", 23)]
)
def test_the_rank_is_told_before_solving(name: str, rank: int) -> None:
    """At the nominal robot, which misses the sockets by millimetres."""
    here = lab(3)
    measure, known, _, _, _ = KINDS[name]
    assert observability(model(here, known), [measure(here)]).rank == rank


@pytest.mark.parametrize(
    ("name", "component", "truth"),
    [
        ("bar of unknown length", "length.bar.offset", 0.0123),
        ("gauges of unknown length", "length.wire.offset", 0.0123),
        ("known ball of unknown radius", "length.ball.radius", RADIUS),
    ],
)
def test_unknown_lengths_are_found(name: str, component: str, truth: float) -> None:
    here = lab(1)
    found = fitted(here, name).value(component)
    # A radius is found as far as the size is: the placements are off by parts in a thousand.
    assert found == pytest.approx(truth, abs=1e-10) if "ball" not in name else found == pytest.approx(truth, rel=2e-3)


@pytest.mark.parametrize(("names", "rank"), [(("a", "b"), 21 + 6), (("a", "b", "c"), 21 + 9)])
def test_known_distances_between_sockets_give_the_size(names: tuple[str, ...], rank: int) -> None:
    here = lab(2)
    pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
    fit = calib.identify(model(here, relations=[between("distance", a, b) for a, b in pairs]), here.sockets(40, names))
    assert (fit.rank, fit.numerical_rank) == (rank, rank)
    assert here.miss(fit) < 1e-9


def test_known_angles_between_planes_give_no_size() -> None:
    here = lab(2)
    names = tuple(NORMALS)
    relations = [between("angle", a, b) for a, b in (names[:2], names[1:])]
    fit = calib.identify(model(here, relations=relations), here.planes(40, names))
    assert fit.rank == 20 + 9
    assert here.miss(fit, sized=False) < 1e-9 < here.miss(fit)


def test_a_known_step_between_parallel_planes_gives_the_size() -> None:
    here = lab(2)
    lower, upper = here.planes(60), here.planes(60, raised=0.08)
    upper = replace(upper, targets=("shelf",))
    relations = [Relation("angle", ("floor", "shelf"), 0.0, 1e-7), Relation("offset", ("floor", "shelf"), 0.08, 1e-7)]
    fit = calib.identify(model(here, relations=relations), [lower, upper])
    assert fit.rank == 21 + 6
    assert here.miss(fit) < 1e-9


def test_many_planes_begin_with_as_few_looks_at_the_arm_as_one(monkeypatch: pytest.MonkeyPatch) -> None:
    here, looks = lab(), 0
    look = TipModel.motion

    def counted(self: TipModel, *given: Any) -> Any:
        nonlocal looks
        looks += 1
        return look(self, *given)

    monkeypatch.setattr(TipModel, "motion", counted)
    needed = []
    for names in (("floor",), tuple(NORMALS)):
        looks = 0
        initial_problem(model(here), [here.planes(40, names)])
        needed.append(looks)
    assert needed[0] == needed[1] > 0


@pytest.mark.parametrize(("name", "rank"), [("one socket", 18 + 3), ("one plane", 18 + 3), ("gauges", 19)])
def test_a_tool_point_on_the_last_axis_is_seen_less_often(name: str, rank: int) -> None:
    """A perfect arm whose point stays when the last joint turns: neither its zero nor where the point points to."""
    here = lab(4)
    arm, tools = machines.arm(*UR10), {"tool": pose((0.0, 0.0, 0.15))}
    perfect = Lab(replace(here.machine, arm=arm, tools=tools), here.robot, here.rng)
    guess = {"tool": tools["tool"]}
    seen = observability(model(perfect, tool_poses=guess), [KINDS[name][0](perfect)])
    assert seen.rank == rank


def test_two_tool_points_share_a_socket() -> None:
    here = lab(5)
    fit = calib.identify(model(here), [here.sockets(40, "a"), here.sockets(40, "ab", "long")])
    # The second point adds three of its own.
    assert fit.rank == fit.numerical_rank == 20 + 3 + 6
    assert here.miss(fit, sized=False) < 1e-9


COVERED = ("one socket", "three known sockets", "bar of unknown length", "gauges", "one plane", "ball", "indicator")


def test_with_noise_the_truth_is_within_the_intervals() -> None:
    """A minimal set is kept; its true values are those that noise-free measurements of the same machine give."""
    off = []
    for name in COVERED:
        for seed in range(2):
            truth, found = (fitted(lab(seed, noise=noise), name, null_space="minimal") for noise in (0.0, 3e-5))
            assert found.converged
            assert [p.name for p in found.held] == [p.name for p in truth.held]
            # Planes are named relative to where they start, which differs.
            compared = [k for k, p in enumerate(found.parameters) if p.kind != "target" or "length" in p.name]
            off += list(((found.values - truth.values) / found.sigmas)[compared])
    assert len(off) > 200
    assert 0.90 <= np.mean(np.abs(off) < 1.96) <= 0.99


# ---- (d) invariances

EVERY = ("position", "socket", "distance", "pair", "plane", "sphere", "indicator")


def everything(here: Lab) -> list[calib.Measurements]:
    """Sets of all kinds."""
    return [
        here.positions(20),
        here.sockets(15),
        here.distances(20, 0.0123, "bar"),
        here.pairs(15, 0.01, "wire"),
        here.planes(15, ("left", "front")),
        here.sphere(25, "ball"),
        here.indicator(15),
    ]


def robot_values(fit: calib.Fit) -> Array:
    return np.array([v for p, v in zip(fit.parameters, fit.values, strict=True) if p.of_robot])


def fit_of_all(here: Lab, sets: Sequence[calib.Measurements]) -> calib.Fit:
    known = here.known("b", "left") | {"floor": replace(here.known("floor")["floor"], height_is_known=False)}
    relations = [between("distance", "a", "c", 1e-5), between("angle", "left", "front", 1e-5)]
    return calib.identify(model(here, targets=known, relations=relations), sets)


@pytest.fixture(scope="module")
def all_kinds() -> tuple[Lab, list[calib.Measurements], calib.Fit]:
    here = lab(6, noise=3e-5)
    sets = everything(here)
    return here, sets, fit_of_all(here, sets)


def test_all_kinds_in_one_solve(all_kinds: tuple[Lab, list[calib.Measurements], calib.Fit]) -> None:
    here, _, fit = all_kinds
    assert fit.converged
    assert here.miss(fit) < 1e-4


def test_the_order_of_the_rows_changes_nothing(all_kinds: tuple[Lab, list[calib.Measurements], calib.Fit]) -> None:
    here, sets, fit = all_kinds
    rng = np.random.default_rng(0)
    orders = [rng.permutation(len(data)) for data in sets]
    other = fit_of_all(here, [data.subset(order) for data, order in zip(sets, orders, strict=True)])
    np.testing.assert_allclose(robot_values(other), robot_values(fit), atol=1e-9)
    for r, s, order in zip(other.residuals, fit.residuals, orders, strict=True):
        np.testing.assert_allclose(r, s[order], atol=1e-9)


def test_the_order_of_the_sets_changes_nothing(all_kinds: tuple[Lab, list[calib.Measurements], calib.Fit]) -> None:
    here, sets, fit = all_kinds
    np.testing.assert_allclose(robot_values(fit_of_all(here, sets[::-1])), robot_values(fit), atol=1e-9)


def test_moving_the_world_changes_nothing(all_kinds: tuple[Lab, list[calib.Measurements], calib.Fit]) -> None:
    _, _, fit = all_kinds
    there = lab(6, noise=3e-5, base=anywhere(np.random.default_rng(1)))
    np.testing.assert_allclose(robot_values(fit_of_all(there, everything(there))), robot_values(fit), atol=1e-9)


@pytest.mark.parametrize("name", ["three sockets", "one known plane", "ball of unknown radius", "gauges"])
def test_rows_and_targets_may_be_called_anything(name: str) -> None:
    measure, known, _, _, _ = KINDS[name]
    here = lab(7, noise=3e-5)
    data = measure(here)
    fit = calib.identify(model(here, known), data)
    other = replace(data, targets=tuple(f"my {t}" for t in data.targets), tools=("ball 3",))
    targets = {f"my {t}": known_one for t, known_one in here.known(*known).items()}
    renamed = calib.identify(model(here, targets=targets), other.subset(np.arange(len(data))[::-1]))
    np.testing.assert_allclose(robot_values(renamed), robot_values(fit), atol=1e-9)
    np.testing.assert_allclose(renamed.residuals[0][::-1], fit.residuals[0], atol=1e-9)


# ---- (e) mixing


def test_a_mixture_beats_each_of_its_parts() -> None:
    """30 tracker positions, 60 touches of sockets, 20 lengths of a ball bar; priors let each alone have an answer."""
    missed = []
    for seed in range(3):
        here = lab(seed, noise=5e-5)
        parts = [here.positions(30), here.sockets(20), here.distances(20)]
        expected = model(here, prior_length=0.5e-3, prior_angle=5e-3)
        missed.append([here.miss(calib.identify(expected, sets)) for sets in (parts, *([part] for part in parts))])
    mixed, *alone = np.mean(missed, axis=0)
    assert mixed < 0.8 * min(alone)


# ---- (f) robust losses

LOSSES = ("huber", "soft_l1", "cauchy")


def with_outliers(here: Lab, data: calib.Measurements) -> calib.Measurements:
    """Every twentieth row is off by some millimetres."""
    wrong = np.arange(len(data)) % 20 == 3
    if data.position is not None:
        return replace(data, position=data.position + wrong[:, None] * here.rng.normal(scale=5e-3, size=(len(data), 3)))
    return replace(data, value=data.value + wrong[:, None] * here.rng.normal(scale=5e-3, size=(len(data), 1)))


@pytest.mark.parametrize("kind", ["positions", "distances"])
def test_losses_with_and_without_outliers(kind: str) -> None:
    noise = 5e-5
    clean, spoilt, scatter = [], [], []
    for seed in range(2):
        here = lab(seed, noise=noise)
        data = replace(getattr(here, kind)(150), sigma=np.zeros((150, 3 if kind == "positions" else 1)))
        bad = with_outliers(here, data)
        fits = [[calib.identify(model(here), d, losses=[loss]) for loss in ("linear", *LOSSES)] for d in (data, bad)]
        assert all(fit.converged for row in fits for fit in row)
        clean.append([here.miss(fit) for fit in fits[0]])
        spoilt.append([here.miss(fit) for fit in fits[1]])
        scatter.append([[fit.noise[0].model for fit in row] for row in fits])
    linear, *robust = np.mean(clean, axis=0)
    assert max(robust) < 1.2 * linear
    linear, *robust = np.mean(spoilt, axis=0)
    assert max(robust) < 0.3 * linear
    on_clean, on_spoilt = np.mean(scatter, axis=0) / noise
    np.testing.assert_allclose(on_clean, 1.0, atol=0.15)
    assert on_spoilt[0] > 5.0
    assert np.all(on_spoilt[1:] < 1.8)


@pytest.mark.parametrize("d", [1, 3, 6])
@pytest.mark.parametrize("loss", ["linear", *LOSSES])
def test_shrinkage_is_that_of_simulated_rows(loss: str, d: int) -> None:
    r = np.random.default_rng(d).normal(size=(200_000, d))
    t = np.sqrt(np.mean(r**2, axis=1))
    simulated = np.mean(scatter_weight(loss, t) * t**2) / np.mean(t**2)
    assert shrinkage(loss, d) == pytest.approx(simulated, rel=5e-3)
    assert (shrinkage(loss, d) < 1.0) == (loss != "linear")


def test_weights_fall_from_one_to_nothing() -> None:
    t = np.linspace(0.0, 50.0, 500)
    for loss in LOSSES:
        found = weight(loss, t)
        assert found[0] == 1.0
        assert np.all(np.diff(found) <= 0.0)
        assert found[-1] < 0.03


# ---- what cannot be


def test_losses_are_one_for_each_set() -> None:
    here = lab()
    with pytest.raises(JobError, match=r"^2 losses are given for 1 sets of measurements\.$"):
        calib.identify(model(here), here.positions(20), losses=["huber", "huber"])
    with pytest.raises(JobError, match=r"^losses: 'hubert' is not one of linear, huber, soft_l1, cauchy\.$"):
        calib.identify(model(here), here.positions(20), losses=["hubert"])


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("distance", ("a", "b"), 1.0, 0.0), "sigma is 0 m; allowed is 1e-06 to 1000 mm."),
        (("distance", ("a", "b"), -1.0, 1.0), "the distance is -1 m; allowed is 0 to 10000 m."),
        (("offset", ("a", "b"), np.nan, 1.0), "the offset is nan m; allowed is -10000 to 10000 m."),
        (("angle", ("a", "a"), 1.0, 1.0), "is one target; a relation is between two."),
    ],
)
def test_relations_that_cannot_be(arguments: tuple[object, ...], sentence: str) -> None:
    with pytest.raises(JobError) as e:
        Relation(*arguments)
    assert str(e.value) == f"relation of {arguments[1]}: {sentence}"


def test_an_offset_between_planes_may_be_negative() -> None:
    assert Relation("offset", ("a", "b"), -1.0, 1.0).value == -1.0


# ---- what is said before solving


@pytest.mark.parametrize(
    ("kind", "options", "said"),
    [
        ("sockets", {}, ["size-unseen", "base-unseen"]),
        ("sockets", {"base": "fixed"}, ["size-unseen"]),
        ("sockets", {"relations": [between("distance", "a", "b")]}, ["base-unseen"]),
        ("sockets", {"base": "fixed", "placements": "none"}, []),  # nothing of the size is free
        ("planes", {}, ["size-unseen", "base-unseen"]),
        ("distances", {}, ["base-unseen"]),
        ("pairs", {"base": "fixed"}, []),
        ("positions", {}, []),
    ],
)
def test_what_cannot_be_seen_is_said(kind: str, options: dict[str, object], said: list[str]) -> None:
    here = lab()
    found = rank_findings(model(here, **options), [getattr(here, kind)(25)])
    assert [finding.code for finding in found] == said
    assert {finding.severity for finding in found} <= {"warning"}


def test_a_few_positions_reveal_size_and_base() -> None:
    here = lab()
    assert not rank_findings(model(here), [here.sockets(20), here.positions(5)])
