"""Size and proportions of a machine that only touches: a smaller machine leaves less of the same noise.

The truth is that of :mod:`tests.support.touching`, which has none of calib's kinematics.
"""

from collections.abc import Sequence

import numpy as np
import pytest

import calib
from calib.assessment.checks import of_arm, of_rows
from calib.assessment.effects import gains
from calib.assessment.influence import Residue
from calib.assessment.stretches import stretches
from calib.foundations import rigid
from calib.identification.observability import rank_findings
from calib.identification.relations import Relation
from calib.machine.tool_uncertainty import link_errors
from calib.presentation.sheets import rank_sentences
from calib.robot.conditions import ordinary
from tests.support import machines
from tests.support.machines import Array
from tests.support.touching import UR10, Lab, lab, unit

NOISE = 5e-5
SCARA = (machines.INLINE["scara"], "tip")


def sockets(made: Lab, touches: int = 15) -> tuple[calib.Measurements, Array]:
    """Four sockets in random places, and these (4, 3)."""
    places = np.array([made.where(made.draw(1))[0] for _ in range(4)])
    q = [made.touching(lambda x, c=c: x - c, made.scatter(touches, 3)) for c in places]
    return made.read(np.concatenate(q), "socket", target=np.repeat(list("abcd"), touches).tolist()), places


def planes(made: Lab, touches: int = 30) -> calib.Measurements:
    """A level plane and three others, at heights that are within reach."""
    normals = [np.array([0.0, 0.0, 1.0]), *(unit(made.rng.normal(size=3)) for _ in range(3))]
    q = []
    for n in normals:
        height = float(n @ made.where(made.draw(1))[0])
        q.append(made.touching(lambda x, n=n, h=height: (x @ n - h)[:, None], made.scatter(touches, 1)))
    count = 4 * touches
    return made.read(
        np.concatenate(q), "plane", target=np.repeat(list("abcd"), touches).tolist(), ball_m=np.zeros(count)
    )


def fitted(made: Lab, data: calib.Measurements, relations: Sequence[Relation] = ()) -> calib.Fit:
    known = calib.Known(relations=list(relations))
    return calib.identify(
        calib.error_model(made.robot, offsets="all", placements="all", base="fixed", known=known), data
    )


def off_and_stated(made: Lab, fit: calib.Fit) -> tuple[float, float]:
    """By how much predicted tool points are off, 3D rms in m beside rigid motions, and how much that is said to be."""
    q, machine = made.draw(300), calib.assess(fit).machine
    x = made.where(q)
    by_doubt = link_errors(machine, q, next(iter(machine.tools)), tool_pose=True, conditions=ordinary(q))[0][:, :3]
    rigidly = np.linalg.qr(
        np.concatenate([np.broadcast_to(np.eye(3), (300, 3, 3)), -rigid.skew(x)], axis=2).reshape(900, 6)
    )[0]
    both = np.column_stack([(machines.predicted(fit, q)[:, :3, 3] - x).ravel(), by_doubt.reshape(900, -1)])
    both -= rigidly @ (rigidly.T @ both)
    return float(np.linalg.norm(both[:, 0]) / np.sqrt(300)), float(np.linalg.norm(both[:, 1:]) / np.sqrt(300))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", ["sockets", "planes"])
def test_a_scara_that_only_touches_is_as_wide_as_is_said(kind: str, seed: int) -> None:
    """Its axes are nearly parallel, so that a narrower one touches nearly as well: by 24 mm it was."""
    made = lab(seed, noise=NOISE, arm=SCARA)
    data = sockets(made)[0] if kind == "sockets" else planes(made)
    fit = fitted(made, data)
    assert fit.converged
    off, stated = off_and_stated(made, fit)
    assert off < 2.0 * stated < 30e-3
    assert calib.assess(fit).trusted
    assert [finding.code for finding in rank_findings(fit.model, [data])] == ["proportions-unseen"]


