"""The error model: which parameters of a robot and its set-up are unknown."""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from calib.foundations import rigid
from calib.foundations.arguments import checked, own_fields, told
from calib.foundations.arrays import Array, read_only
from calib.foundations.brief import brief
from calib.foundations.errors import JobError, RobotError
from calib.foundations.ranges import MOST_TERMS, refuse_beyond
from calib.foundations.sealing import sealed
from calib.foundations.selection import Selection, listed_names, named, select
from calib.foundations.words import refuse_other
from calib.identification.machine import POSE, Frames, Layout
from calib.identification.parameters import TERM_WIDTH, WIDER_TERM, Parameter, ParameterKind, Priors, Wider, width
from calib.identification.relations import Relation
from calib.identification.set_ups import SetUp
from calib.identification.targets import Target
from calib.measurement.measurements import ONLY_SETUP, ONLY_TOOL, Measurements
from calib.robot import deviation
from calib.robot.dh.frames import DhFrames, Direction, dh_frames, own_motion
from calib.robot.dh.free import Free
from calib.robot.dh.table import NUMBERS, DhTable
from calib.robot.joint_terms import foreign, ordered, parts, with_joint_terms
from calib.robot.robot import Deviations, Robot
from calib.robot.terms import KINDS, JointTerm, kind_of

BaseFreedom = Literal["pose", "fixed"]
ToolFreedom = Literal["pose", "position", "fixed"]

# Parameters that are alike share a prior whose width is learned; by kind, and whether they are lengths.
_GROUPS = {
    ("placement", True): "link translations",
    ("placement", False): "link rotations",
    ("offset", True): "offsets of joints that slide",
    ("offset", False): "offsets of joints that turn",
}


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Known:
    """What is known beside the robot itself.

    ``base``: its pose (4, 4) in the instrument's frame, where it is fixed. ``tools``: their poses (4, 4), or points
    (3,), in the tip link, by name; the only tool is called "tool". ``targets``: of sockets, anchors, balls and planes,
    by name; others are found. ``relations``: what is known between targets. ``setups``: the base in each set-up, by
    name, exactly or with a prior; the only set-up is called "base".
    """

    base: npt.ArrayLike | None = None
    tools: Mapping[str, npt.ArrayLike] = field(default_factory=dict)
    targets: Mapping[str, Target] = field(default_factory=dict)
    relations: Sequence[Relation] = ()
    setups: Mapping[str, SetUp] = field(default_factory=dict)

    def __post_init__(self) -> None:
        own_fields(self)
        if self.base is not None:
            _given_pose(self.base, "known.base")
        for name, tool in self.tools.items():
            _given_pose(tool, f"known.tools: {name!r}")


