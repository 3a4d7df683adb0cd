"""Which arms a URDF describes: every run of joints that a tip may stand at the end of."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from calib.foundations.errors import RobotError
from calib.foundations.words import counted
from calib.robot.urdf import MOST_JOINTS, MOVING, Urdf, UrdfJoint, read_urdf

# Links of the same joints differ by where the tool is; what is usually meant by the tip, first.
_TIPS = ("tool0", "flange", "tcp", "end_effector", "tip", "tool", "ee", "hand")


@dataclass(frozen=True, slots=True)
class Chain:
    """The readings of an arm from ``base`` (None: the root) to ``tip``; ``others``: tips of the same joints."""

    base: str | None
    tip: str
    joints: tuple[str, ...]
    others: tuple[str, ...] = ()


def chains(document: Urdf, tip: str | None = None) -> tuple[Chain, ...]:
    """Return the arms from the root link, or from behind a joint that is none of an arm's, the longest first.

    What has more joints than an arm may have is none. Raises RobotError where nothing else is there.
    """
    by_child = {joint.child: joint for joint in document.joints}
    carries = {joint.parent for joint in document.joints}
    drivers = _drivers(document)
    found: dict[tuple[str | None, tuple[str, ...]], list[str]] = {}
    too_far = ""
    for link in document.links if tip is None else (tip,):
        path: list[UrdfJoint] = []
        at, base = link, None
        while at in by_child and len(path) <= MOST_JOINTS:
            joint = by_child[at]
            if joint.type in ("floating", "planar"):
                base = at
                break
            path.append(joint)
            at = joint.parent
        if len(path) > MOST_JOINTS:
            too_far = too_far or link
            continue
        moving = [joint for joint in reversed(path) if joint.type in MOVING]
        names = tuple(dict.fromkeys(drivers[joint.name] for joint in moving))
        if names:
            found.setdefault((base, names), []).append(link)
    if too_far and not found:
        raise RobotError(f"{document.where}: more than the {MOST_JOINTS} joints that are allowed lead to {too_far!r}.")
    arms = []
    for (base, names), links in found.items():
        best = min(links, key=lambda link: _place(link, link in carries))
        arms.append(Chain(base, best, names, tuple(link for link in links if link != best)))
    return tuple(sorted(arms, key=lambda arm: -len(arm.joints)))


def _drivers(document: Urdf) -> Mapping[str, str]:
    """Return for every joint the one that it follows in the end, also on another branch; itself where it follows none.

    A URDF's mimics end at a driver.
    """
    followed = {joint.name: joint.name if joint.mimic is None else joint.mimic.joint for joint in document.joints}
    found: dict[str, str] = {}
    for name in followed:
        way = [name]
        while way[-1] not in found and followed[way[-1]] != way[-1]:
            way.append(followed[way[-1]])
        found |= dict.fromkeys(way, found.get(way[-1], way[-1]))
    return found


def _place(link: str, carries: bool) -> tuple[int, bool]:
    name = f"_{link.lower()}_"
    return next((i for i, word in enumerate(_TIPS) if f"_{word}_" in name), len(_TIPS)), carries


def behind(document: Urdf, arm: Chain, first: int) -> Chain:
    """Return the arm from its joint number ``first`` on."""
    if not first:
        return arm
    return Chain(document.joint(arm.joints[first]).parent, arm.tip, arm.joints[first:], arm.others)


def whole_chains(document: Urdf) -> tuple[Chain, ...]:
    """Return the arms that are no beginning of another, the longest first."""
    arms = chains(document)
    # In the order of their joints, those that begin with an arm's follow it at once.
    inner = {
        arm.joints
        for arm, after in pairwise(sorted(arms, key=lambda arm: arm.joints))
        if after.joints[: len(arm.joints)] == arm.joints
    }
    return tuple(arm for arm in arms if arm.joints not in inner)


def tips(urdf: str | Path) -> tuple[str, ...]:
    """Return one sentence for every arm of a URDF: its joints and its tip."""
    document = read_urdf(urdf)
    return tuple(
        f"{document.where}: {counted(len(arm.joints), 'joint')} from {arm.base or document.root} to {arm.tip}: "
        f"{', '.join(arm.joints)}."
        for arm in whole_chains(document)
    ) or (f"{document.where}: no joint moves.",)
