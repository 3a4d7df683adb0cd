"""How sure the print's scale is: as sure as a linear Bayes by another mathematics says, with all that is not known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("cv2")

import calib
from calib.identification.parameters import Priors
from calib.measurement.boards import Board
from calib.measurement.lens import NAMES
from scripts.simulate import photographs as simulation

ARM, SCALE, NOISE, SEED = 1e-3, 5e-3, 0.2, 4
# Of the arm, camera and board (a twist each), the lens (9), the print (6): steps of differences and weak priors.
STEPS = np.array([1e-6] * 48 + [1e-3] * 4 + [1e-5] * 5 + [1e-6] * 3 + [1e-4] * 3)
UNITS = np.array([ARM] * 36 + [1e-1] * 12 + [1e2] * 4 + [1.0] * 5 + [SCALE, 1e-1, 1e-1] + [10.0] * 3)


def seen(some: simulation.Session, x: np.ndarray) -> np.ndarray:
    """Return where corners are once all that is not known changes by x (63,)."""
    arm = simulation.Arm(np.random.default_rng(0), 0.0, 0.0, 0.0)
    arm.errors = {
        name: some.arm.errors[name] @ simulation.pose(*x[6 * k : 6 * k + 6].reshape(2, 3))
        for k, name in enumerate(arm.names)
    }
    camera, board = (
        T @ simulation.pose(*d.reshape(2, 3)) for T, d in ((some.camera, x[36:42]), (some.board, x[42:48]))
    )
    lens, sheet = some.lens, some.sheet
    fx, fy, cx, cy = np.array([lens.fx, lens.fy, lens.cx, lens.cy]) + x[48:52]
    lens = simulation.Lens(fx, fy, cx, cy, tuple(np.array(lens.k) + x[52:57]), lens.size)
    sheet = simulation.Sheet(
        scale=sheet.scale + x[57],
        aspect=sheet.aspect + x[58],
        shear=sheet.shear + x[59],
        bend=tuple(np.array(sheet.bend) + x[60:]),
    )
    at = [np.linalg.inv(arm.tip(q) @ camera) @ board for q in some.readings]
    return np.concatenate([lens.see(sheet.place(sheet.corners()) @ T[:3, :3].T + T[:3, 3]).ravel() for T in at])


def test_the_scale_is_as_sure_as_priors_of_arm_and_print_make_it_and_errs_as_they_do() -> None:
    rng = np.random.default_rng(SEED)
    some = simulation.session(SEED, 12)
    some.arm = simulation.Arm(rng, ARM, ARM, 0.0)
    J = np.stack([(seen(some, step) - seen(some, -step)) / (2.0 * step.max()) for step in np.diag(STEPS)], axis=1)
    covariance = np.linalg.inv((J * UNITS).T @ (J * UNITS) / NOISE**2 + np.eye(63)) * UNITS * UNITS[:, None]
    # What priors make of this arm and print: they expect none of these errors.
    unexpected = np.zeros(63)
    for k, E in enumerate(some.arm.errors.values()):
        unexpected[6 * k : 6 * k + 6] = *E[:3, 3], *Rotation.from_matrix(E[:3, :3]).as_rotvec()
    unexpected[57] = some.sheet.scale
    wrong = -(covariance @ (unexpected / UNITS**2))[57]

    robot = calib.load_robot(simulation.UR5, simulation.TIP)
    camera = calib.measuring.Camera("tip", free=NAMES[:9], size=some.lens.size, sigma=NOISE)
    data = calib.read_measurements(simulation.corners_seen(some, NOISE, rng), robot, "pixels", instrument=camera)
    corners = some.sheet.corners()
    board = Board(marks=np.column_stack([corners, np.zeros(len(corners))]), shape="quadratic")
    data = calib.measuring.seen_by(data, camera, board)
    model = calib.error_model(
        robot, offsets="all", placements="all", base="fixed", tool="pose", priors=Priors(ARM, ARM)
    )
    fit = calib.identify(model, data)
    scale = [p.name for p in fit.parameters].index("board.scale")
    sigma = float(np.sqrt(fit.covariance[scale, scale]))
    assert sigma == pytest.approx(np.sqrt(covariance[57, 57]), rel=0.01)
    # Noise of corners adds little to what priors leave.
    assert fit.value("board.scale") - some.sheet.scale == pytest.approx(wrong, abs=0.3 * sigma)