NOTHING_KNOWN = Known()
NO_PRIORS = Priors()


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class ErrorModel:
    """What is unknown about a robot and its set-up. Made by :func:`error_model`.

    ``robot`` is in the frames in which its deviations are named: these are DH frames if DH parameters are free, and
    ``dh`` then describes them. ``offsets``: names of the moving joints whose offset is free. ``placements``: the free
    pairs (chain joint, component) and (DH row, number); both are directions of the placements' deviations. ``terms``:
    names of the free joint terms of the robot. ``base_pose`` (4, 4) and ``tool_poses``: the values of base and tools
    that are fixed; ``setups``: what is known of the base in single set-ups.
    ``targets``: what is known of sockets, anchors, balls and planes; ``relations``: what is known between them.
    """

    __repr__ = brief

    robot: Robot
    offsets: tuple[str, ...]
    placements: tuple[tuple[str, str], ...]
    base: BaseFreedom
    tool: ToolFreedom
    priors: Priors = NO_PRIORS
    base_pose: Array = field(default_factory=lambda: read_only(np.eye(4)))
    tool_poses: Mapping[str, Array] = field(default_factory=dict)
    dh: DhFrames | None = None
    targets: Mapping[str, Target] = field(default_factory=dict)
    relations: tuple[Relation, ...] = ()
    terms: tuple[str, ...] = ()
    setups: Mapping[str, SetUp] = field(default_factory=dict)

    @checked
    def within(self, sets: Sequence[Measurements]) -> "ErrorModel":
        """Return the model without what is known of targets and set-ups that no row of the sets is about."""
        there = {name for data in sets for name in data.seen_targets}
        stood = {name for data in sets for name in data.setups}
        return replace(
            self,
            setups={name: setup for name, setup in self.setups.items() if name in stood},
            targets={name: target for name, target in self.targets.items() if name in there},
            relations=tuple(relation for relation in self.relations if there.issuperset(relation.targets)),
        )

    @property
    def urdf_robot(self) -> Robot:
        """The robot in the frames of its URDF, as :func:`calib.load_robot` made it."""
        return self.robot if self.dh is None else self.dh.source

    @checked
    def urdf_deviations(self, deviations: Deviations) -> Deviations:
        """Return the deviations of ``urdf_robot`` that make the same machine as ``deviations`` make of ``robot``."""
        return deviations if self.dh is None else self.dh.in_source(deviations)

    @checked
    def at(self, setup: str) -> "ErrorModel":
        """Return the model of one set-up, as if there were no other."""
        known = self.known_base(setup)
        if known is None:
            return replace(self, base="pose", setups={})
        return replace(self, base="fixed" if known.fixed else "pose", base_pose=known.pose, setups={})

    @checked
    def known_base(self, setup: str) -> SetUp | None:
        """Return what is known of the base in a set-up, None where it is to be found."""
        if setup in self.setups or self.base == "pose":
            return self.setups.get(setup)
        return SetUp(self.base_pose)

    @checked
    def parameters(
        self, tools: Sequence[str] = (ONLY_TOOL,), setups: Sequence[str] = (ONLY_SETUP,)
    ) -> tuple[Parameter, ...]:
        """Return the free parameters for measurements with such tools and set-ups, in the order of the state."""
        layout, reach = Layout(self.robot, len(setups)), self.robot.reach
        found: list[Parameter] = []

        def free(
            name: str, kind: ParameterKind, *entries: tuple[int, float], length: bool, setup: SetUp | None = None
        ) -> None:
            priors: Priors | SetUp | None = self.priors if kind in ("offset", "placement") else setup
            prior = None if priors is None else (priors.length if length else priors.angle)
            group = _GROUPS[kind, length] if prior == "learned" else None
            stated = None if prior == "learned" else prior
            unit: Literal["m", "rad"] = "m" if length else "rad"
            found.append(Parameter(name, unit, kind, entries, stated, group=group, weak_prior=width(kind, unit, reach)))

        for (joint, component), entries in zip(self.placements, self._directions(), strict=True):
            free(f"{joint}.{component}", "placement", *entries, length=component in ("tx", "ty", "tz", "a", "d"))
        for j, i in enumerate(self.robot.moving):
            moving = self.robot.chain[i]
            if moving.name in self.offsets:
                free(f"{moving.name}.offset", "offset", (layout.offsets + j, 1.0), length=moving.type == "prismatic")
        dimensions = {reading.name: reading.dimension for reading in self.robot.readings}
        for t, term in enumerate(self.robot.terms):
            if term.name in self.terms:
                kind, dimension = kind_of(term), dimensions.get(term.reading, "angle")
                unit, size = kind.coefficient(term, dimension)
                prior = self.priors.of_term(term, dimension)
                alike = kind.group(term, dimension)
                group = alike if prior == "learned" else None
                stated = None if prior == "learned" else prior
                entries = ((layout.terms + t, 1.0),)
                weak = TERM_WIDTH * size
                # A time constant, in decades, is no size.
                wider = Wider(WIDER_TERM * weak, alike) if stated is None and unit != "decade" else None
                found.append(Parameter(term.name, unit, "term", entries, stated, size, group, weak, wider))
        for s, setup in enumerate(setups):
            known = self.known_base(setup)
            prefix = "base" if setup == ONLY_SETUP else f"base.{setup}"
            for k, component in enumerate(POSE if known is None or not known.fixed else ""):
                free(f"{prefix}.{component}", "base", (layout.base + 6 * s + k, 1.0), length=k < 3, setup=known)
        for t, tool in enumerate(tools):
            prefix = "tool" if tool == ONLY_TOOL else f"tool.{tool}"
            for k, component in enumerate(POSE[: {"fixed": 0, "position": 3, "pose": 6}[self.tool]]):
                free(f"{prefix}.{component}", "tool", (layout.tools + 6 * t + k, 1.0), length=k < 3)
        names = [parameter.name for parameter in found]
        if twice := sorted(name for name, count in Counter(names).items() if count > 1):
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

    @checked
    def given_frames(self, tools: Sequence[str], setups: Sequence[str] = (ONLY_SETUP,)) -> Frames:
        """Return the frames as given: known where fixed, zero or the user's start value where free."""
        known = [self.known_base(setup) for setup in setups]
        bases = [self.base_pose if setup is None else setup.pose for setup in known]
        own = [self.tool_poses.get(tool, np.eye(4)) for tool in tools]
        return Frames(np.array(bases).reshape(-1, 4, 4), np.array(own).reshape(-1, 4, 4))


