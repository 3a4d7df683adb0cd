"""YAML for ROS users: what the calibrated URDF has no place for, and what else nodes want to know by name."""

from dataclasses import replace

import numpy as np

from calib.compensation.controllers.export import Export, judged_export, judged_readings
from calib.compensation.controllers.yaml_text import Node, read_yaml, yaml_text
from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, read_only
from calib.machine.calibrated import CalibratedMachine
from calib.machine.identified import usual_conditions
from calib.robot.joint_terms import with_joint_terms
from calib.robot.robot import Deviations, Robot
from calib.robot.terms import JointTerm, kind_of

_COMMENTS = """\
# Calibrated machine, in m, rad and SI. Quaternions in the order of ROS: x, y, z, w.
# joint position = reading + offset + sum of coefficient * basis over the joint's terms. {document} has the offsets
# in its origins already: add them to readings only where the nominal URDF is kept, never with both.
"""
_WITH_TERMS = "# The terms go with model.urdf: calibrated.urdf is the best geometry without them.\n"


@checked
def export_ros(model: CalibratedMachine) -> Export:
    """Return YAML: joints with offsets, joint terms (kind, order, coefficient, unit), base and tool frames.

    ``calibration.joints``: names of the moving joints and offsets in rad or m; ``base``: the base link in the
    instrument's frame; ``tools``: in the tip link; ``terms``: as docs/joint_terms.md has them; ``gravity`` and
    ``payload``, where one is carried: what bears on the arm. ``setups``, where there are several: base, gravity and
    payload of each. Placements are not in it: they are in the calibrated URDF. ``lost`` is that of the nominal URDF
    with this file alone.
    """
    robot, d = model.robot, model.deviations
    moving = [robot.chain[i] for i in robot.moving]
    dimensions = {reading.name: reading.dimension for reading in robot.readings}
    terms: list[Node] = [
        {
            "joint": term.reading,
            "kind": term.kind,
            "order": term.order,
            **({"body": term.body} if term.body else {}),
            "coefficient": float(coefficient),
            "unit": kind_of(term).coefficient(term, dimensions.get(term.reading, "angle")).unit,
        }
        for term, coefficient in zip(robot.terms, d.terms, strict=True)
    ]
    contents: dict[str, Node] = {
        "schema": 1,
        "base_link": robot.base,
        "tip_link": robot.tip,
        "joints": [
            {"name": joint.name, "type": joint.type, "offset": float(offset)}
            for joint, offset in zip(moving, d.offsets, strict=True)
        ],
        "base": _frame(model.base),
        # Those of other links, of another arm, are not in this tip link.
        "tools": [
            {"name": name, **_frame(tool)}
            for name, tool in model.tools.items()
            if model.of(name).robot.tip == robot.tip
        ],
        "terms": terms,
        **_load(robot, model.setup),
    }
    if model.others:
        # Base, gravity and payload above are those of the first.
        contents["setups"] = [
            {"name": name, **_frame(base), **_load(robot, name)} for name, base in model.bases.items()
        ]
    own = replace(d, placements=np.zeros_like(d.placements))
    alone = model.in_urdf is None
    comments = _COMMENTS.format(document="calibrated.urdf" if alone else "model.urdf") + ("" if alone else _WITH_TERMS)
    text = comments + yaml_text({"calibration": contents})

    def read_back(readings: Array) -> Array:
        read = read_yaml(text)["calibration"]
        offsets = read_only([joint["offset"] for joint in read["joints"]])
        coefficients = read_only([term["coefficient"] for term in read["terms"]])
        again = with_joint_terms(
            replace(robot, terms=(), weights=None),
            [JointTerm(t["joint"], t["kind"], t["order"], t.get("body", "")) for t in read["terms"]],
        )
        return again.tips(
            readings, Deviations(own.placements, offsets, coefficients), usual_conditions(model, readings)
        )

    readings = judged_readings(model)
    expected = robot.tips(readings, own, usual_conditions(model, readings))
    return judged_export(model, text, read_back, expected, frozenset({"joint terms"}))


def _load(robot: Robot, setup: str) -> dict[str, Node]:
    load = robot.load_in(setup)
    found: dict[str, Node] = {"gravity": list(map(float, load.gravity))}
    if (carried := load.payload) is not None:
        position = list(map(float, carried.position))
        link = carried.link or robot.links[0]
        found["payload"] = {"mass": float(carried.mass), "position": position, "link": link}
    return found


def _frame(T: Array) -> dict[str, Node]:
    w, x, y, z = map(float, rigid.quaternion_of(T[:3, :3]))
    return {"xyz": list(map(float, T[:3, 3])), "quaternion": [x, y, z, w]}
