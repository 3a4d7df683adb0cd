"""Base and tool of a calibrated machine, found anew where they explain new measurements best."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.foundations.chance import exceeded
from calib.foundations.linear import triangle
from calib.foundations.words import counted
from calib.identification.initialisation.base_and_tools import KnownFrames, TipObservations, base_and_tools
from calib.machine.calibrated import CalibratedMachine
from calib.machine.tool_uncertainty import row_freedom
from calib.measurement.measurements import Measurements
from calib.robot.robot import TipModel

# What is found anew.
Anew = Literal["base", "tool", "both"]
WAYS: tuple[Anew, ...] = get_args(Anew)
_FEWEST = 3
# A motion that rows see so much less than another one, in m and turns about the reach: of a base by places in line,
# and of base and tool, where the tip turns about one axis.
_NEARLY_NOT, _HARDLY = 1e-6, 1e-2
# A machine that has not changed is failed once in so many tests.
SIGNIFICANCE = 0.01


def not_shown(machine: CalibratedMachine, data: Measurements, what: Anew) -> str | None:
    """Return why the rows do not show the frames that are to be found anew; None where they do."""
    setups, tools = np.unique(data.setup), np.unique(data.tool)
    places = [(f"at set-up {data.setups[k]!r}", data.setup == k) for k in (() if what == "tool" else setups)]
    held = [(f"of the tool {data.tools[k]!r}", data.tool == k) for k in (() if what == "base" else tools)]
    for frames in (places, held):
        for name, own in frames:
            if (n := int(np.count_nonzero(own))) < _FEWEST:
                few = f"{counted(n, 'row')}{f' {name}' if len(frames) > 1 else ''} {'is' if n == 1 else 'are'} too few"
                return f"{few} to find the {'base' if frames is places else 'tool'} anew; it takes three"
    if what == "both" and len(setups) > 1:
        return "base and tool are found anew together in one set-up at a time"
    if what != "base" and data.points is not None:
        return "every row has a point of its own in the tool's frame, so that rows do not show where the tool is"
    if data.sigma.size <= 6 * len(places) + data.sigma.shape[1] * len(held):
        sought = "base and tool" if what == "both" else f"the {what}"
        return f"{counted(len(data), 'row')} are too few to find {sought} anew"
    if what != "tool" and _shown(machine, data, "base") < _NEARLY_NOT:
        return "all rows are at one place or in line, which do not show where the base is; it takes three places"
    return None


def realigned(machine: CalibratedMachine, data: Measurements, what: Anew) -> CalibratedMachine:
    """Return the machine with the base, in every set-up of the rows, or tools, where they explain these best."""
    tips = machine.tips(data.readings, data.conditions)
    turned = np.full((len(data), 3, 3), np.nan) if data.orientation is None else data.orientation
    tools = machine.state.frames.tools
    assert data.position is not None, "positions and poses have one"
    if what == "tool":
        # All set-ups together, in the axes of the base.
        inverse = rigid.inverse(machine.state.frames.bases)[data.setup]
        at = (inverse[:, :3, :3] @ data.position[:, :, None])[..., 0] + inverse[:, :3, 3]
        rows = TipObservations(tips, at, inverse[:, :3, :3] @ turned, data.tool)
        return _with_tools(machine, base_and_tools(rows, KnownFrames(np.eye(4), None, None), tools).tools)
    bases = machine.bases
    if what == "both":
        (setup,) = {data.setups[k] for k in data.setup}
        found = base_and_tools(
            TipObservations(tips, data.position, turned, data.tool), KnownFrames(None, None, None), tools
        )
        bases[setup], machine = found.base, _with_tools(machine, found.tools)
    else:
        known = KnownFrames(None, np.zeros((1, 3)), np.eye(3)[None])
        placed = tips @ data.placed_by(tools)
        for k in np.unique(data.setup):
            own = data.setup == k
            rows = TipObservations(placed[own], data.position[own], turned[own], np.zeros(own.sum(), dtype=np.intp))
            bases[data.setups[k]] = base_and_tools(rows, known, np.eye(4)[None]).base
    return replace(machine, base=bases.pop(machine.setup), others=bases)


def _with_tools(machine: CalibratedMachine, tools: Array) -> CalibratedMachine:
    return replace(machine, tools=dict(zip(machine.tools, tools, strict=True)))


def motion(
    machine: CalibratedMachine, found: CalibratedMachine, data: Measurements, what: Anew
) -> tuple[tuple[float, float] | None, tuple[float, float] | None]:
    """Return by how much bases and tools have moved, in m at their origins, and rad: where they did most.

    None for what was not found anew, and where rows hardly tell a base that moves from a tool that does.
    """
    if what == "both" and _shown(machine, data, what) < _HARDLY:
        return None, None
    return (
        None if what == "tool" else _largest(machine.bases, found.bases),
        None if what == "base" else _largest(machine.tools, found.tools),
    )


def _largest(before: Mapping[str, Array], after: Mapping[str, Array]) -> tuple[float, float]:
    changes = np.array([rigid.inverse(before[name]) @ after[name] for name in before])
    lengths, angles = rigid.lengths_and_angles(changes)
    return max(zip(lengths.tolist(), angles.tolist(), strict=True))


def offset_alike(
    machine: CalibratedMachine,
    found: CalibratedMachine,
    data: Measurements,
    what: Anew,
    whitened: Callable[[Array], Array],
) -> str | None:
    """Return the reading whose offset, changed, explains the rows as all frames ``found`` anew do; None without one.

    ``whitened``: what whitens residuals (N, d, k), to (N d, k). The first joint turns the arm as a base that moves, and
    the last one as a tool; so does, nearly, one whose axis is nearly at the same place in all rows. Of several, the
    one that explains them best.
    """
    tips, by_reading = TipModel(machine.robot, machine.deviations).driven(data.readings, data.conditions)
    # In the axes of the base a joint that nothing carries moves the tip about the same axis wherever it is; in those of
    # the tip, one that carries nothing else.
    twists = rigid.adjoint(tips) @ by_reading if what == "base" else by_reading
    frames, moved, by_offset = list[Array](), np.zeros(data.sigma.shape), np.zeros((*data.sigma.shape, twists.shape[2]))
    for name, columns in _by_frame(found, data, what):
        move, by_twist = _move(machine, found, name, what, columns.shape[2])
        frames.append(columns)
        moved += columns @ move
        by_offset += columns @ by_twist @ twists
    B, told = whitened(np.concatenate(frames, axis=2)), whitened((found.residuals(data) + moved)[:, :, None])[:, 0]
    by_frames, _, rank, _ = np.linalg.lstsq(B, told)
    left = told - B @ by_frames
    J = whitened(by_offset)
    rest = told[:, None] - J * (told @ J / np.maximum((J * J).sum(axis=0), np.finfo(float).tiny))
    more = (rest * rest).sum(axis=0) - left @ left
    best = int(np.argmin(more))
    freedom = float(row_freedom(machine, data).min())
    if exceeded(float(more[best]), max(int(rank) - 1, 1), freedom) < SIGNIFICANCE:
        return None
    return str(machine.robot.readings[best].name)


def _move(
    machine: CalibratedMachine, found: CalibratedMachine, name: str, what: Anew, size: int
) -> tuple[Array, Array]:
    """Return how a frame has moved, a local twist or shift (size,), and what a twist of the arm would do (size, 6)."""
    before, after = (one.bases[name] if what == "base" else one.tools[name] for one in (machine, found))
    change = rigid.inverse(before) @ after
    shift, w = change[:3, 3], rigid.log3(change[:3, :3])
    move = np.concatenate([rigid.left_jacobian_inverse(w) @ shift, w])[:size]
    if what == "base":
        return move, np.eye(6)
    # In the middle of its way a point that turns moves straight to its end.
    middle = rigid.translation(0.5 * shift if size == 3 else np.zeros(3))
    return move, rigid.adjoint(rigid.inverse(before @ middle))[:size]


def frame_columns(machine: CalibratedMachine, data: Measurements, what: Anew) -> Array:
    """Return how residuals (N, d) follow the frames found anew (N, d, k): local twists of every base and every tool.

    Of a tool of which no orientation was measured, shifts alone.
    """
    return np.concatenate([columns for _, columns in _by_frame(machine, data, what)], axis=2)


def _by_frame(machine: CalibratedMachine, data: Measurements, what: Anew) -> Iterator[tuple[str, Array]]:
    """Yield every base and every tool that is found anew, by its name, and how residuals follow it (N, d, k)."""
    if what == "both":
        yield from _by_frame(machine, data, "base")
        what = "tool"
    in_base = data.tips(machine.robot, machine.deviations) @ data.placed_by(machine.state.frames.tools)
    turned = (machine.state.frames.bases[data.setup] @ in_base)[:, :3, :3]
    # Residuals count turns about the tool's axes.
    moves = np.tile(np.eye(6), (len(data), 1, 1)) if what == "tool" else rigid.adjoint(rigid.inverse(in_base))
    moves[:, :3] = turned @ moves[:, :3]
    d = data.sigma.shape[1]
    moves = moves[:, :d, : d if what == "tool" else 6]
    names, which = (data.tools, data.tool) if what == "tool" else (data.setups, data.setup)
    for k in np.unique(which):
        yield names[k], np.where((which == k)[:, None, None], moves, 0.0)


def _shown(machine: CalibratedMachine, data: Measurements, what: Anew) -> float:
    """Return how well rows see the motion of the frames that they see least, to the one that they see best."""
    units = np.repeat([1.0, data.reach(machine.robot)], 3)
    columns = [columns / units[: columns.shape[2]] for _, columns in _by_frame(machine, data, what)]
    values = np.linalg.svd(triangle(np.concatenate(columns, axis=2).reshape(data.sigma.size, -1)), compute_uv=False)
    return float(values[-1] / values[0])
