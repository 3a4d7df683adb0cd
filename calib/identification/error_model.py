"""The error model: which parameters of a robot and its set-up are unknown."""

import fnmatch
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, read_only
from calib.foundations.errors import JobError, RobotError
from calib.foundations.ranges import refuse_beyond
from calib.foundations.words import near
from calib.identification.joint_terms import group_of, links, moments_of, ordinary, terms_of
from calib.identification.machine import POSE, Frames, Layout
from calib.identification.parameters import TERM_WIDTH, Parameter, ParameterKind, Prior, width
from calib.identification.relations import Relation
from calib.identification.targets import Target
from calib.measurement.measurements import Measurements
from calib.robot import deviation
from calib.robot.dh.frames import PARALLEL, DhFrames, Direction, dh_frames, own_motion
from calib.robot.dh.table import NUMBERS, Convention, DhTable
from calib.robot.joint_terms import with_joint_terms
from calib.robot.robot import Deviations, Robot
from calib.robot.transmission import JointTerm

Selection = Literal["all", "none"] | Sequence[str]
BaseFreedom = Literal["pose", "fixed"]
ToolFreedom = Literal["pose", "position", "fixed"]

# Parameters that are alike share a prior whose width is learned; by kind, and whether they are lengths.
_GROUPS = {
    ("placement", True): "link translations",
    ("placement", False): "link rotations",
    ("offset", True): "offsets of joints that slide",
    ("offset", False): "offsets of joints that turn",
}


@dataclass(frozen=True, slots=True)
class TermPriors:
    """Standard deviations that amounts of joint terms are expected to have, about zero; None where nobody knows.

    "learned": as the data teach them, for the harmonics of every reading, or for all compliances. ``harmonics`` in rad;
    ``elastic``: compliances under gravity of readings that turn, in rad/Nm, and ``elastic_sliding`` of those that
    slide, in m/N.
    """

    harmonics: Prior | None = None
    elastic: Prior | None = None
    elastic_sliding: Prior | None = None

    def by_name(self, robot: Robot, terms: Sequence[JointTerm]) -> dict[str, Prior]:
        """Return the priors of these terms of a robot by their names; terms without one are left out."""
        dimensions = {reading.name: reading.dimension for reading in robot.readings}

        def prior(term: JointTerm) -> Prior | None:
            if term.kind == "elastic":
                return self.elastic if dimensions[term.reading] == "angle" else self.elastic_sliding
            return self.harmonics if term.order else None

        return {term.name: width for term in terms if (width := prior(term)) is not None}


NO_PRIORS = TermPriors()


