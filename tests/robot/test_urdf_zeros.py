"""A URDF that counts as somebody reads it: a second reader puts every link where the old one has it."""

import io

import numpy as np
import pytest
import yourdfpy

from calib.robot.sources import examples
from calib.robot.urdf import parse_urdf, read_urdf
from calib.robot.urdf_writer import splice_zeros
from tests.robot.test_urdf_writer import NOT_ROBOTS

ROBOTS = [name for name in examples() if name not in NOT_ROBOTS]

ARM = b"""<robot name="arm"><link name="a"/><link name="b"/><link name="c"/>
  <joint name="j" type="revolute"><parent link="a"/><child link="b"/>
    <limit lower="-1" upper="2.5" effort="1" velocity="1"/><safety_controller soft_upper_limit="2" k_velocity="9"/>
  </joint>
  <joint name="f" type="revolute"><parent link="b"/><child link="c"/><axis xyz="0 0 2"/>
    <limit lower="-9" upper="9" effort="1" velocity="1"/><mimic joint="j" multiplier="-2"/></joint>
</robot>"""


def at(urdf: bytes, positions: dict[str, float]) -> dict[str, np.ndarray]:
    robot = yourdfpy.URDF.load(io.BytesIO(urdf), load_meshes=False, build_scene_graph=True)
    robot.update_cfg({name: positions[name] for name in robot.actuated_joint_names})
    return {link: robot.get_transform(link) for link in robot.link_map}


@pytest.mark.parametrize("name", ROBOTS[::4])
def test_every_link_is_where_it_was(name: str) -> None:
    urdf = read_urdf(name)
    rng = np.random.default_rng(len(urdf.source))
    moving = [
        joint for joint in urdf.joints if joint.type in ("revolute", "continuous", "prismatic") and not joint.mimic
    ]
    zeros = {joint.name: (float(rng.choice([-1.0, 1.0])), float(rng.uniform(-3.0, 3.0))) for joint in moving}
    readings = {joint.name: float(rng.uniform(-1.0, 1.0)) for joint in moving}
    counted = splice_zeros(urdf.source, zeros, name)
    stood = {joint: zeros[joint][0] * reading + zeros[joint][1] for joint, reading in readings.items()}
    old, new = at(urdf.source, stood), at(counted, readings)
    for link, placement in old.items():
        np.testing.assert_allclose(new[link], placement, rtol=0.0, atol=1e-9)


def test_limits_and_followers_are_put_in_the_new_numbers() -> None:
    counted = splice_zeros(ARM, {"j": (-1.0, 0.5)})
    joint, follower = parse_urdf(counted, "arm").joints
    assert (joint.lower, joint.upper) == (-2.0, 1.5)
    assert joint.axis.tolist() == [-1.0, 0.0, 0.0]
    assert follower.mimic is not None
    assert (follower.mimic.multiplier, follower.mimic.offset) == (2.0, -1.0)
    assert (
        b'soft_upper_limit="0.5"' in counted and b'soft_lower_limit="-1.5"' in counted and b'k_velocity="9"' in counted
    )
    assert b'<axis xyz="0 0 2"/>' in counted


def test_there_and_back_is_the_same_robot() -> None:
    there = splice_zeros(ARM, {"j": (-1.0, 0.5)})
    back = splice_zeros(there, {"j": (-1.0, 0.5)})
    for old, new in zip(parse_urdf(ARM, "arm").joints, parse_urdf(back, "arm").joints, strict=True):
        np.testing.assert_allclose(new.origin, old.origin, atol=1e-15)
        np.testing.assert_allclose(new.axis, old.axis, atol=1e-15)
        assert (new.lower, new.upper, new.mimic) == (old.lower, old.upper, old.mimic)


def test_nothing_asked_changes_nothing() -> None:
    assert splice_zeros(ARM, {}) == ARM
    assert parse_urdf(splice_zeros(ARM, {"j": (1.0, 0.0)}), "arm").joints[0].lower == -1.0
