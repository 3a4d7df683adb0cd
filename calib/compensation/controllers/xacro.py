"""YAML of joint origins for descriptions in xacro: ``${xacro.load_yaml(file)['origins']['joint_1']['xyz']}``."""

import re
from collections.abc import Mapping

import numpy as np

from calib.compensation.controllers.export import Export, Part, judged_export, judged_readings, plain_tips
from calib.compensation.controllers.yaml_text import Node, read_yaml, yaml_text
from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array
from calib.foundations.errors import OutputError
from calib.foundations.words import shown
from calib.machine.calibrated import CalibratedMachine
from calib.machine.urdf import calibrated_urdf
from calib.robot.load import with_document
from calib.robot.urdf import parse_urdf
from calib.robot.urdf_writer import origin_text, splice_origins

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")
_COMMENTS = """\
# Calibrated joint origins for the <origin> of each joint in a xacro file: xyz in m, rpy in rad; offsets are in them.
"""


@checked
def export_xacro(model: CalibratedMachine) -> Export:
    """Return YAML with the calibrated ``<origin>`` of every joint of the arm, as calibrated.urdf has them.

    Offsets are folded in; geometry that leans on joint terms or loops is replaced by the best one without them.

    ``origins``: by the joint's name, ``xyz`` in m and ``rpy`` in rad, as texts that xacro puts in as they are. Raises
    OutputError for a joint whose name is no plain word.
    """
    robot = model.geometry.robot
    document = parse_urdf(calibrated_urdf(robot, model.geometry.deviations), "the calibrated URDF")
    origins: dict[str, Mapping[str, Node]] = {}
    for chained in robot.chain:
        if _NAME.fullmatch(chained.name) is None:
            raise OutputError(
                f"joint {shown(chained.name)}: a key of this file is of the letters a to z, digits, underscores, dots "
                "and hyphens."
            )
        origin = origin_text(document.joint(chained.name).origin)
        origins[chained.name] = dict(zip(("xyz", "rpy"), origin, strict=True))
    text = _COMMENTS + yaml_text({"origins": origins})

    def read_back(readings: Array) -> Array:
        found = {name: _placement(numbers) for name, numbers in read_yaml(text)["origins"].items()}
        again = parse_urdf(splice_origins(robot.urdf.source, found, robot.urdf.where), "the origins read back")
        return with_document(robot, again).tips(readings)

    expected = plain_tips(model, judged_readings(model))
    holds: set[Part] = {"placements"} if robot is not model.robot else {"placements", "closed loops and couplings"}
    return judged_export(model, text, read_back, expected, frozenset(holds))


def _placement(numbers: Mapping[str, str]) -> Array:
    xyz, rpy = (np.array([float(number) for number in numbers[key].split()]) for key in ("xyz", "rpy"))
    return rigid.placement(rigid.rotation_of_rpy(rpy), xyz)
