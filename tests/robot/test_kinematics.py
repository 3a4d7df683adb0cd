"""Placements and regressors of blocks of rows against Pinocchio's own, row by row."""

import numpy as np
import pinocchio as pin
import pytest

from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.robot.kinematics import Follow, Frame, Joints, Kinematics, Tree, followed

# Joints that turn and slide, on a trunk and two branches.
TYPES, PARENTS = ("revolute", "prismatic", "revolute", "revolute", "prismatic", "revolute"), (-1, 0, 1, 1, 3, 4)


def placed(rng: np.random.Generator, shape: tuple[int, ...] = ()) -> Array:
    return rigid.placement(rigid.exp3(rng.normal(size=(*shape, 3))), rng.normal(size=(*shape, 3)))


@pytest.fixture
def tree() -> Tree:
    return Tree(TYPES, PARENTS, placed(np.random.default_rng(3), (len(TYPES),)))


@pytest.fixture
def frames() -> list[Frame]:
    rng = np.random.default_rng(4)
    return [Frame(joint, placed(rng)) for joint in (5, 2, 1, -1)]


def pinocchio(tree: Tree, frame: Frame) -> tuple[pin.Model, int]:
    model = pin.Model()
    for i, (kind, parent, T) in enumerate(zip(*tree, strict=True)):
        joint = pin.JointModelRZ() if kind == "revolute" else pin.JointModelPZ()
        model.addJoint(parent + 1, joint, pin.SE3(T), f"joint_{i}")
    own = pin.Frame("frame", frame.joint + 1, pin.SE3(frame.placement), pin.FrameType.OP_FRAME)
    return model, model.addFrame(own)


@pytest.mark.parametrize("rows", [0, 1, 9])
def test_regressors_are_those_of_pinocchio(tree: Tree, frames: list[Frame], rows: int) -> None:
    q = np.random.default_rng(5).normal(size=(rows, len(TYPES)))
    kinematics = Kinematics(tree, frames)
    for frame, alone, found in zip(frames, kinematics.placements(q), kinematics.regressors(q), strict=True):
        model, number = pinocchio(tree, frame)
        data = model.createData()
        np.testing.assert_array_equal(found.placement, alone)
        for n, q_n in enumerate(q):
            pin.forwardKinematics(model, data, q_n)
            pin.updateFramePlacement(model, data, number)
            expected = pin.computeFrameKinematicRegressor(model, data, number, pin.ReferenceFrame.LOCAL)
            np.testing.assert_allclose(found.placement[n], data.oMf[number].homogeneous, atol=1e-13)
            np.testing.assert_allclose(found.matrix[n], expected, atol=1e-12)
            jacobian = pin.computeFrameJacobian(model, data, q_n, number, pin.ReferenceFrame.LOCAL)
            np.testing.assert_allclose(found.by_joint(TYPES, range(len(TYPES)))[n], jacobian, atol=1e-12)


def test_joints_that_were_placed_otherwise_before_are_placed_anew(tree: Tree, frames: list[Frame]) -> None:
    rng, joints = np.random.default_rng(7), Joints(TYPES, PARENTS)
    q = rng.normal(size=(9, len(TYPES)))
    for _ in range(3):
        other = tree._replace(placements=placed(rng, (len(TYPES),)))
        found = Kinematics(other, frames, joints).placements(q)
        np.testing.assert_array_equal(found, Kinematics(other, frames).placements(q))


@pytest.mark.parametrize("what", ["shifts and turns", "shifts", "turns"])
def test_numbers_are_followed_through_another_frame_of_the_link(tree: Tree, frames: list[Frame], what: str) -> None:
    rng = np.random.default_rng(6)
    regressor = Kinematics(tree, frames).regressors(rng.normal(size=(7, len(TYPES))))[0]
    tool = placed(rng)
    there = regressor.placement @ tool
    np.testing.assert_allclose(regressor.behind(regressor.end @ tool), there, atol=1e-13)
    rows = rng.normal(size=(7, 5, 6))
    if what != "shifts and turns":
        rows[:, :, slice(0, 3) if what == "turns" else slice(3, 6)] = 0.0
    R = there[:, :3, :3]
    shift, turn = ((part @ R.transpose(0, 2, 1)).transpose(1, 2, 0) for part in (rows[:, :, :3], rows[:, :, 3:]))
    follow = Follow(None if what == "turns" else shift, None if what == "shifts" else turn)
    numbers = regressor.through(follow, there[:, :3, 3])

    own = [6 * j + k for j in regressor.way for k in range(6)]
    expected = rows @ rigid.adjoint(rigid.inverse(tool)) @ regressor.matrix
    assert not np.delete(regressor.matrix, own, axis=2).any() and len(own) < regressor.matrix.shape[2]
    # Every joint is placed in the carrier before it, and what is behind the last one in that.
    w = len(regressor.way)
    by = np.zeros((6, w + 1, 6 * (w + 1)))
    for k, T in enumerate([*regressor.placements, regressor.end @ tool]):
        by[:, k, 6 * k : 6 * k + 6] = rigid.adjoint(T)
    found = np.empty((5, 7, 6 * (w + 1)))
    followed(numbers, by.reshape(6 * (w + 1), -1), found)
    expected = np.concatenate([expected[:, :, own], rows], axis=2)
    np.testing.assert_allclose(found.transpose(1, 0, 2), expected, atol=1e-12)
    jacobian = rows @ rigid.adjoint(rigid.inverse(tool)) @ regressor.by_joint(TYPES, range(len(TYPES)))
    np.testing.assert_allclose(regressor.by_position(numbers, TYPES).transpose(2, 1, 0), jacobian, atol=1e-12)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_single_joint_has_a_jacobian_of_one_column(kind: str) -> None:
    rng = np.random.default_rng(9)
    kinematics = Kinematics(
        Tree((kind,), (-1,), placed(rng, (1,))), [Frame(0, rigid.placement(np.eye(3), np.zeros(3)))]
    )
    _, jacobians = kinematics.jacobian(rng.normal(size=(3, 1)))
    along = [0.0, 0.0, 1.0]
    expected = [*along, 0.0, 0.0, 0.0] if kind == "prismatic" else [0.0, 0.0, 0.0, *along]
    np.testing.assert_allclose(jacobians, np.tile(np.array(expected)[:, None], (3, 1, 1)), atol=1e-15)
