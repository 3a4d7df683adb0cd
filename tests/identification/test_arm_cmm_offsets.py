"""The stated sigmas of an arm CMM's zero offsets hold: 95 % intervals contain the truth as often as they say."""

from pathlib import Path

import numpy as np

import calib

ARM = Path(__file__).parents[2] / "robots/arm_cmm/arm_cmm.urdf"
D = np.array([100, 150, 450, 100, 350, 100, 150]) * 1e-3
ALPHA = np.radians([-90, 90, 90, -90, -90, 90, 0])
REPETITIONS, TOUCHES, NOISE = 300, 20, 0.02e-3


def dh_product(q: np.ndarray) -> np.ndarray:
    """Return probe points (N, 3) of the standard DH table, written out."""
    T = np.broadcast_to(np.eye(4), (len(q), 4, 4))
    theta = np.column_stack([q, np.zeros(len(q))])
    for i, (d, alpha) in enumerate(zip(D, ALPHA, strict=True)):
        c, s, ca, sa = np.cos(theta[:, i]), np.sin(theta[:, i]), np.cos(alpha), np.sin(alpha)
        step = np.zeros((len(q), 4, 4))
        step[:, 0, :3] = np.column_stack([c, -s * ca, s * sa])
        step[:, 1, :3] = np.column_stack([s, c * ca, -c * sa])
        step[:, 2, 1], step[:, 2, 2], step[:, 2, 3], step[:, 3, 3] = sa, ca, d, 1.0
        T = T @ step
    return T[:, :3, 3]


def test_95_percent_intervals_of_the_offsets_cover_as_they_say() -> None:
    rng = np.random.default_rng(20)
    robot = calib.load_robot(ARM)
    model = calib.error_model(robot, offsets="all", base="fixed", tool="fixed")
    header = [f"joint_{i} [rad]" for i in range(1, 7)]
    inside = np.zeros(6)
    for _ in range(REPETITIONS):
        truth = np.radians(rng.uniform(-3.0, 3.0, 6))
        q = rng.uniform(-2.0, 2.0, (TOUCHES, 6))
        points = dh_product(q + truth) + rng.normal(scale=NOISE, size=(TOUCHES, 3))
        columns = dict(zip(header, q.T, strict=True)) | dict(zip(("x [m]", "y [m]", "z [m]"), points.T, strict=True))
        fit = calib.identify(model, calib.read_measurements(columns, robot, sigma=NOISE), model_sigmas=[0.0])
        assert fit.rank == 6
        inside += np.abs(fit.values - truth) < 1.959964 * fit.sigmas
    assert 0.93 < inside.mean() / REPETITIONS < 0.97