@dataclass(frozen=True, slots=True, eq=False)
class ErrorModel:
    """What is unknown about a robot and its set-up. Made by :func:`error_model`.

    ``robot`` is in the frames in which its deviations are named: DH frames where DH parameters are free, and ``dh``
    then says what these are. ``offsets``: names of the moving joints whose zero offset is free. ``placements``: pairs
    (chain joint, component) and (DH row, number) that are free, both of them directions of the placements' deviations.
    ``terms``: names of those joint terms of the robot that are free; ``term_priors``: standard deviations, by name, of
    those with a prior, or "learned", as ``prior_length`` and ``prior_angle`` may be. ``base_pose`` (4, 4) and
    ``tool_poses`` are the values where base and tools are fixed.
    ``targets``: what is known of sockets, anchors, balls and planes; ``relations``: what is known between them.
    """

    robot: Robot
    offsets: tuple[str, ...]
    placements: tuple[tuple[str, str], ...]
    base: BaseFreedom
    tool: ToolFreedom
    prior_length: Prior | None = None
    prior_angle: Prior | None = None
    base_pose: Array = field(default_factory=lambda: read_only(np.eye(4)))
    tool_poses: Mapping[str, Array] = field(default_factory=dict)
    dh: DhFrames | None = None
    targets: Mapping[str, Target] = field(default_factory=dict)
    relations: tuple[Relation, ...] = ()
    terms: tuple[str, ...] = ()
    term_priors: Mapping[str, Prior] = field(default_factory=dict)

    def within(self, sets: Sequence[Measurements]) -> "ErrorModel":
        """Return the model without what is known of targets that no row of the sets is about."""
        there = {name for data in sets for name in data.seen_targets}
        return replace(
            self,
            targets={name: target for name, target in self.targets.items() if name in there},
            relations=tuple(relation for relation in self.relations if there.issuperset(relation.targets)),
        )

    @property
    def urdf_robot(self) -> Robot:
        """The robot in the frames of its URDF, as :func:`calib.load_robot` made it."""
        return self.robot if self.dh is None else self.dh.source

    def urdf_deviations(self, deviations: Deviations) -> Deviations:
        """Return the deviations of ``urdf_robot`` that make the same machine as ``deviations`` make of ``robot``."""
        return deviations if self.dh is None else self.dh.in_source(deviations)

    def parameters(self, tools: Sequence[str] = ("tool",)) -> tuple[Parameter, ...]:
        """Return the free parameters for measurements made with the named tools, in the order of the state."""
        layout, reach = Layout(self.robot), self.robot.reach
        found: list[Parameter] = []

        def free(name: str, kind: ParameterKind, *direction: tuple[int, float], length: bool) -> None:
            prior = (self.prior_length if length else self.prior_angle) if kind in ("offset", "placement") else None
            group = _GROUPS[kind, length] if prior == "learned" else None
            stated = None if prior == "learned" else prior
            unit: Literal["m", "rad"] = "m" if length else "rad"
            found.append(Parameter(name, unit, kind, direction, stated, group=group, weak=width(kind, unit, reach)))

        for (joint, component), direction in zip(self.placements, self._directions(), strict=True):
            free(f"{joint}.{component}", "placement", *direction, length=component in ("tx", "ty", "tz", "a", "d"))
        for j, i in enumerate(self.robot.moving):
            moving = self.robot.chain[i]
            if moving.name in self.offsets:
                free(f"{moving.name}.offset", "offset", (layout.offsets + j, 1.0), length=moving.type == "prismatic")
        dimensions = {reading.name: reading.dimension for reading in self.robot.readings}
        for t, term in enumerate(self.robot.terms):
            if term.name in self.terms:
                unit = term.unit(dimensions.get(term.reading, "angle"))
                prior = self.term_priors.get(term.name)
                group = group_of(term, dimensions.get(term.reading, "angle")) if prior == "learned" else None
                stated = None if prior == "learned" else prior
                direction = ((layout.terms + t, 1.0),)
                size = ordinary(unit)
                found.append(Parameter(term.name, unit, "term", direction, stated, size, group, weak=TERM_WIDTH * size))
        if self.base == "pose":
            for k, component in enumerate(POSE):
                free(f"base.{component}", "base", (layout.base + k, 1.0), length=k < 3)
        for t, tool in enumerate(tools):
            prefix = "tool" if tool == "tool" else f"tool.{tool}"
            for k, component in enumerate(POSE[: {"fixed": 0, "position": 3, "pose": 6}[self.tool]]):
                free(f"{prefix}.{component}", "tool", (layout.tools + 6 * t + k, 1.0), length=k < 3)
        names = [parameter.name for parameter in found]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise JobError(f"the parameter name {twice[0]!r} means two things: a joint may not be called base or tool.")
        return tuple(found)

    def _directions(self) -> Iterator[Direction]:
        """Yield the entries of the deviations that each of ``placements`` moves, with their shares."""
        number = {joint.name: i for i, joint in enumerate(self.robot.chain)}
        for joint, component in self.placements:
            if component in deviation.COMPONENTS:
                yield ((6 * number[joint] + deviation.COMPONENTS.index(component), 1.0),)
            elif self.dh is not None:
                yield self.dh.directions[joint, component]

    def given_frames(self, tools: Sequence[str]) -> Frames:
        """Return the frames as given: known where fixed, zero or the user's guess where free."""
        return Frames(self.base_pose, np.stack([self.tool_poses.get(tool, np.eye(4)) for tool in tools]))


