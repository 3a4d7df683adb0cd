"""Checks of the arm and its surroundings: whether what was found, or given, is plausible."""

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.assessment.blame import Blame
from calib.assessment.effects import per_metre
from calib.assessment.judged import NOTHING, Check, JudgedSet
from calib.assessment.stretches import Stretch
from calib.foundations.arrays import Array, BoolArray
from calib.foundations.linear import Gathered, svd
from calib.foundations.units import DEG, MM
from calib.foundations.words import first_of, shown
from calib.identification.fit import Fit
from calib.identification.identifiability import MOVED, NUMERICAL_TOLERANCE
from calib.identification.machine import values_at
from calib.identification.mirrored import FAR_TOOL
from calib.identification.parameters import Parameter, scales
from calib.identification.system import Problem, related
from calib.identification.tool_motions import tool_motions
from calib.measurement.checks import Finding
from calib.measurement.measurements import Measurements
from calib.measurement.optics import SCALE as OF_BOARD
from calib.robot.robot import ChainJoint

# What a joint that did not move leaves, in rad or m.
REST = 1e-4
# Shares by which all links, or one, may differ in length from the URDF, and a length that any may; standard errors. An
# instrument whose scale is off looks like links that all are, which explains so much of what their lengths do: with the
# place of one arm off beside another it was 0.71.
SCALE, LINK, LINK_LENGTH, SURE, ALIKE = 0.015, 0.04, 0.025, 6.0, 0.9
# From here on users are told what a share may be: links of sound arms, with 0.5 mm in each length, are not so alike.
TOLD_SCALE, TOLD_ALIKE = 0.002, 0.8
# In m, rms: a common share that moves the tool by less is how links of any arm err. Of sound arms with 0.5 mm in each
# length it was 0.6 mm at the most; 5 % more length moved the tool of the smallest arm that was tried by 3.8 mm. Arms of
# 5 mm and of 20 m err by as small a share of themselves: shares of the reach below which lengths in m are too many, and
# above which too few.
SCALED = 2e-3
LEAST_SCALED, MOST_SCALED, MOST_LINK = 1e-3, 3e-3, 0.1
# Scales of a parameter that may take up a common share, beside what rows say.
PLAUSIBLE = 10.0
# Kinds of which a row tells a length that may be far shorter than the arm.
SHORT = ("sphere", "pair_distance")
# Of the six numbers of a deviation so many are shifts; the rest are turns.
_AXES = 3
# In m: a tool point from its link, the base from the instrument.
FAR_BASE = 100.0
# A joint offset above it, in rad, is another zero and no error; a fit that leaves a smaller share of the spread
# explains why the nominal robot misses.
OTHER_ZERO, EXPLAINS = 10.0 * DEG, 0.01
# Warnings about the input that count.
COUNTED = (
    "unexplained",
    "radians-as-degrees",
    "metres-as-millimetres",
    "not-held-out",
    "copied-rows",
    "nodes-moved",
    "nodes-of-several-setups",
    "prior-contradicted",
    "stated-contradicted",
)


def joints(fit: Fit, own: Sequence[JudgedSet]) -> Check:
    """Whether every joint moved."""
    values = np.concatenate([end.readings for one in own for end in one.data.ends])
    moved = np.ptp(values, axis=0)
    # Joints of other arms that no table needs are no part of what was measured.
    absent = set.intersection(*(set(one.data.absent) for one in own)) if own else set()
    told = [
        (reading.name, by) for reading, by in zip(fit.robot.readings, moved, strict=True) if reading.name not in absent
    ]
    still = [name for name, by in told if by <= REST]
    least = min((float(by) for _, by in told), default=np.inf)
    said = "Every joint moved."
    if still:
        said = (
            f'Never moved, or never read: {", ".join(map(repr, still))}. Where a joint is locked, accept = ["joints"].'
        )
    return Check.of("joints", least, REST, not still, said, least=True)


class CommonScale(NamedTuple):
    """By which ``share`` all links seem longer, with its standard error ``sigma``.

    ``moves``: by how many m, rms, all of it would move the tool, per unit of the share. ``alike``: how much of what
    lengths do to the tool the share explains, of 1. All are nan where nothing shows it.
    """

    share: float
    sigma: float
    moves: float
    alike: float


