"""A fit that holds what an earlier one has found is no surer than that was: levels, one after the other."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

import calib
from scripts.development.judge_machines import predict
from scripts.studies import sigmas
from tests.support import machines
from tests.support.machines import INLINE, anywhere, pose

SIGMA = 2e-5
ALL = {"offsets": "all", "placements": "all"}
UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")


class Session:
    """A badly made arm before an instrument, seen in some poses after others."""

    def __init__(self, urdf: str, tip: str, seed: int, height: float = 0.0) -> None:
        self.rng = np.random.default_rng(seed)
        self.robot, self.arm = machines.load(urdf, tip), machines.arm(urdf, tip).moved(self.rng, angle=5e-4)
        tools = {"tool": pose((*self.rng.uniform(-0.1, 0.1, 2), 0.15 + height))}
        self.true = machines.Machine(self.arm, anywhere(self.rng), tools)
        self.model = machines.model(self.robot, **ALL)

    def measured(self, n: int) -> calib.Measurements:
        q = self.arm.draw(self.rng, n)
        return self.true.measure(self.robot, q, points=["tool"] * n, rng=self.rng, sigma=SIGMA)

    def levels(self, rows: Sequence[int], then: Sequence[str]) -> calib.Fit:
        first = calib.identify(self.model, self.measured(rows[0]))
        return calib.identify(self.model, self.measured(rows[1]), free=then, start=first)

    def inside(self, fit: calib.Fit) -> tuple[float, float]:
        """Return which share of new poses is in the stated regions, and how far the tool is from where it was said."""
        q, found = self.arm.draw(self.rng, 60), calib.machine_of(fit)
        off = self.true.see(q, ["tool"] * 60)[:, :3, 3] - found.predict(q)[:, :3, 3]
        told = calib.judging.tool_uncertainty(found, q)
        return float(np.mean(told.inside(off))), float(np.mean(told.position**2) / np.mean(np.sum(off**2, axis=1)))


def test_regions_hold_where_a_level_frees_some_of_what_the_one_before_has_found() -> None:
    """Of 20 poses and then 60, the latter for offsets alone, the regions of the tool held three quarters of poses."""
    sessions = [Session(*UR10, seed) for seed in range(8)]
    found = np.array([one.inside(one.levels((20, 60), ["*.offset"])) for one in sessions])
    assert np.mean(found[:, 0]) > 0.93
    assert 1.0 < np.sqrt(np.mean(found[:, 1])) < 2.5


def test_a_height_that_an_earlier_level_did_not_see_is_in_the_sigmas_of_a_later_one() -> None:
    """The tool's height is held where the search began; the base was said to be known to hundredths of a millimetre."""
    off, stated = [], []
    for seed in range(6):
        session = Session(INLINE["scara"], "tip", seed, height=-0.3)
        fit = session.levels((30, 40), ["base.*", "*.offset"])
        between = np.linalg.inv(fit.machine.frames.base) @ session.true.base
        sigma = dict(zip([p.name for p in fit.parameters], fit.sigmas, strict=True))
        for k, axis in enumerate("xyz"):
            if np.isfinite(sigma[f"base.{axis}"]):
                off.append(between[k, 3])
                stated.append(sigma[f"base.{axis}"])
        assert session.inside(fit)[0] > 0.8
    assert len(off) >= 6
    assert np.all(np.abs(off) < 3.0 * np.array(stated))


def test_what_is_free_follows_what_is_held() -> None:
    """Base and tool that are held a little elsewhere move the offsets as their errors are said to do."""
    session = Session(*UR10, 3)
    model = machines.model(session.robot, offsets="all")
    first, more = calib.identify(model, session.measured(30)), session.measured(40)
    fit = calib.identify(model, more, free=["*.offset"], start=first)
    assert fit.earlier is not None
    p = len(fit.parameters)
    names = [parameter.name for parameter in fit.earlier.parameters[p:]]
    assert names == [*(f"base.{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz")), "tool.x", "tool.y", "tool.z"]
    told, held = (np.hstack(fit.earlier.errors)[part] for part in (slice(p), slice(p, None)))
    np.testing.assert_allclose(held, np.hstack(first.errors_of(names)), rtol=1e-9, atol=1e-15)
    frames = first.machine.frames
    told = told / np.linalg.norm(held, axis=0)
    for k in np.argsort(-np.linalg.norm(told, axis=0))[:3]:
        by = 2e-5 * held[:, k] / np.linalg.norm(held[:, k])
        base, tool = (
            first.machine.base_twists[0] @ by[:6],
            first.machine.tool_twists[0] @ np.append(by[6:], np.zeros(3)),
        )
        bases, tools = frames.bases @ pose(base[:3], base[3:]), frames.tools @ pose(tool[:3], tool[3:])
        start = replace(first, machine=replace(first.machine, frames=replace(frames, bases=bases, tools=tools)))
        again = calib.identify(model, more, free=["*.offset"], start=start)
        moved = (again.values - fit.values) / 2e-5
        np.testing.assert_allclose(moved, told[:, k], atol=0.01 * np.abs(told[:, k]).max())


