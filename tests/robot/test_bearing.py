"""Which readings bear on where links are: those whose change moves them, found by changing each."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.robot.conditions import Conditions
from calib.robot.robot import Robot
from calib.robot.urdf import parse_urdf
from tests.support import machines
from tests.support.machines import LIMIT, Rng
from tests.support.sagging import two_arms

# Of what, that gives way to masses, terms may be.
READINGS, LINKS = ("elastic", "hysteresis", "moments"), ("bending", "torsion", "lateral")


def branched(rng: Rng) -> Robot:
    """A tree of heavy links, of joints that turn, stand fast, or follow one on any branch; its tips are two leaves."""
    text, kinds, parents = '<robot name="tree"><link name="base"/>', list[str](), list[int]()
    for k in range(8):
        kinds.append(str(rng.choice(["revolute", "fixed"], p=[0.7, 0.3])) if k > 1 else "revolute")
        parents.append(int(rng.integers(max(-1, k - 4), k)))
        drivers = [j for j in range(k) if kinds[j] == "revolute"]
        follows = kinds[k] == "revolute" and drivers and rng.random() < 0.2
        at, turned, axis, centre = (
            " ".join(f"{x:.3f}" for x in scale * rng.normal(size=3)) for scale in (0.2, 0.6, 1.0, 0.1)
        )
        mimic = f'<mimic joint="j{rng.choice(drivers)}" multiplier="-0.7"/>' if follows else ""
        kinds[k] = "mimic" if mimic else kinds[k]
        kind = "fixed" if kinds[k] == "fixed" else "revolute"
        mass = f'<inertial><origin xyz="{centre}"/><mass value="{rng.uniform(1.0, 5.0):.2f}"/></inertial>'
        text += (
            f'<link name="l{k}">{mass}</link>'
            f'<joint name="j{k}" type="{kind}"><parent link="{"base" if parents[k] < 0 else f"l{parents[k]}"}"/>'
            f'<child link="l{k}"/><origin xyz="{at}" rpy="{turned}"/><axis xyz="{axis}"/>{LIMIT.get(kind, "")}{mimic}'
            "</joint>"
        )
    leaves = [k for k in range(8) if k not in parents]
    ways = {k: {k} for k in leaves}
    for way in ways.values():
        while (parent := parents[min(way)]) >= 0:
            way.add(parent)
    tips = [f"l{k}" for k, way in ways.items() if any(kinds[j] != "fixed" for j in way)][:2]
    return calib.load_robot(parse_urdf(f"{text}</robot>".encode(), "tree"), tips[0], links=tips[1:])


def moved_by(robot: Robot, rng: Rng) -> set[str]:
    """Return the names of the readings that move the tip."""
    deviations = replace(robot.no_deviations(), terms=1e-3 * rng.uniform(0.5, 1.5, len(robot.terms)))
    q = rng.uniform(-1.2, 1.2, (6, len(robot.readings)))
    told = Conditions(approach=np.ones_like(q))
    tips = robot.tips(q, deviations, told)
    by_each = (robot.tips(q + 0.3 * step, deviations, told) for step in np.eye(len(robot.readings)))
    moved = [np.abs(there - tips).max() > 1e-9 for there in by_each]
    return {reading.name for reading, does in zip(robot.readings, moved, strict=True) if does}


@pytest.mark.parametrize("seed", range(12))
def test_readings_that_bear_on_a_link_are_those_that_move_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot = branched(rng)
    mimics = any(joint.mimic for joint in robot.urdf.joints)
    readings, joints = [r.name for r in robot.readings], [robot.chain[i].name for i in robot.moving]
    for _ in range(3):
        soft = {key: [str(rng.choice(readings))] for key in READINGS if rng.random() < 0.4}
        soft |= {key: [str(rng.choice(joints))] for key in LINKS if rng.random() < 0.3}
        try:
            loaded = machines.model(robot, **soft).robot
        except calib.CalibError:  # gravity never loads the joint, or links hang on it that the tips do not show
            continue
        for tip in robot.links or (robot.tip,):
            bearing, moving = set(loaded.bearing_on((tip,))), moved_by(loaded.with_tip(tip), rng)
            # Nor are others said to, but where a link gives way whose joint another one follows.
            assert bearing >= moving and (mimics or bearing == moving)


@pytest.mark.parametrize(
    ("mirrored", "soft", "others"),
    [
        (False, {}, False),
        (False, {"elastic": ["left_lift", "right_lift"]}, False),
        (False, {"elastic": ["lean"]}, True),
        (False, {"bending": ["lean"]}, True),
        (False, {"lateral": ["right_lift"]}, False),
        (True, {}, False),
        (True, {"elastic": ["left_lift"]}, True),
        (True, {"elastic": ["left_bend"]}, False),
    ],
)
def test_another_arm_bears_on_a_hand_by_what_gives_way_to_both(
    mirrored: bool, soft: dict[str, list[str]], others: bool
) -> None:
    """Of two arms on a torso; ``mirrored``: the right shoulder follows the left one, so that both load one drive."""
    text = two_arms()
    if mirrored:
        parts = text.partition('<joint name="right_lift"')
        text = "".join((*parts[:2], parts[2].replace("</joint>", '<mimic joint="left_lift"/></joint>', 1)))
    robot = calib.load_robot(parse_urdf(text.encode(), "two.urdf"), "left_hand", links=["right_hand"])
    bearing = machines.model(robot, **soft).robot.bearing_on(("left_hand",))
    assert set(bearing) == {"lean", "left_lift", "left_bend"} | ({"right_bend"} if others else set()) | (
        {"right_lift"} if others and not mirrored else set()
    )
    assert set(bearing) == moved_by(machines.model(robot, **soft).robot, np.random.default_rng(0))