_NOT_SHOWN = CommonScale(NOTHING, NOTHING, NOTHING, NOTHING)


def lengths(fit: Fit, of_all: CommonScale) -> Check:
    """Whether the links are about as long as the URDF says, all together and each by itself.

    A common scale is sought in what the deviations do to the tool, other parameters taking up what they can: where
    neighbouring joints move the tool alike, it says nothing how a length is shared between them.
    """
    _, moved = _of_links(fit)
    owner = range(len(fit.robot.chain)) if fit.model.dh is None else fit.model.dh.owner
    free = {owner[k] for p in np.flatnonzero(moved).tolist() for k, _, _ in _shifts(fit.parameters[p])}
    worst, link = _most_wrong(fit, sorted(free))
    scale, sigma, moves, alike = of_all
    most = LINK if alike < ALIKE and abs(scale) > SCALE else SCALE
    reach = fit.reach
    scaled_least = min(max(SCALED, LEAST_SCALED * reach), MOST_SCALED * reach)
    if abs(scale) > max(most, SURE * sigma) and abs(scale) * moves > scaled_least:
        said = (
            f"All links seem {100.0 * scale:+.2g} % longer than in the URDF: is it the URDF of this robot, and are the "
            "instrument's lengths, and those stated, true?"
        )
        return Check.of("lengths", abs(scale), most, False, said)
    if worst > 1.0:
        return Check.of("lengths", worst * LINK, LINK, False, f"{link}: is it the URDF of this robot?")
    if not moved.any():
        said = "No lengths were free."
    elif abs(scale) > most:
        said = "Little tells whether all links are longer than in the URDF."
        scale, most = NOTHING, SCALE
    elif np.isnan(scale):
        said = "Nothing tells whether all links are longer than in the URDF."
    else:
        said = f"Links seem {100.0 * scale:+.2g} % longer than in the URDF."
    return Check.of("lengths", abs(scale), most, True, said)


def as_by_scale(fit: Fit, of_all: CommonScale) -> tuple[str, ...]:
    """Return what a user should know where all links seem longer by one share, as by the scale of an instrument.

    Rows do not tell that from an arm that is so. The scale of a board that is stated with a prior is counted.
    """
    if any(map(is_stated_scale, fit.parameters)):
        return ()
    if not (of_all.alike >= TOLD_ALIKE and abs(of_all.share) > max(TOLD_SCALE, SURE * of_all.sigma)):
        return ()
    return (
        f"All links seem {100.0 * of_all.share:+.2g} % longer than in the URDF, alike, as they would by a wrong scale "
        "of the instrument, or of lengths and places that are stated. If it is that, and not the arm, the tool is "
        "wrong by as much, which regions do not count: measure a known length.",
    )


def _of_links(fit: Fit) -> tuple[Array, BoolArray]:
    """Return by how much every parameter (p,) makes links longer by their own length, and which are such lengths."""
    chain, shifts = fit.model.robot.chain, [_shifts(parameter) for parameter in fit.parameters]
    free = {k for own in shifts for k, _, _ in own}
    scaled = np.zeros(len(fit.parameters))
    moved = np.zeros(len(fit.parameters), dtype=np.bool_)
    for p, own in enumerate(shifts):
        for k, axis, by in own:
            T = _link(chain, k, free)
            # A deviation is in the joint's own frame. A DH number is one of several of them, in fixed shares.
            scaled[p] += by * (T[:3, :3].T @ T[:3, 3])[axis]
            moved[p] = True
    return scaled, moved


