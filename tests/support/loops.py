"""URDFs of trees of links that loops close."""

from tests.support import machines


def tree(*joints: tuple[str, ...]) -> str:
    """A tree of links: parent, child, type, xyz and axis of every joint, which is named after its child."""
    links = dict.fromkeys(link for parent, child, *_ in joints for link in (parent, child))
    elements = [f'<link name="{link}"/>' for link in links]
    for parent, child, kind, xyz, axis, *more in joints:
        elements.append(
            f'<joint name="{child}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{xyz}" rpy="{more[1] if len(more) > 1 else "0 0 0"}"/><axis xyz="{axis}"/>'
            f"{more[0] if more else ''}{machines.LIMIT.get(kind, '')}</joint>"
        )
    return f'<robot name="loops">{"".join(elements)}</robot>'


def mimic(driver: str, multiplier: float) -> str:
    return f'<mimic joint="{driver}" multiplier="{multiplier}"/>'


def four_bar_urdf(L2: float = 0.7, b: float = 0.18, c: float = 0.7, e: float = 0.18, out: float = 0.0) -> str:
    """A palletiser's arm on a turret: lower arm up, forearm to the front, crank and rear lever to the back.

    Crank and rod lie ``out`` beside the lower arm.
    """
    return tree(
        ("base", "turret", "revolute", "0 0 0.3", "0 0 1"),
        ("turret", "lower", "revolute", "0.1 0 0.2", "0 1 0"),
        ("lower", "cancel", "revolute", f"0 0 {L2}", "0 1 0", mimic("lower", -1.0)),
        ("cancel", "elbow", "revolute", "0 0 0", "0 1 0", mimic("crank", 1.0)),
        ("elbow", "pin", "fixed", f"-{e} 0 0", "0 0 0"),
        ("turret", "crank", "revolute", f"0.1 {out} 0.2", "0 1 0"),
        ("crank", "rod_cancel", "revolute", f"-{b} 0 0", "0 1 0", mimic("crank", -1.0)),
        ("rod_cancel", "rod", "revolute", "0 0 0", "0 1 0", mimic("lower", 1.0)),
        ("rod", "rod_end", "fixed", f"0 0 {c}", "0 0 0"),
        ("elbow", "roll", "revolute", "0.2 0 0.1", "1 0 0"),
        ("roll", "tip", "revolute", "0.5 0 0", "0 1 0"),
    )