@checked
def error_model(
    robot: Robot,
    *,
    offsets: Selection = "none",
    placements: Selection = "none",
    dh: Selection = "none",
    dh_convention: Convention = "standard",
    dh_parallel: float = PARALLEL,
    gain: Selection = "none",
    harmonics: Selection = "none",
    harmonic_orders: Sequence[int] = (1, 2),
    elastic: Selection = "none",
    torque: Selection = "none",
    backlash: Selection = "none",
    thermal: Selection = "none",
    moments: Selection = "none",
    bending: Selection = "none",
    expansion: Selection | Literal["arm"] = "none",
    base: BaseFreedom = "pose",
    tool: ToolFreedom = "position",
    prior_length: Prior | None = None,
    prior_angle: Prior | None = None,
    prior_harmonics: Prior | None = None,
    prior_elastic: Prior | None = None,
    prior_elastic_sliding: Prior | None = None,
    base_pose: npt.ArrayLike | None = None,
    tool_poses: Mapping[str, npt.ArrayLike] | None = None,
    targets: Mapping[str, Target] | None = None,
    relations: Sequence[Relation] = (),
) -> ErrorModel:
    """Say which parameters of ``robot`` are unknown.

    ``offsets``: "all" moving joints, "none", or names and globs of moving joints.
    ``placements``: "all" (every component of every moving joint), "none", or names and globs of joints, moving or
    fixed (``"wrist_*"``), or of single components (``"joint_3.rx"``, ``"*.tz"``). The motion along a joint's own axis
    is its offset and never also a placement.
    ``dh``: "all" numbers of all rows of the robot's DH table, "none", or names and globs of rows (``"joint_3"``) or of
    numbers (``"joint_3.a"``, ``"*.alpha"``). A row is named after its joint and has a, d, alpha, theta, and beta in
    place of d where the next axis is parallel to within ``dh_parallel`` rad. What the joint itself moves (theta of a
    revolute one) is freed, and called, ``joint_3.offset``. ``dh_convention``: "standard" or "modified".
    ``gain``, ``harmonics``, ``elastic``, ``torque``, ``backlash``, ``thermal``: "all" readings, "none", or names and
    globs of readings whose scale, whose cosine and sine of all ``harmonic_orders``, whose compliance under gravity or
    under measured torques, whose half gap by the side of approach, whose zero by temperature is unknown. Masses are
    those of the URDF, and RobotError says what is wrong with them; torques, sides and temperatures are columns of the
    measurements. ``moments`` in the place of ``elastic``, for robots without masses: compliances times masses at a few
    joints. ``bending``: "all" moving joints, "none", or names and globs of joints, the links before which bend under
    gravity. ``expansion``: likewise the links that grow as it gets warmer, or "arm", all of them by one coefficient.
    Neither goes with ``dh``. Without a prior of their own (``prior_harmonics``, rad; ``prior_elastic`` where the
    reading turns, rad/Nm, and ``prior_elastic_sliding``, m/N) amounts of terms have none.
    ``base``: pose of the base in the instrument's frame, free ("pose") or "fixed" at ``base_pose`` (4, 4); where
    nothing is measured in an instrument's frame, it stays at ``base_pose``.
    ``tool``: pose or point of each tool in the tip link, free or "fixed" at ``tool_poses[name]`` ((4, 4), or (3,) for
    a point); the only tool is called "tool". No start value is needed for what is free.
    ``targets``: what is known of sockets, anchors, balls and planes by name; others are found. ``relations``: what is
    known between targets.
    ``prior_length`` (m) and ``prior_angle`` (rad): standard deviations of a prior on every offset and placement.
    Any prior may be "learned": parameters that are alike - all link translations, all link rotations, all joint
    offsets, the harmonics of one reading, all compliances - then share a width, the likeliest one.

    Raises JobError when a name or glob matches nothing, a value is not of its kind, or a placement and a DH number move
    the same frame.
    """
    moving = [robot.chain[i] for i in robot.moving]
    # A passive joint of a closed loop is where the loop puts it; an offset of it would mean nothing.
    read = [joint.name for j, joint in enumerate(moving) if j not in robot.passive]
    chosen_offsets = _select(offsets, read, "offsets")
    every = [
        (joint.name, component)
        for joint in robot.chain
        for component in deviation.COMPONENTS
        if component != {"revolute": "rz", "prismatic": "tz", "fixed": None}[joint.type]
    ]
    names = [f"{joint}.{component}" for joint, component in every]
    if isinstance(placements, str):
        movers = {joint.name for joint in moving}
        chosen = {"all": [f"{j}.{c}" for j, c in every if j in movers], "none": []}.get(placements)
        if chosen is None:
            raise JobError(f'placements: {placements!r} is not "all", "none" or a list of joint names.')
    else:
        joints = {joint for joint, _ in every}
        # A joint's own name stands for its components; a joint name may itself hold dots.
        patterns = [p if fnmatch.filter(names, p) and p not in joints else f"{p}.*" for p in placements]
        chosen = _select(patterns, names, "placements")
    for name, key, value in (
        ("prior length", "prior.length", prior_length),
        ("prior angle", "prior.angle", prior_angle),
        ("prior harmonics", "prior.harmonics", prior_harmonics),
        ("prior elastic", "prior.elastic", prior_elastic),
        ("prior elastic sliding", "prior.elastic of readings that slide", prior_elastic_sliding),
    ):
        if isinstance(value, str) and value != "learned":
            raise JobError(f'{name}: {value!r} is neither a positive number nor "learned".')
        if value is not None and not isinstance(value, str):
            if not value > 0.0:
                raise JobError(f"{name}: {value!r} is not a positive number; leave it out for no prior.")
            refuse_beyond(value, key, name)
    dimensions = {reading.dimension for reading in robot.readings}
    for value, unit, needed, does in (
        (prior_elastic, "rad/Nm", "angle", "turns"),
        (prior_elastic_sliding, "m/N", "length", "slides"),
    ):
        if value not in (None, "learned") and needed not in dimensions:
            raise JobError(f"prior.elastic: {unit} is of a joint that {does}, and the arm has none that is read.")
    for name, value_, allowed in (
        ("base", base, ("pose", "fixed")),
        ("tool", tool, ("pose", "position", "fixed")),
        ("dh_convention", dh_convention, get_args(Convention)),
    ):
        if value_ not in allowed:
            raise JobError(f"{name}: {value_!r} is not one of {', '.join(allowed)}.")
    if not (np.isfinite(dh_parallel) and 0.0 <= dh_parallel <= 0.5):
        raise JobError(f"dh_parallel: {dh_parallel!r} is not an angle between 0 and 0.5 rad.")
    freed = [pair for pair, name in zip(every, names, strict=True) if name in set(chosen)]
    for name, target in (targets or {}).items():
        refuse_beyond(target.pose[:3, 3], "position, station, point", f"target {name!r}")
    frames = None if isinstance(dh, str) and dh == "none" else dh_frames(robot, dh_convention, dh_parallel)
    if frames is not None:
        numbers, own = _select_dh(dh, frames)
        _refuse_shared_frames(frames, freed, numbers)
        freed += numbers
        chosen_offsets = [joint.name for joint in moving if joint.name in {*chosen_offsets, *own}]
    names = [reading.name for reading in robot.readings]
    terms = (
        *terms_of(
            robot,
            _select(gain, names, "gain"),
            _select(harmonics, names, "harmonics"),
            harmonic_orders,
            {
                "elastic": _select(elastic, names, "elastic"),
                "torque": _select(torque, names, "torque"),
                "backlash": _select(backlash, names, "backlash"),
                "thermal": _select(thermal, names, "thermal"),
            },
        ),
        *moments_of(robot, _select(moments, names, "moments")),
        *(JointTerm(joint, "bending") for joint in _select_links(robot, bending, "bending")),
        *(
            JointTerm(joint, "expansion")
            for joint in (
                [""]
                if isinstance(expansion, str) and expansion == "arm"
                else _select_links(robot, expansion, "expansion", "arm")
            )
        ),
    )
    model = ErrorModel(
        robot if frames is None else frames.robot,
        tuple(chosen_offsets),
        tuple(freed),
        base,
        tool,
        prior_length,
        prior_angle,
        read_only(np.eye(4)) if base_pose is None else _given_pose(base_pose, "base_pose"),
        {name: _given_pose(value, f"tool {name!r}") for name, value in (tool_poses or {}).items()},
        frames,
        dict(targets or {}),
        tuple(relations),
    )
    priors = TermPriors(prior_harmonics, prior_elastic, prior_elastic_sliding)
    return with_terms(model, terms, priors.by_name(robot, terms))


