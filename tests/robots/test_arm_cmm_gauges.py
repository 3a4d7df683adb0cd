"""The realistic arm calibrated without a tracker: what its job reaches, and whether that is true."""

import tomllib

import numpy as np

from calib.identification.observability import rank_findings
from calib.job.inputs import load
from calib.job.run import run
from calib.measurement.read import read_measurements
from tests.robots.test_arm_cmm_case import CASE, Array, balls

JOB = CASE / "calibration_gauges.toml"


def aligned(a: Array, b: Array) -> Array:
    """What is left (n, 3) of b when a is moved onto it."""
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    U, _, Vt = np.linalg.svd(a.T @ b)
    return b - a @ (U * [1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt


def test_the_ball_is_where_it_was() -> None:
    """At 100 poses that no touch was made at, in mm; the README has these figures."""
    inputs = load(JOB)
    outcome = run(inputs)
    assert not inputs.findings
    assert not outcome.doubts
    assert (outcome.fit.rank, outcome.fit.numerical_rank) == (36, 36)
    truth, realistic = (
        tomllib.loads((CASE / f"{name}.toml").read_text(encoding="utf-8")) for name in ("truth", "truth_realistic")
    )
    data = read_measurements(CASE / "identification_realistic.csv", inputs.robot)
    true = balls(truth, realistic, np.degrees(data.readings))
    rms = {}
    for when, at in (("before", outcome.fit.nominal), ("after", outcome.fit.machine)):
        said = (inputs.robot.tips(data.readings, at.deviations) @ at.frames.tools[0])[:, :3, 3] * 1e3
        rms[when] = np.sqrt(np.mean(np.sum(aligned(said, true) ** 2, axis=1)))
    validation = outcome.metrics["validation"]["after"]
    readme = (CASE / "README.md").read_text(encoding="utf-8")
    for figure in (
        f"{rms['before']:.1f} mm",
        f"{rms['after']:.3f} mm",
        f"{validation['socket'].rms * 1e3:.3f} mm",
        f"{validation['sphere'].rms * 1e3:.3f} mm",
    ):
        assert figure in readme


def test_without_the_gauges_and_spheres_the_size_is_not_seen() -> None:
    inputs = load(JOB)
    cones = [data for data in inputs.identify if data.kind == "socket"]
    assert [finding.code for finding in rank_findings(inputs.model, cones)] == ["size-unseen"]
    assert not rank_findings(inputs.model, inputs.identify)
