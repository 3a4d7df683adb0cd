"""An arm of four joints, and shapes on its links."""

from tests.support import machines

RADIUS = 0.12
# One ball a link: where it is in the link. The base is a link too.
BALLS = {"base": (0, 0, 0), "link_a": (0, 0, 0.1), "link_b": (0.2, 0, 0), "link_c": (0.15, 0, 0), "tip": (0.1, 0, 0)}
ARM = machines.urdf(
    ("a", "revolute", "0 0 0.3", "0 0 0", "0 0 1"),
    ("b", "revolute", "0 0 0.2", "0 0 0", "0 1 0"),
    ("c", "revolute", "0.4 0 0", "0.3 0 0", "0 1 0"),
    ("d", "revolute", "0.35 0 0", "0 0.2 0", "0 0 1"),
)


def with_shapes(urdf: str, shapes: dict[str, str]) -> str:
    for link, shape in shapes.items():
        urdf = urdf.replace(f'<link name="{link}"/>', f'<link name="{link}">{shape}</link>')
    return urdf


def ball(xyz: tuple[float, ...], radius: float = RADIUS, *, origin_first: bool = True) -> str:
    parts = [f'<origin xyz="{" ".join(map(str, xyz))}"/>', f'<geometry><sphere radius="{radius}"/></geometry>']
    return f"<collision>{''.join(parts if origin_first else parts[::-1])}</collision>"
