"""The calibrated machine: what an identification has found, whole, for all that judges or uses it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from calib.foundations.arguments import checked, own_fields
from calib.foundations.arrays import Array, IntArray, read_only
from calib.foundations.errors import MeasurementError, RobotError
from calib.foundations.ranges import are_numbers, refuse_no_placement
from calib.foundations.sealing import sealed
from calib.foundations.words import listed, not_calibrated
from calib.identification.machine import Frames, Layout, Machine
from calib.machine.place import Placed
from calib.machine.residual_model import ResidualModel, shifted
from calib.machine.tool_motion import tool_jacobian
from calib.machine.uncertainty import Uncertainty
from calib.measurement.measurements import ONLY_SETUP, Measurements, refuse_absent
from calib.measurement.streams.stream import SHIFTS
from calib.robot.conditions import NO_CONDITIONS, Conditions
from calib.robot.joint_terms import in_setup
from calib.robot.robot import Deviations, Robot, refuse_other_deviations
from calib.robot.terms import kind_of


@dataclass(frozen=True, slots=True, eq=False, repr=False)
@sealed
class CalibratedMachine:
    """A calibrated machine. Made by :func:`machine_of` from a fit, or read by :func:`calib.load_machine`.

    ``robot`` and ``deviations``: in the frames of its URDF. ``base`` (4, 4): the robot's base in the instrument's
    frame, in the set-up named ``setup``; ``others``: the same for other set-ups, by name. ``tools``: poses (4, 4) in
    the tip link, by name; ``tool_tips``: the links of those tools that are on another link. ``residual_model``: a
    function of the joint readings for the remaining errors of tool positions, or None. ``uncertainty``: the
    uncertainty of the whole machine, or None where it is not known. ``in_urdf``: the best machine that a URDF can
    hold, with bases and tools of its own, if it differs from this one. ``placed``: in whose frame the bases are, None
    where that is not known.

        machine = calib.machine_of(fit)
        machine.predict(readings)  # (N, 4, 4), tool in the instrument's frame, m
    """

    robot: Robot
    deviations: Deviations
    base: Array
    tools: Mapping[str, Array]
    residual_model: ResidualModel | None = None
    uncertainty: Uncertainty | None = None
    setup: str = ONLY_SETUP
    others: Mapping[str, Array] = field(default_factory=dict)
    tool_tips: Mapping[str, str] = field(default_factory=dict)
    in_urdf: "CalibratedMachine | None" = None
    placed: Placed | None = None

    def __post_init__(self) -> None:
        own_fields(self)
        refuse_other_deviations(self.robot, self.deviations)
        for name, base in self.bases.items():
            refuse_no_placement(base, f"machine: the base {name!r}", RobotError)
        for name, tool in self.tools.items():
            refuse_no_placement(tool, f"machine: the tool {name!r}", RobotError)
        for name, link in self.tool_tips.items():
            if name not in self.tools or link not in self.robot.links:
                raise RobotError(f"machine: the tool {name!r} on {link!r}: there is no such tool, or no such link.")
        known = self.uncertainty
        if known is not None and not len(known.factor) == len(known.null_basis) == self.layout.size:
            raise RobotError(
                f"machine: the uncertainty is of {len(known.factor)} numbers, and the machine has {self.layout.size}: "
                "of a tool or a base that was added nothing is known; leave the uncertainty out."
            )

    @checked
    def of(self, tool: str) -> "CalibratedMachine":
        """Return the same machine, with the link that carries a tool as the tip of its robot.

        Raises MeasurementError for an unknown one.
        """
        tip = self.tool_tips.get(self.tool_named(tool), self.robot.links[0])
        if tip == self.robot.tip:
            return self
        # What is left over was learned at another tip.
        in_urdf = None if self.in_urdf is None else self.in_urdf.of(tool)
        return replace(self, robot=self.robot.with_tip(tip), residual_model=None, in_urdf=in_urdf)

    @property
    def bases(self) -> dict[str, Array]:
        """The poses (4, 4) of the base in all set-ups, by name, that of ``setup`` first."""
        return {self.setup: self.base, **self.others}

    @property
    def layout(self) -> Layout:
        """Which rows of :attr:`Uncertainty.factor` belong to what."""
        return Layout(self.robot, len(self.bases), len(self.tools))

    @checked
    def at(self, setup: str | None) -> "CalibratedMachine":
        """Return the same machine as it stood in a named set-up, with gravity and payload there; as it is for None.

        Raises MeasurementError for an unknown one.
        """
        bases = self.bases
        if setup is None:
            return self
        if setup not in bases:
            raise MeasurementError(f"{not_calibrated('set-up', setup, bases)}.")
        k, start, end = list(bases).index(setup), self.layout.base, self.layout.tools
        rows = np.arange(self.layout.size)
        bases_first = rows[start:end].reshape(-1, 6)
        rows[start:end] = np.concatenate([bases_first[k : k + 1], bases_first[:k], bases_first[k + 1 :]]).ravel()
        known_too = None
        if self.uncertainty is not None:
            factor, null_basis = (
                read_only(part[rows]) for part in (self.uncertainty.factor, self.uncertainty.null_basis)
            )
            known_too = replace(self.uncertainty, factor=factor, null_basis=null_basis)
        others = {name: base for name, base in bases.items() if name != setup}
        in_urdf = None if self.in_urdf is None else self.in_urdf.at(setup)
        return replace(
            self,
            robot=in_setup(self.robot, setup),
            setup=setup,
            base=bases[setup],
            others=others,
            uncertainty=known_too,
            in_urdf=in_urdf,
        )

    @property
    def sags_by_set_up(self) -> bool:
        """Whether what its joint terms do may differ from set-up to set-up, by gravity or payload."""
        return bool(self.robot.terms and self.robot.loads and len(self.bases) > 1)

    @checked
    def standing(self, setup: str | None, where: str) -> "CalibratedMachine":
        """Return the same as :meth:`at`, for what depends on the set-up: which one is not guessed.

        ``where``: what the machine was read from. Raises MeasurementError for an unknown set-up, and for None where
        there are several.
        """
        if setup is None and len(self.bases) > 1:
            raise MeasurementError(
                f"{where}: was calibrated in several set-ups, {listed(self.bases)}; say which one is meant, by setup."
            )
        return self.at(setup)

    @checked
    def tips(self, readings: Array, conditions: Conditions = NO_CONDITIONS) -> Array:
        """Return the placements (N, 4, 4) of the tip link in the base link at readings (N, nr), in rad and m.

        Positions include what the residual model adds, which is nothing where it has no data. Raises RobotError for
        readings of another shape and for a joint term that needs ``conditions`` which are not given, PoseError for a
        row where a loop cannot close.
        """
        return shifted(self.residual_model, self.robot.tips(readings, self.deviations, conditions), readings)

    @checked
    def predict(self, readings: Array, *, tool: str = "tool", conditions: Conditions = NO_CONDITIONS) -> Array:
        """Return the placements (N, 4, 4) of a tool in the instrument's frame at readings (N, nr), in rad and m.

        Raises MeasurementError for an unknown tool, RobotError for payloads that terms of unknown masses cannot follow,
        and as :meth:`tips` does.
        """
        refuse_unfollowed(self.robot, conditions)
        return np.asarray(self.base @ self.of(tool).tips(readings, conditions) @ self.tools[tool])

    @checked
    def tool_jacobian(self, readings: Array, *, tool: str = "tool", conditions: Conditions = NO_CONDITIONS) -> Array:
        """Return the derivatives of the tool's pose by the state of the machine (N, 6, n), at readings (N, nr).

        Rows: position in the instrument's axes, in m, and small turns about the tool's axes, in rad. Columns: as the
        rows of :attr:`Uncertainty.factor`. Without the residual model, whose derivatives are negligible.
        """
        number = list(self.tools).index(self.tool_named(tool))
        own = self.of(tool).robot
        return tool_jacobian(own, self.state, own.own(readings), conditions, number)

    @checked
    def residuals(self, data: Measurements) -> Array:
        """Return measured minus predicted (N, 3 or 6) of positions or poses, in m and rad.

        Positions in the instrument's axes, turns in the tool's. Raises MeasurementError for other kinds of data.
        """
        if data.position is None:
            raise MeasurementError(f"{data.where}: a machine by itself predicts positions and poses, not {data.kind}.")
        # What a fit evaluates, too, takes its time to load, and most read machines that they do not compare with rows.
        from calib.identification.system import residuals  # noqa: PLC0415

        data = self.with_own_names(data)
        (r,) = residuals(self.robot, [data], self.state)
        return self.less_shifts(r, data)

    @checked
    def less_shifts(self, residuals: Array, data: Measurements) -> Array:
        """Return residuals (N, 3 or 6) of positions or poses less what the residual model adds to the prediction."""
        if self.residual_model is None or (data.tip and data.tip != self.robot.tip):
            return residuals
        found, tips = np.array(residuals), data.tips(self.robot, self.deviations)
        for number, name in enumerate(data.setups):
            rows = data.setup == number
            if name in self.bases and rows.any():
                found[rows, :3] -= self.residual_model.shifts(self.bases[name], tips[rows], data.readings[rows])
        return found

    @checked
    def with_own_names(self, data: Measurements) -> Measurements:
        """Return the data with tools and set-ups numbered as the machine's, under the loads of these set-ups.

        Raises MeasurementError for others, for streams by a clock that only their fit knows, and where joints are not
        told whose arm weighs on joints of these rows.
        """
        if not data.uses.keys().isdisjoint(SHIFTS):
            raise MeasurementError(
                f"{data.where}: its clock is free, and a machine by itself does not know it; judge these rows with "
                "their fit, by calib.assess."
            )
        data = data.loaded(self.robot)

        def numbers(what: str, own: Sequence[str], names: Sequence[str]) -> IntArray:
            for name in names:
                if name not in own:
                    raise MeasurementError(f"{data.where}: {_not_identified(what, name, own)}")
            return np.array([own.index(name) for name in names], dtype=np.intp)

        for name in (data.tools[k] for k in np.unique(data.tool)):
            if name in self.tools and data.tip and (tip := self.of(name).robot.tip) != data.tip:
                raise MeasurementError(
                    f"{data.where}: the tool {name!r} is on {tip!r}, and the rows are of {data.tip!r}."
                )
        tools, setups = tuple(self.tools), tuple(self.bases)
        number, place = numbers("tool", tools, data.tools), numbers("set-up", setups, data.setups)
        refuse_absent(self.robot, data)
        return replace(data, tools=tools, tool=number[data.tool], setups=setups, setup=place[data.setup])

    @property
    def state(self) -> Machine:
        """The machine as identification has it; angles of base and tools are counted from where they are."""

        def twists(T: Array) -> Array:
            W = np.eye(6)
            W[:3, :3] = T[:3, :3].T
            return W

        tools = np.array(list(self.tools.values())).reshape(-1, 4, 4)
        by_tool = np.array([twists(T) for T in tools]).reshape(-1, 6, 6)
        bases = np.array(list(self.bases.values()))
        by_base = np.array([twists(T) for T in bases])
        return Machine(self.deviations, Frames(bases, tools), by_base, by_tool, np.zeros((0, 6, 6)))

    @property
    def geometry(self) -> "CalibratedMachine":
        """The best that a format without joint terms and closed loops can hold: ``in_urdf``, or else the machine."""
        return self if self.in_urdf is None else self.in_urdf

    @property
    def known_uncertainty(self) -> Uncertainty:
        """The uncertainty. Raises MeasurementError where it is not known."""
        if self.uncertainty is None:
            raise MeasurementError(
                f"{self.robot.urdf.where}: the machine's uncertainty is not known; calibrate it again, or load the "
                "whole folder of its results."
            )
        return self.uncertainty

    @checked
    def tool_named(self, tool: str) -> str:
        """Return the name of a tool. Raises MeasurementError when there is none of this name."""
        if tool not in self.tools:
            raise MeasurementError(f"{not_calibrated('tool', tool, self.tools)}.")
        return tool

    def __repr__(self) -> str:
        joints = len(self.robot.readings)
        beside = "" if self.residual_model is None else ", with a residual model"
        said = "not known" if self.uncertainty is None else "known"
        return (
            f"<CalibratedMachine {self.robot.urdf.where} to {self.robot.tip!r}: {joints} joints, tools "
            f"{', '.join(self.tools)}{beside}; its uncertainty is {said}>"
        )


def refuse_unfollowed(robot: Robot, conditions: Conditions) -> None:
    """Raise RobotError for payloads other than the robot's where a term takes masses for unknown and the same."""
    blind = next((term for term in robot.terms if kind_of(term).masses == "unknown"), None)
    if blind is None or conditions.payload is None:
        return
    for own in (robot.payload, *(load.payload for load in robot.loads.values())):
        if np.all(np.isnan(conditions.payload) | (conditions.payload == robot.moments(own))):
            return
    raise RobotError(
        f"{blind.name} takes all masses as they were when it was identified, and cannot follow another payload; leave "
        "the payload out, or calibrate with terms of stated masses, such as elastic."
    )


def readings_of(machine: CalibratedMachine, readings: npt.ArrayLike) -> Array:
    """Return readings (N, nr) of a machine, one row or more. Raises MeasurementError for others."""
    found, width = np.asarray(readings, dtype=np.float64), len(machine.robot.readings)
    if found.ndim != 2 or found.shape[1] != width or not len(found) or not are_numbers(found):
        raise MeasurementError(f"readings of shape {found.shape}: needs finite numbers (N, {width}), one row or more.")
    return found


def _not_identified(what: str, name: str, own: Sequence[str]) -> str:
    """Return what to say of rows of a tool or set-up that a machine does not have."""
    if what == "tool":
        return f"{not_calibrated(what, name, own)}."
    if name == ONLY_SETUP:
        return f"no column says in which set-up the rows were measured; known are {listed(own)}: name one by setup."
    return (
        f"{not_calibrated(what, name, own)}. Where only the base is new, such rows are judged as of a known one, with "
        f"its base found anew: ignore the column, name setup {own[0]!r} and find its base anew (--refit-base)."
    )