def with_terms(model: ErrorModel, terms: Sequence[JointTerm], priors: Mapping[str, Prior] | None = None) -> ErrorModel:
    """Return the model with these joint terms, all of them free, in the place of its own.

    ``priors``: standard deviations of their amounts, by name and in SI units, or "learned"; where there is none, none.
    Raises JobError for a link that gives way where DH parameters are free: their frames are not at its ends.
    """
    if model.dh is not None and (of_link := next((term for term in terms if term.of_link), None)):
        raise JobError(
            f"{of_link.kind}: links give way between joints of the URDF; free placements in the place of dh."
        )
    source = with_joint_terms(model.urdf_robot, terms)
    robot = replace(model.robot, terms=source.terms, weights=source.weights)
    dh = None if model.dh is None else replace(model.dh, source=source, robot=robot)
    names = tuple(term.name for term in terms)
    return replace(model, robot=robot, dh=dh, terms=names, term_priors={} if priors is None else dict(priors))


def corrected_dh(model: ErrorModel, deviations: Deviations) -> DhTable:
    """Return the DH table with the estimates filled in: its tips are those of the machine with ``deviations``.

    The deviations are those of ``fit.machine``; joint terms are no part of a table. Raises JobError when the model has
    no DH parameters, or the machine deviates in ways that a DH table does not hold.
    """
    if model.dh is None:
        raise JobError("dh: no DH parameter is free, so that there is no table; take that of the calibrated URDF.")
    try:
        return model.dh.table(deviations)
    except RobotError as e:
        raise JobError(f"dh: {e}") from e


