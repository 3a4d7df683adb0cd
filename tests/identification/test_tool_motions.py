"""How tools move with the parameters of a fit, against differences, whatever the rows measure."""

from dataclasses import replace

import numpy as np

import calib
from calib.foundations.arrays import Array
from calib.identification.machine import machine, values_at
from calib.identification.tool_motions import tool_motions
from calib.measurement.measurements import Measurements
from tests.support import machines
from tests.support.touching import NORMALS, PROBE, lab, unit

HEIGHT = 0.2


def places(fit: calib.Fit, data: Measurements, x: Array) -> Array:
    """Where the tools of rows are (n, 3), at values x (p,) of the parameters."""
    at = fit.machine
    there = replace(fit, machine=machine(fit.model.robot, fit.parameters, at.frames, x, at.deviations))
    tips = data.tips(fit.model.robot, there.machine.deviations)
    return np.asarray((there.bases_of(data) @ tips @ there.tools_of(data))[:, :3, 3])


def test_tools_move_as_differences_say_at_a_machine_that_deviates() -> None:
    here = lab(7, noise=3e-5)
    n = unit(NORMALS["floor"])
    q = here.touching(lambda x: (x @ n - HEIGHT)[:, None], np.full((20, 1), PROBE), outside=n)
    touches = here.read(q, "plane", target=["floor"] * 20, ball_m=np.full(20, 2.0 * PROBE))
    model = machines.model(here.robot, offsets="all", placements="all", terms={"harmonics": "all"})
    fit = calib.identify(model, [here.positions(40), touches])
    rng, at = np.random.default_rng(3), fit.machine
    along = rng.normal(0.0, 1.0, (len(fit.parameters), 4)) * np.array([p.scale for p in fit.parameters])[:, None]
    x = values_at(fit.model.robot, fit.parameters, at.frames, at.deviations)
    for data in fit.measurements:
        found = tool_motions(fit, data, along)
        h = 1e-2
        told = np.stack([(places(fit, data, x + h * d) - places(fit, data, x - h * d)) / (2.0 * h) for d in along.T], 2)
        assert np.abs(told).max() > 1e-3
        np.testing.assert_allclose(found, told, rtol=0.0, atol=1e-4 * np.abs(told).max())