@checked
def error_model(
    robot: Robot,
    *,
    offsets: Selection = "none",
    placements: Selection | Free = "none",
    terms: Mapping[str, object] | Sequence[JointTerm] = (),
    base: BaseFreedom = "pose",
    tool: ToolFreedom = "position",
    priors: Priors = NO_PRIORS,
    known: Known = NOTHING_KNOWN,
) -> ErrorModel:
    """Say which parameters of ``robot`` are unknown.

    ``offsets``: "all" moving joints, "none", or names and globs of moving joints.
    ``placements``: "all" (every component of every moving joint, and of the frames where loops close), "none", or names
    and globs of joints, moving or fixed (``"wrist_*"``), or of single components (``"joint_3.rx"``, ``"*.tz"``). The
    motion along a joint's own axis is its offset and never also a placement. Or :class:`calib.dh.Free`: numbers of the
    robot's DH table.
    ``terms``: joint terms as the keys of a job choose them, ``{"gain": "all", "harmonics": ["joint_1"],
    "harmonic_orders": (1, 2), "expansion": "arm"}``, each "all" readings or links, "none", or names and globs; or
    :class:`calib.JointTerm` themselves. Masses are those of the URDF, and RobotError says what is wrong with them;
    torques, sides and temperatures are columns of the measurements. Terms of links cannot be combined with DH numbers.
    ``base``: pose of the base in the instrument's frame, free ("pose") or "fixed" at ``known.base``; where nothing is
    measured in an instrument's frame, it stays there.
    ``tool``: pose or point of each tool in the tip link, free or "fixed" at ``known.tools[name]``. No start value is
    needed for what is free.
    ``priors``: how far parameters are expected to be from nominal; ``known``: where base, tools and targets are.

    Raises JobError when a name or glob matches nothing, a value is not of its kind, or a placement and a DH number move
    the same frame.
    """
    moving = [robot.chain[i] for i in robot.moving]
    # A passive joint of a closed loop is where the loop puts it; an offset of it would mean nothing.
    read = [joint.name for j, joint in enumerate(moving) if j not in robot.passive]
    chosen_offsets = select(offsets, read, "offsets")
    dh = placements if isinstance(placements, Free) else Free("none", placements=placements)
    freed = _select_placements(robot, dh.placements)
    _refuse_priors(priors, robot)
    refuse_other(base, get_args(BaseFreedom), "base")
    refuse_other(tool, get_args(ToolFreedom), "tool")

    seeks_dh = not (isinstance(dh.numbers, str) and dh.numbers == "none")
    frames = dh_frames(robot, dh.convention, dh.parallel) if seeks_dh else None
    if frames is not None:
        numbers, own = _select_dh(dh.numbers, frames)
        _refuse_shared_frames(frames, freed, numbers)
        freed += numbers
        chosen_offsets = [joint.name for joint in moving if joint.name in {*chosen_offsets, *own}]
    model = ErrorModel(
        robot if frames is None else frames.robot,
        tuple(chosen_offsets),
        tuple(freed),
        base,
        tool,
        priors,
        read_only(np.eye(4)) if known.base is None else _given_pose(known.base, "known.base"),
        {name: _given_pose(value, f"known.tools: {name!r}") for name, value in known.tools.items()},
        frames,
        dict(known.targets),
        tuple(known.relations),
        setups={
            name: replace(setup, pose=_given_pose(setup.pose, f"known.setups: {name!r}"))
            for name, setup in known.setups.items()
        },
    )
    return with_terms(model, _chosen_terms(robot, terms))


def _select_placements(robot: Robot, placements: Selection) -> list[tuple[str, str]]:
    """Return the chosen pairs (joint, component); "all" are those of joints that move, and of where loops close."""
    every = {
        f"{joint.name}.{component}": (joint.name, component)
        for joint in robot.chain
        for component in deviation.COMPONENTS
        if component != {"revolute": "rz", "prismatic": "tz", "fixed": None}[joint.type]
    }
    if isinstance(placements, str):
        if placements not in ("all", "none"):
            raise JobError(f'placements: {placements!r} is not "all", "none" or a list of joint names.')
        movers, ends = {robot.chain[i].name for i in robot.moving}, _loop_ends(robot)
        return [pair for pair in every.values() if placements == "all" and (pair[0] in movers or pair in ends)]
    joints = {joint.name for joint in robot.chain}
    return [every[name] for name in _select_parts(placements, list(every), joints, "placements")]


def _loop_ends(robot: Robot) -> set[tuple[str, str]]:
    """Return the pairs (joint, component) of the frames where loops close, as of the far pin of a rod.

    A fixed joint before one that moves is part of the placement of that one. Behind a pin none moves, so that the
    length of its bar is in no other placement. How the second frame of a loop is turned does not matter.
    """
    parts = deviation.COMPONENTS, deviation.COMPONENTS[:3]
    return {
        (robot.chain[joint].name, component)
        for loop in robot.closed_loops
        for link, own in zip(loop.frames, parts, strict=True)
        if (joint := robot.carrier(link)) >= 0
        for component in own
    }