def _select_dh(dh: Selection, frames: DhFrames) -> tuple[list[tuple[str, str]], list[str]]:
    """Return the chosen numbers (row, number) of the DH table, and the joints of those that are offsets."""
    own = {(row.joint, own_motion(row)): row.joint for row in frames.rows}
    every = {
        f"{row.joint}.{number}": (row.joint, number)
        for row in frames.rows
        for number in NUMBERS
        if (row.joint, number) in own or (row.joint, number) in frames.directions
    }
    if not isinstance(dh, str):
        dropped = {f"{joint}.{number}" for joint, number in frames.dropped}
        if alone := next((name for name in dh if name in dropped), None):
            raise JobError(
                f"dh: {alone!r} slides along an axis that is parallel to the next, where beta takes its place; a "
                "smaller dh_parallel brings it back, if the axes are not quite parallel."
            )
        joints = {row.joint for row in frames.rows}
        dh = [p if fnmatch.filter(every, p) and p not in joints else f"{p}.*" for p in dh]
    chosen = [every[name] for name in _select(dh, list(every), "dh")]
    return [pair for pair in chosen if pair not in own], [own[pair] for pair in chosen if pair in own]


def _refuse_shared_frames(
    frames: DhFrames, placements: Sequence[tuple[str, str]], numbers: Sequence[tuple[str, str]]
) -> None:
    """Raise JobError when a joint's placement is free in its own components and as a DH number: two names for one."""
    chain = frames.source.chain
    moved = {chain[frames.owner[entry // 6]].name: pair for pair in numbers for entry, _ in frames.directions[pair]}
    for joint, component in placements:
        if joint in moved:
            raise JobError(
                f"placements: '{joint}.{component}' and the DH parameter {'.'.join(moved[joint])!r} move the same "
                "frame; free one or the other."
            )


def _select(selection: Selection, names: Sequence[str], what: str, *words: str) -> list[str]:
    """Return the names that are chosen. ``words``: what else than "all" and "none" would be allowed."""
    if isinstance(selection, str):
        if selection not in ("all", "none"):
            allowed = ", ".join(f'"{word}"' for word in (*words, "all", "none"))
            raise JobError(f"{what}: {selection!r} is not {allowed} or a list of names.")
        return list(names) if selection == "all" else []
    chosen: set[str] = set()
    for pattern in selection:
        found = fnmatch.filter(names, pattern)
        if not found:
            stem = pattern.removesuffix(".*")
            likest = near(stem, [*names, *(n.rpartition(".")[0] for n in names)], 1)
            hint = f"did you mean {likest[0]!r}?" if likest else f"there are {', '.join(names[:8])}, ..."
            raise JobError(f"{what}: {stem!r} matches no joint of the arm; {hint}")
        chosen.update(found)
    return [name for name in names if name in chosen]


def _select_links(robot: Robot, selection: Selection, what: str, *words: str) -> list[str]:
    """Return the chosen links with a length, by the joint that each one ends in; all are those before moving joints."""
    every = isinstance(selection, str)
    known = links(robot, moving=every)
    joints = {joint.name for joint in robot.chain} - set(known)
    if not every and (short := next((name for name in selection if name in joints), None)):
        raise JobError(f"{what}: there is no link before {short!r}, which stands where the joint before it does.")
    return _select(selection, known, what, *words)


def _given_pose(value: npt.ArrayLike, where: str) -> Array:
    array = np.asarray(value, dtype=np.float64)
    if array.shape == (3,) and np.all(np.isfinite(array)):
        array = rigid.translation(array)
    if array.shape != (4, 4) or not np.all(np.isfinite(array)) or not _rigid(array):
        raise JobError(f"{where}: needs a point (3,) in m or a rigid placement (4, 4).")
    refuse_beyond(array[:3, 3], "position, station, point", where)
    return read_only(array)


def _rigid(T: Array) -> bool:
    R = T[:3, :3]
    turns = np.allclose(R @ R.T, np.eye(3), atol=1e-6) and np.linalg.det(R) > 0.0
    return bool(turns and np.array_equal(T[3], (0.0, 0.0, 0.0, 1.0)))