def _shifts(parameter: Parameter) -> list[tuple[int, int, float]]:
    """Return which links' lengths a parameter changes: joint of the model's robot, axis, and by how much per unit."""
    entries = parameter.entries if parameter.kind == "placement" else ()
    return [(entry // 6, entry % 6, by) for entry, by in entries if entry % 6 < _AXES]


def _link(chain: Sequence[ChainJoint], k: int, free: Collection[int]) -> Array:
    """Return where joint k is (4, 4) in the link that carries it, of the joints with ``free`` lengths one link each.

    A length may be written in fixed joints before a joint, which then stands at zero in the last of them. Those that
    only say where the arm stands are no length of it.
    """
    own = T = np.asarray(chain[k].placement)
    before = chain[k].parent
    while before >= 0 and chain[before].type == "fixed" and before not in free:
        T, before = chain[before].placement @ T, chain[before].parent
    return T if before >= 0 else own


def _most_wrong(fit: Fit, joints: Sequence[int]) -> tuple[float, str]:
    """Return how far the link that is farthest from the URDF is off, of what it may, and what is said of it.

    ``joints``: those with free lengths, by number.
    """
    worst, link, short = 0.0, "", min(LINK_LENGTH, MOST_LINK * fit.reach)
    for k in joints:
        T, own = _link(fit.robot.chain, k, joints), fit.deviations.placements[k, :3]
        length = float(np.linalg.norm(T[:3, 3]))
        by = float(T[:3, 3] @ T[:3, :3] @ own) / length if length > 0.0 else float(np.linalg.norm(own))
        beside = float(np.sqrt(max(float(own @ own) - by**2, 0.0)))
        name = repr(fit.robot.chain[k].name)
        for off, of, said in (
            (abs(by), length, f"The distance to joint {name} differs by {_in_mm(by)} from the URDF"),
            (beside, fit.reach, f"Joint {name} is {_in_mm(beside)[1:]} beside its place in the URDF"),
        ):
            if off > worst * max(LINK * of, short):
                worst, link = off / max(LINK * of, short), said
    return worst, link


def _in_mm(length: float) -> str:
    return f"{length / MM:+.0f} mm" if abs(length) >= 10.0 * MM else f"{length / MM:+.2g} mm"


def common_scale(fit: Fit, parts: Sequence[Stretch]) -> CommonScale:
    """Return by which share all links of an arm seem longer than in its URDF.

    Other parameters take up what they can: where these are most of it, such as where joints slide, little is left that
    tells a share. A length known between targets tells it as rows do; it moves what was touched by its own share. Balls
    and gauges tell it by a length that is short beside the arm's: of these the tool itself is asked. Else a board whose
    scale is known nearly tells it: :func:`_by_scales`.
    """
    scaled, moved = _of_links(fit)
    if not moved.any() or not parts:
        return _NOT_SHOWN
    own = parts[0].columns
    known, sigmas = _known_lengths(fit)
    rows = Gathered(len(own))
    rows.add(*(part.J for part in parts), known[:, None, own])
    R = rows.triangle
    # By a share of the lengths as they are: of a set-up that may grow unseen, rows do not show that at all.
    values, units, moved = (
        np.column_stack([fit.values, scaled + fit.values])[own],
        scales(fit.parameters)[own],
        moved[own],
    )
    longer = values[moved] / units[moved, None]
    x = R[:, moved] @ longer
    every = float(x[:, 1] @ x[:, 1])
    # From the root of a sum of squares over all rows to m, rms.
    per_row = 1.0 / (float(np.sqrt(sum(len(part.r) for part in parts))) * per_metre(parts))
    if share := _by_scales(R, values[:, 0] / units, [fit.parameters[k] for k in own]):
        return CommonScale(*share, float(np.sqrt(every)) * per_row, 1.0)
    others = R[:, ~moved]
    held = [max(q.hold, 1.0 / PLAUSIBLE) if q.of_robot else q.hold for q in (fit.parameters[k] for k in own)]
    hold = np.array(held)[~moved]
    # Not by metres and radians, of which a little shows where axes that should be parallel are nearly so.
    taken = np.linalg.lstsq(np.vstack([others, np.diag(hold)]), np.vstack([x, np.zeros((len(hold), 2))]), rcond=None)[0]
    left = np.vstack([x - others @ taken, -hold[:, None] * taken])
    square = float(left[:, 1] @ left[:, 1])
    if square <= 1e-6 * every:
        return _NOT_SHOWN
    apart = known[:, own][:, moved] @ longer - known[:, own][:, ~moved] @ taken
    by_rows = float(np.sum(left[: len(x), 1] ** 2) - apart[:, 1] @ apart[:, 1])
    moves = float(np.sqrt(max(by_rows, 0.0))) * per_row
    moves = max(moves, float(np.abs(apart[:, 1] * sigmas).max(initial=0.0)))
    directions = np.zeros((len(fit.parameters), 2))
    directions[own[moved]], directions[own[~moved]] = values[moved], -taken * scales(fit.parameters)[own[~moved], None]
    short = [part.data for part in parts if part.data.kind in SHORT]
    of_tool = _of_tool(fit, short, directions)
    moves = max(moves, float(np.sqrt(np.max(of_tool[:, 1, 1], initial=0.0))))
    grams = of_tool if len(short) == len(parts) else (left.T @ left)[None]
    (whole, across), (_, by_share) = grams.sum(axis=0)
    alike = float(across**2 / (by_share * whole)) if whole > 0.0 and by_share > 0.0 else 0.0
    grown = float(left[:, 0] @ left[:, 1]) / square
    of_nominal = 1.0 - grown if grown < 1.0 else NOTHING
    return CommonScale(grown / of_nominal, 1.0 / float(np.sqrt(square)) / of_nominal**2, moves, alike)


def _of_tool(fit: Fit, sets: Sequence[Measurements], directions: Array) -> Array:
    """Return mean products (k, d, d) of how tools move where the rows of k sets were, along directions (p, d).

    In m^2, per unit of directions in SI units. Less what a motion of the whole machine does, which moves its base
    alone. All touches of one ball are at one place, so readings are mixed: the arm is meant, and not what it touched.
    A loop may not close at any readings.
    """
    found, frames = np.zeros((len(sets), directions.shape[1], directions.shape[1])), fit.machine.frames
    still = np.array([parameter.kind != "base" for parameter in fit.parameters])[:, None] * directions
    frames = replace(frames, bases=np.broadcast_to(np.eye(4), frames.bases.shape))
    standing = replace(fit, machine=replace(fit.machine, frames=frames))
    for k, rows in enumerate(sets):
        n, readings = rows.readings.shape[0], rows.readings
        if not fit.model.robot.loops:
            readings = np.column_stack([np.roll(q, j * n // len(readings.T)) for j, q in enumerate(readings.T)])
        data = replace(rows, readings=readings)
        by = tool_motions(standing, data, still).reshape(3 * n, -1)
        p = (data.tips(fit.model.robot, fit.machine.deviations) @ fit.tools_of(data))[:, :3, 3]
        turned = np.cross(np.eye(3)[:, None], p - p.mean(axis=0)).transpose(1, 2, 0).reshape(-1, 3)
        whole = np.hstack([turned, np.tile(np.eye(3), (n, 1))])
        rest = by - whole @ np.linalg.lstsq(whole, by, rcond=None)[0]
        found[k] = rest.T @ rest / n
    return found


def is_stated_scale(parameter: Parameter) -> bool:
    """Return whether a parameter is the scale of a board, of which something is stated."""
    return parameter.kind == "instrument" and parameter.name.endswith(f".{OF_BOARD}") and parameter.prior is not None


def _by_scales(R: Array, z: Array, parameters: Sequence[Parameter]) -> tuple[float, float] | None:
    """Return by which share lengths are longer where rows R (k, p) leave the size open, and a scale's prior told it.

    A wrong scale that is held by its prior alone makes the whole arm larger, at values z (p,) in units of the scales.
    Were it free, an arm as near to the nominal one as rows allow would say what it is. Second, the standard error of
    that: as large as what is then left makes it, and as deviations of one scale do. None where no scale is told so.
    """
    priors = [k for k, parameter in enumerate(parameters) if is_stated_scale(parameter)]
    if not priors:
        return None
    _, s, Vt = svd(R)
    N = Vt[np.count_nonzero(s > NUMERICAL_TOLERANCE) :].T
    told = [k for k in priors if np.linalg.norm(N[k]) > MOVED]
    if not told:
        return None
    robot = np.array([parameter.of_robot for parameter in parameters], dtype=np.bool_)
    nearer = np.linalg.pinv(N[robot], rcond=1e-9)
    left = z[robot] - N[robot] @ (nearer @ z[robot])
    size = np.linalg.norm(left) / np.sqrt(max(np.count_nonzero(robot) - np.linalg.matrix_rank(N[robot], tol=1e-9), 1))
    units = np.array([parameters[k].scale for k in told])
    shares = N[told] @ (nearer @ z[robot]) * units
    errors = np.linalg.norm(N[told] @ nearer, axis=1) * units * max(size, 1.0)
    most = int(np.argmax(np.abs(shares)))
    return float(shares[most]), float(errors[most])


def _known_lengths(fit: Fit) -> tuple[Array, Array]:
    """Return how lengths known between targets follow the parameters (k, p), whitened, and their sigmas (k,) in m."""
    lengths = tuple(relation for relation in fit.model.relations if relation.kind != "angle")
    if not lengths:
        return np.zeros((0, len(fit.parameters))), np.zeros(0)
    frames, deviations = fit.machine.frames, fit.machine.deviations
    problem = Problem(fit.model, fit.parameters, frames, fit.measurements, deviations, lengths, fit.losses)
    x = values_at(fit.model.robot, fit.parameters, frames, deviations)
    return related(problem, x)[:, :-1], np.array([relation.sigma for relation in lengths])


def tool_and_base(fit: Fit) -> Check:
    """Whether tools are within reach of their link, and the base within sight."""
    free = {parameter.kind for parameter in fit.parameters}
    reach = max(fit.reach, FAR_TOOL)
    found = []
    if "tool" in free:
        far = float(np.linalg.norm(fit.machine.frames.tools[:, :3, 3], axis=1).max(initial=0.0))
        found.append((far / reach, f"A tool point is {far:.2g} m from its link"))
    if "base" in free:
        far = float(np.linalg.norm(fit.machine.frames.bases[:, :3, 3], axis=1).max())
        found.append((far / FAR_BASE, f"The base is {far:.2g} m from the instrument"))
    if not found:
        return Check.idle("tool and base", 1.0, "Base and tool were given.")
    share, said = max(found)
    return Check.judged("tool and base", share, 1.0, said, ", farther than is plausible.")


def lens(fit: Fit) -> Check:
    """Whether the lens is an unknown where the arm's placements are, so that they do not pay for its errors.

    Pixels held out do not tell: on photographs of a real arm a lens that was given a little wrong foretold them better
    and left the arm worse.
    """
    if not any(parameter.kind == "placement" for parameter in fit.parameters):
        return Check.idle("lens", 0.0, "No placement is sought.")
    given = [data.camera.name for data in fit.measurements if data.camera is not None and not data.camera.free]
    if not given:
        return Check.idle("lens", 0.0, "No lens is taken as given.")
    said = (
        f"The lens of {given[0]!r} is taken as given and placements are free: an error of the lens is then taken for "
        'one of the arm, and no uncertainty counts it. Write lens = "free", and the size of the images; or, where the '
        'lens was calibrated for this, accept = ["lens"].'
    )
    return Check.of("lens", len(given), 0.0, False, said)


def wrong_lens(blame: Blame) -> Check:
    """Whether photographs held out contradict a lens that is taken as given; no answer of a user makes it right."""
    lens = next(cause for cause in blame.causes if cause.name == "lens")
    without = float(np.hypot(blame.left, lens.beside or 0.0))
    said = (
        f"A lens is taken as given, and is another one: with it {without:.2g} px of photographs held out are left, and "
        f'{blame.left:.2g} px with the lens free. Write lens = "free", and the size of the images.'
    )
    return Check.of("lens", without / blame.left, float(np.sqrt(2.0)), not blame.lens_is_wrong, said)


def naming_zeros(fit: Fit, findings: Sequence[Finding], left: float) -> tuple[Finding, ...]:
    """Return findings; that nothing explains the miss of the nominal robot names the joint offsets that do.

    ``left``: of the spread, after the fit. A user alone knows whether the readings have other zeros than the URDF.
    """
    far = [
        f"{shown(parameter.name.removesuffix('.offset'))} by {value / DEG:+.0f} deg"
        for parameter, value in zip(fit.parameters, fit.values, strict=True)
        if parameter.kind == "offset" and parameter.unit == "rad" and abs(value) > OTHER_ZERO
    ]
    if not far or left > EXPLAINS:
        return tuple(findings)
    more = (
        f" The fit explains it by joint offsets: {', '.join(first_of(far))}. Where the readings have these zeros, "
        "calibrate again with calibrated.urdf of this result as the URDF."
    )
    return tuple(replace(one, sentence=one.sentence + more) if one.code == "unexplained" else one for one in findings)


def warnings(findings: Sequence[Finding]) -> Check:
    """Whether what looked wrong in the input was set right."""
    open_ = [f for f in findings if f.severity == "error" or f.code in COUNTED]
    said = "No warning about the input is open." if not open_ else open_[0].sentence
    return Check.of("input", len(open_), 0.0, not open_, said)