def _select_parts(selection: Selection, names: Sequence[str], owners: Collection[str], what: str) -> list[str]:
    """Return the chosen names like ``joint_3.rx``; a joint's own name, which may itself hold dots, is all of its."""
    chosen: list[str] = []
    for pattern in listed_names(selection, what):
        own = [name for name in names if pattern in owners and name.rpartition(".")[0] == pattern]
        chosen += own or [pattern if named(pattern, names) else f"{pattern}.*"]
    return select(chosen, names, what)


def _chosen_terms(robot: Robot, terms: Mapping[str, object] | Sequence[JointTerm]) -> tuple[JointTerm, ...]:
    """Return the terms that keys of a job choose, or those that are given."""
    if isinstance(terms, Mapping):
        options = {name: option for kind in KINDS for name, option in kind.options.items()}
        known = [kind.key for kind in KINDS] + list(options)
        for key, value in terms.items():
            if key not in known:
                raise JobError(f"terms: there are no {key!r}; allowed are {', '.join(known)}.")
            if key in options and not options[key].holds(value):
                raise JobError(f"{key}: {told(value)} is not {options[key].what}.")
        of = parts(robot)
        return ordered(robot, (t for kind in KINDS for t in kind.chosen(terms.get(kind.key, "none"), of, terms)))
    given = tuple(terms)
    if alien := foreign(robot, given):
        raise JobError(f"terms: {alien.name!r} belongs to no joint or link of the robot.")
    if twice := next((term for term, count in Counter(given).items() if count > 1), None):
        raise JobError(f"terms: {twice.name!r} comes twice.")
    return given


def _refuse_priors(priors: Priors, robot: Robot) -> None:
    """Raise JobError for a prior of a joint that the arm does not have."""
    dimensions = {reading.dimension for reading in robot.readings}
    for kind in KINDS:
        for dimension, name in kind.priors.items():
            if getattr(priors, name) not in (None, "learned") and dimension not in dimensions:
                raise JobError(
                    f"prior.{kind.key}: {kind.coefficients[dimension].unit} is for a joint that "
                    f"{'turns' if dimension == 'angle' else 'slides'}, and the arm has no such joint with a reading."
                )


def with_terms(model: ErrorModel, terms: Sequence[JointTerm]) -> ErrorModel:
    """Return the model with these joint terms, all of them free, in the place of its own.

    Raises JobError for a link that gives way where DH parameters are free: their frames are not at its ends; and for
    very many terms.
    """
    if len(terms) > MOST_TERMS:
        raise JobError(f"the model has {len(terms)} joint terms; allowed are {MOST_TERMS}.")
    if model.dh is not None and (of_link := next((term for term in terms if kind_of(term).of_link), None)):
        raise JobError(
            f"{kind_of(of_link).key}: links bend and expand between joints of the URDF; free placements instead of dh."
        )
    source = with_joint_terms(model.urdf_robot, terms)
    robot = replace(model.robot, terms=source.terms, weights=source.weights)
    dh = None if model.dh is None else replace(model.dh, source=source, robot=robot)
    return replace(model, robot=robot, dh=dh, terms=tuple(term.name for term in terms))


def corrected_dh(model: ErrorModel, deviations: Deviations) -> DhTable:
    """Return the DH table with the estimates filled in: its tips are those of the machine with ``deviations``.

    The deviations are those of ``fit.machine``; joint terms are no part of a table. Raises JobError when the model has
    no DH parameters, or the machine deviates in ways that a DH table does not hold.
    """
    if model.dh is None:
        raise JobError("dh: no DH parameter is free, so there is no DH table; make one of the calibrated URDF.")
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
        if alone := next((name for name in listed_names(dh, "dh") if name in dropped), None):
            raise JobError(
                f"dh: {alone!r} slides along an axis that is parallel to the next, where beta is used instead; if "
                "the axes are not quite parallel, give a smaller dh_parallel."
            )
        names = _select_parts(dh, list(every), {row.joint for row in frames.rows}, "dh")
    else:
        names = select(dh, list(every), "dh")
    chosen = [every[name] for name in names]
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


def _given_pose(value: npt.ArrayLike, where: str) -> Array:
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if array.shape == (3,) and np.all(np.isfinite(array)):
        array = rigid.translation(array)
    if array.shape != (4, 4) or not rigid.are_placements(array[None])[0]:
        raise JobError(f"{where}: needs a point (3,) in m or a rigid placement (4, 4).")
    refuse_beyond(array[:3, 3], "position, station, point", where)
    return read_only(array)