def test_an_orientation_that_the_first_level_did_not_see_is_not_known() -> None:
    """Positions do not tell how the flange turns about the tool; with the base alone free, that seemed known."""
    session = Session(*UR10, 2)
    once = calib.identify(session.model, session.measured(40))
    fit = calib.identify(session.model, session.measured(10), free=["base.*"], start=once)
    maps = [calib.judging.uncertainty_map(calib.machine_of(one), 200) for one in (once, fit)]
    assert [one.known_shares() for one in maps] == [{"position": 1.0, "orientation": 0.0}] * 2
    turns = [np.sqrt(np.mean(one.sigmas[:, 1] ** 2)) for one in maps]
    assert turns[1] > 0.5 * turns[0]


def test_nothing_is_counted_where_all_is_free_again() -> None:
    session = Session(*UR10, 4)
    first = calib.identify(session.model, session.measured(30))
    again = calib.identify(session.model, session.measured(40), free=["*"], start=first)
    assert again.earlier is None
    assert again.by_earlier.shape == (len(again.parameters), 0)


def test_three_levels_hand_on_what_the_first_did_not_know() -> None:
    session = Session(*UR10, 5)
    second = session.levels((20, 40), ["*.offset"])
    third = calib.identify(session.model, session.measured(30), free=["tool.*"], start=second)
    assert third.earlier is not None
    held = [p.name for p in third.earlier.parameters[len(third.parameters) :]]
    placed = [name for name in held if name.endswith(".tx")]
    assert placed
    assert second.earlier is not None
    np.testing.assert_allclose(
        *(np.sum(np.hstack(one.of(placed)[:2]) ** 2, axis=1) for one in (third.earlier, second.earlier)), rtol=1e-9
    )
    assert session.inside(third)[0] > 0.9


def _levels_of_a_palletiser(seed: int, sessions: int, then: Sequence[str]) -> list[calib.CalibratedMachine]:
    """Two levels each, of one machine in the same poses."""
    of = sigmas.measured("palletiser with two parallelograms", "offsets and placements", seed)
    rng = np.random.default_rng(seed)
    exact = predict(of.arm, of.true, of.data.readings, np.zeros(len(of.data), dtype=np.intp))[0, :, :3, 3]

    def again() -> calib.Measurements:
        return replace(of.data, position=exact + rng.normal(scale=of.data.sigma[0, 0], size=exact.shape))

    found = []
    for _ in range(sessions):
        first = calib.identify(of.model, again())
        found.append(calib.machine_of(calib.identify(of.model, again(), free=then, start=first)))
    return found


def test_compare_finds_nothing_moved_where_levels_have_found_one_arm_twice() -> None:
    """What was handed on was the noise of a free network, in which the tool's height that is not seen goes anywhere."""
    moved = [calib.judging.compare(*_levels_of_a_palletiser(seed, 2, ["base.*"])) for seed in range(8)]
    assert sum(one.moved for one in moved) <= 1
    for one in moved:
        assert one.statistic is not None
        assert one.statistic < 2.5 * one.degrees_of_freedom


def test_directions_of_the_null_spaces_of_levels_are_as_long_as_those_of_one() -> None:
    """What is free followed some by tens of scales, beside which compare took others for none."""
    for machine in _levels_of_a_palletiser(1, 2, ["base.*", "tool.*", "*.offset"]):
        assert machine.uncertainty is not None
        lengths = np.linalg.norm(machine.uncertainty.null_basis, axis=0) / 1e-3
        np.testing.assert_allclose(lengths, 1.0, rtol=0.01)
