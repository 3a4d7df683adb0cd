"""Random machines for hypothesis: serial arms as URDF text, poses, twists."""

from hypothesis import strategies as st

from tests.support import machines
from tests.support.machines import Array, pose

AXES = ("1 0 0", "0 1 0", "0 0 1", "0 0 -1", "0 -1 0", "-1 0 0", "1 2 -2", "0.6 0 0.8", "0.001 1 0")


def numbers(size: float) -> st.SearchStrategy[float]:
    """Numbers up to a size, zero and round ones among them."""
    return st.integers(-1000, 1000).map(lambda k: size * k / 1000)


def triples(size: float) -> st.SearchStrategy[tuple[float, ...]]:
    return st.tuples(*[numbers(size)] * 3)


def poses(distance: float = 3.0) -> st.SearchStrategy[Array]:
    """Placements (4, 4) whose turns are below half a turn."""
    return st.builds(pose, triples(distance), triples(1.7))


@st.composite
def arms(draw: st.DrawFn, least: int = 3, most: int = 7, *, far: float = 0.0) -> str:
    """The URDF of an arm from ``base`` to ``tip``: moving joints in any order and place, fixed ones among them.

    The first joint is up to ``far`` m away from the base.
    """
    joints: list[tuple[str, ...]] = []
    moving = draw(st.integers(least, most))
    for k in range(moving):
        if draw(st.integers(0, 3)) == 0:
            joints.append(joint(draw, f"f{k}", "fixed"))
        # As in most arms, what slides is the exception; two of three would be a gantry.
        kind = draw(st.sampled_from(("revolute", "revolute", "continuous", "prismatic")))
        joints.append(joint(draw, f"j{k}", kind))
    if far:
        joints[0] = (*joints[0][:2], words(draw(triples(far))), *joints[0][3:])
    return machines.urdf(*joints)


def joint(draw: st.DrawFn, name: str, kind: str) -> tuple[str, ...]:
    return name, kind, words(draw(triples(0.6))), words(draw(triples(3.1))), draw(st.sampled_from(AXES))


def words(v: tuple[float, ...]) -> str:
    return " ".join(map(repr, v))