@pytest.mark.parametrize("seed", [1, 6])
def test_one_known_length_tells_how_wide_a_scara_is(seed: int) -> None:
    """Also of sockets nearly above each other, where the quill's gear could take the length up, and a narrower arm."""
    made = lab(seed, noise=NOISE, arm=SCARA)
    data, places = sockets(made)
    length = Relation("distance", ("a", "b"), float(np.linalg.norm(places[0] - places[1])), 2e-5)
    fit = fitted(made, data, [length])
    assert made.miss(fit) < 1e-3
    residue = Residue.of(fit, {})
    assert of_rows.gear(gains(stretches(residue), residue.C), {}, fit).passed
    assert abs(float(made.machine.tools["tool"][2, 3]) - float(fit.machine.frames.tools[0, 2, 3])) < 0.5


def test_a_gear_that_is_wrong_is_told_of_an_arm_that_touches_sockets() -> None:
    """What only a shrunk machine explains is none; a gear that is wrong by 1.5 % is."""
    made = lab(1, noise=NOISE, arm=UR10)
    data, places = sockets(made)
    readings = np.array(data.readings)
    readings[:, 2] *= 0.985
    length = Relation("distance", ("a", "b"), float(np.linalg.norm(places[0] - places[1])), 2e-5)
    columns = made.columns(readings, target=np.repeat(list("abcd"), 15).tolist())
    wrong = calib.read_measurements(columns, made.robot, "socket", sigma=NOISE)
    fit = fitted(made, wrong, [length])
    residue = Residue.of(fit, {})
    check = of_rows.gear(gains(stretches(residue), residue.C), {}, fit)
    assert not check.passed
    assert "elbow_joint" in check.sentence


@pytest.mark.parametrize("seed", range(2))
def test_much_noise_of_readings_is_no_gear(seed: int) -> None:
    """Readings at which errors are left say that a joint moves less than it says."""
    fit = fitted(made := lab(seed, noise=2e-3, arm=SCARA), sockets(made)[0])
    residue = Residue.of(fit, {})
    assert of_rows.gear(gains(stretches(residue), residue.C), {}, fit).passed


def test_a_size_that_nothing_tells_is_not_told() -> None:
    """A machine that may grow does so by its own lengths: by the nominal ones all links seemed 100 % shorter."""
    fit = fitted(made := lab(1, noise=2e-3, arm=UR10), planes(made))
    check = of_arm.lengths(fit, of_arm.common_scale(fit, stretches(Residue.of(fit, {}))))
    assert check.passed
    assert "Nothing tells whether all links are longer" in check.sentence


@pytest.mark.parametrize("arm", [SCARA, UR10], ids=["scara", "ur10"])
def test_what_must_not_change(arm: tuple[str, str]) -> None:
    """The order of the rows changes nothing."""
    made = lab(4, noise=NOISE, arm=arm)
    data, _ = sockets(made)
    order = np.random.default_rng(0).permutation(len(data))
    once, again = fitted(made, data), fitted(made, data.subset(order))
    q = made.draw(50)
    ours, theirs = (machines.predicted(fit, q)[:, :3, 3] for fit in (once, again))
    np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=2e-7)


def test_what_is_not_told_of_touched_targets_is_said() -> None:
    """Without an instrument equal fits differ in where the tool is, which must not be said to be predicted."""
    made = lab(2, noise=NOISE, arm=UR10)
    said = " ".join(rank_sentences(fitted(made, sockets(made)[0])))
    assert "All equal fits predict alike what was touched, but not where the tool is." in said
    assert "No prediction at poses like these" in " ".join(rank_sentences(fitted(made, made.positions(30))))


def test_of_an_arm_with_six_joints_only_the_size_is_not_told() -> None:
    made = lab(2, noise=NOISE, arm=UR10)
    data, _ = sockets(made)
    fit = fitted(made, data)
    assert fit.rank == 20 + 3 * 4
    assert made.miss(fit, sized=False) < 1e-4
    assert [finding.code for finding in rank_findings(fit.model, [data])] == ["size-unseen"]
