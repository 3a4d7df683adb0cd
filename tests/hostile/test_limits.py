"""Small files made to take long or to swell: what bounds them; scripts/development/hostile_files.py measures."""

from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from calib.foundations.errors import CalibError, JobError, MeasurementError, RobotError
from calib.foundations.ranges import COUNTS, MOST_LOOPS, MOST_NAMES, MOST_RELATED, MOST_TARGETS, MOST_TOUCHED
from calib.identification import sanity
from calib.identification.error_model import Known, error_model
from calib.identification.identify import identify
from calib.identification.relations import Relation
from calib.job.chains import chains, whole_chains
from calib.job.foreign import picks
from calib.job.foreign.seen import Seen
from calib.job.inputs import load
from calib.job.propose import propose
from calib.job.stated import load_arm
from calib.measurement import roles
from calib.measurement.kinds import Kind
from calib.measurement.read import read_measurements
from calib.presentation import meshes, scene
from calib.presentation.meshes import simplified
from calib.presentation.thin_meshes import ThinMesh, thin_mesh
from calib.presentation.visuals import MOST_SHAPES, visuals
from calib.robot import joint_terms
from calib.robot.links import arm_of, link_placements
from calib.robot.load import load_robot
from calib.robot.mesh_counts import MOST_CORNERS, MOST_PARTS, counts
from calib.robot.mesh_files import parse_mesh
from calib.robot.robot import ClosedLoop
from calib.robot.urdf import MOST_JOINTS, MOST_LINKS, Urdf, parse_urdf, read_urdf
from scripts.development import hostile_files
from scripts.development.hostile_files import HOSTILE, fill

GREY = (0.5, 0.5, 0.5)
# For a file of each kind how many bytes are beyond its limit.
TOO_MANY = {
    "levels": ("levels", COUNTS["levels"], 6_000),
    "measurements": ("measurements", COUNTS["measurements"], 20_000),
    "targets": ("targets", COUNTS["targets"], 20_000),
    "relations": ("relations", COUNTS["relations"], 90_000),
    "tools": ("tools", COUNTS["tools"], 20_000),
    "instruments": ("instruments", COUNTS["instruments"], 20_000),
    "couplings": ("robot.coupling", COUNTS["robot.coupling"], 20_000),
    "loops": ("robot.loop", COUNTS["robot.loop"], 10_000),
    "mesh roots": ("robot.mesh_roots", COUNTS["robot.mesh_roots"], 2_000),
    "drivers": ("robot.coupling[0].drivers", COUNTS["robot.coupling.drivers"], 5_000),
    "orders": ("error_model.harmonic_orders", COUNTS["error_model.harmonic_orders"], 500),
    "columns": ("measurements[0].columns", COUNTS["measurements.columns"], 20_000),
    "other names": ("measurements[0].targets", COUNTS["measurements.targets"], 20_000),
    "placements": ("error_model.placements", MOST_NAMES, 10_000),
    "offsets": ("error_model.offsets", MOST_NAMES, 20_000),
}


@pytest.mark.parametrize("name", TOO_MANY)
def test_lists_of_a_job_end(tmp_path: Path, name: str) -> None:
    key, most, size = TOO_MANY[name]
    fill(name, tmp_path, size)
    with pytest.raises(CalibError) as caught:
        load_arm(tmp_path / "calibration.toml")
    said = str(caught.value).removeprefix(f"{tmp_path}/calibration.toml: ")
    assert said.startswith(f"{key}: has ")
    assert said.endswith(f" entries; allowed are {most}.")


@pytest.mark.parametrize(("name", "what"), [("points", "'tool'"), ("one socket", "")])
def test_unknowns_of_tables_end(tmp_path: Path, name: str, what: str) -> None:
    fill(name, tmp_path, 40_000 if name == "points" else 2_600_000)
    robot = load_robot(tmp_path / "arm_cmm.urdf", "probe")
    kind: Kind = "position" if name == "points" else "socket"
    if not what:
        assert len(read_measurements(tmp_path / "identification.csv", robot, kind)) > MOST_TARGETS
        return
    with pytest.raises(MeasurementError, match=rf"column {what} has \d+ names; allowed are 100\.$"):
        read_measurements(tmp_path / "identification.csv", robot, kind)


def test_unknowns_of_several_tables_end() -> None:
    robot = load_robot(parse_urdf(hostile_files._chain(2).encode(), "arm.urdf"))
    sets = []
    for k in range(3):
        n = MOST_TARGETS // 2 + 1 if k < 2 else MOST_TARGETS + 1
        table = {
            "j0 [rad]": np.linspace(0.0, 1.0, n),
            "j1 [rad]": np.ones(n),
            "target": [f"t{k}-{i}" for i in range(n)],
        }
        if k == 2:
            with pytest.raises(MeasurementError, match=r"column 'target' has 20001 names; allowed are 20000\.$"):
                read_measurements(table, robot, "socket", sigma=1e-5)
            break
        sets.append(read_measurements(table, robot, "socket", sigma=1e-5))
    with pytest.raises(MeasurementError, match=r"the measurements have 20002 targets together; allowed are 20000\."):
        identify(error_model(robot, offsets="all"), sets)


@pytest.mark.parametrize(("together", "most"), [("", 2500), (", of which 2 move each other,", 2142)])
def test_rows_of_many_loops_end(tmp_path: Path, together: str, most: int) -> None:
    fill("rows of many loops", tmp_path, 75 * 2510)
    table, job = tmp_path / "identification.csv", tmp_path / "calibration.toml"
    if together:  # the second strut stands on the first one
        urdf = tmp_path / "arm_cmm.urdf"
        text = urdf.read_text(encoding="utf-8")
        pin = '<origin xyz="0.3 0.01 0"/><parent link="base_link"/>'
        assert pin in text
        urdf.write_text(text.replace(pin, '<origin xyz="0 0.01 0"/><parent link="p0"/>'), encoding="utf-8")
    lines = table.read_text(encoding="utf-8").splitlines(keepends=True)
    table.write_text("".join(lines[: 2 + most]), encoding="utf-8")
    with pytest.raises(JobError) as caught:
        load(job)
    assert str(caught.value) == (
        f"{job}: robot.loop: the tables have {1 + most} rows; allowed beside 12 closed loops{together} are {most}. "
        "Leave out rows, or loops that move nothing that is measured."
    )


def test_loops_of_an_arm_end(tmp_path: Path) -> None:
    fill("rows of many loops", tmp_path, 1000)
    loops = [
        ClosedLoop(f"l{k}", (f"h{k % 12}", f"s{k % 12}"), ("x", "y"), (f"p{k % 12}", f"s{k % 12}"))
        for k in range(MOST_LOOPS + 1)
    ]
    assert len(load_robot(tmp_path / "arm_cmm.urdf", "probe", loops=loops[:-1]).loops) == MOST_LOOPS
    with pytest.raises(RobotError, match=rf"arm_cmm\.urdf: the arm has 13 closed loops; allowed are {MOST_LOOPS}\.$"):
        load_robot(tmp_path / "arm_cmm.urdf", "probe", loops=loops)


def test_touched_targets_of_a_job_end(tmp_path: Path) -> None:
    fill("unrelated sockets", tmp_path, 60 * (MOST_TOUCHED + 1))
    path = tmp_path / "identification.csv"
    header, *rows = path.read_text(encoding="utf-8").splitlines()
    unique = [f"{row.rpartition(',')[0]},t{k}" for k, row in enumerate(rows)]
    path.write_text("\n".join([header, *unique]) + "\n", encoding="utf-8")
    with pytest.raises(JobError, match=r"the tables have 501 targets that are touched; allowed in a job are 500\. "):
        load(tmp_path / "calibration.toml")


def test_targets_that_relations_join_end() -> None:
    robot = load_robot(parse_urdf(hostile_files._chain(2).encode(), "arm.urdf"))
    n = MOST_RELATED + 1
    table = {f"j{k} [rad]": np.ones(n) for k in range(2)} | {"target": [f"t{i}" for i in range(n)]}
    data = read_measurements(table, robot, "socket", sigma=1e-5)
    pairs = [Relation("distance", (f"t{i}", f"t{(i + 1) % n}"), 1.0, 1e-4) for i in range(n)]
    with pytest.raises(JobError, match=r"^relations: there are 51 targets that relations join; allowed are 50\.$"):
        identify(error_model(robot, offsets="all", known=Known(relations=pairs)), data)
    many = pairs[:1] * (COUNTS["relations"] + 1)
    with pytest.raises(JobError, match=r"^relations: there are 301 relations; allowed are 300\.$"):
        identify(error_model(robot, offsets="all", known=Known(relations=many)), data)


def test_points_that_are_seen_have_any_names() -> None:
    robot = load_robot(parse_urdf(hostile_files._chain(2).encode(), "arm.urdf"))
    n = MOST_TARGETS + 1
    table = {f"j{k} [rad]": np.ones(n) for k in range(2)} | {f"{a} [m]": np.ones(n) for a in "xyz"}
    assert len(read_measurements(table | {"target": [f"t{i}" for i in range(n)]}, robot, sigma=1e-5)) == n


def test_set_ups_and_tools_end_together() -> None:
    robot = load_robot(parse_urdf(hostile_files._chain(2).encode(), "arm.urdf"))
    chance = np.random.default_rng(0)
    table = {f"j{k} [rad]": chance.uniform(-1.0, 1.0, 180) for k in range(2)}
    table |= {f"{a} [m]": chance.normal(size=180) for a in "xyz"}
    table |= {"setup": [f"s{k % 60}" for k in range(180)], "tool": [f"t{k % 45}" for k in range(180)]}
    data = read_measurements(table, robot, sigma=1e-5)
    with pytest.raises(MeasurementError, match=r"^the measurements have 60 set-ups and 45 tools; allowed are 81 tog"):
        identify(error_model(robot, offsets="all"), data)


@pytest.mark.parametrize(("joints", "tried"), [(30, 30), (31, 0)])
def test_mistakes_of_single_readings_are_tried_of_arms_of_some_joints(
    joints: int, tried: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = load_robot(parse_urdf(hostile_files._chain(joints).encode(), "arm.urdf"))
    chance = np.random.default_rng(0)
    table = {f"j{k} [rad]": chance.uniform(-1, 1, 40) for k in range(joints)} | {
        f"{a} [m]": chance.normal(size=40) for a in "xyz"
    }
    data = read_measurements(table, robot, sigma=1e-5)
    asked: list[int] = []
    monkeypatch.setattr(sanity, "_of_readings", lambda readings, **_: asked.append(len(readings)) or iter(()))
    sanity.signatures(error_model(robot, offsets="all"), [data])
    assert set(asked) == {tried}


@pytest.mark.parametrize("name", ["branches", "a tail", "shapes on branches"])
def test_links_end(tmp_path: Path, name: str) -> None:
    fill(name, tmp_path, 400_000)
    with pytest.raises(RobotError, match=rf"arm_cmm.urdf: has \d+ links; allowed are {MOST_LINKS}\."):
        read_urdf(tmp_path / "arm_cmm.urdf")


def test_mimics_that_multiply(tmp_path: Path) -> None:
    fill("mimics", tmp_path, 20_000)
    with pytest.raises(RobotError, match=r"the multiplier or the offset of them all is above 1e\+06"):
        read_urdf(tmp_path / "arm_cmm.urdf")


def test_mimics_beside_the_arm_follow_over_a_thousand_others() -> None:
    n = 1500
    links = '<link name="a"/><link name="b"/>' + "".join(f'<link name="l{k}"/>' for k in range(n))
    joint = '<joint name="{}" type="prismatic"><parent link="a"/><child link="{}"/><axis xyz="0 0 1"/>{}</joint>'
    follow = [
        joint.format(f"m{k}", f"l{k}", f'<mimic joint="{f"m{k - 1}" if k else "j"}" offset="0.001"/>') for k in range(n)
    ]
    robot = load_robot(
        parse_urdf(f"<robot>{links}{joint.format('j', 'b', '')}{''.join(follow)}</robot>".encode(), "r"), "b"
    )
    arm = arm_of(robot, robot.no_deviations(), np.array([[0.25]]), np.eye(4))
    assert link_placements(robot.urdf, arm)[f"l{n - 1}"][0, 2, 3] == pytest.approx(0.25 + 1.5)


def test_a_robot_of_too_many_shapes_is_drawn_as_sticks(tmp_path: Path) -> None:
    fill("boxes", tmp_path, 80_000)
    urdf = read_urdf(tmp_path / "arm_cmm.urdf")
    found = visuals(urdf, GREY)
    assert sum(map(len, found.values())) > MOST_SHAPES
    assert not any(shape for shapes in found.values() for shape in shapes)


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("dae doubling", 4_000),
        ("dae doubling in the scene", 4_000),
        ("dae of one id", 150_000),
        ("dae instances", 150_000),
        ("dae geometries", 900_000),
        ("dae nodes", 100_000),
        ("glb accessor", 3_000),
        ("glb accessors", 3_000),
        ("glb same points", 150_000),
        ("glb views", 150_000),
        ("glb instances", 150_000),
        ("glb edges", 60_000),
        ("obj materials", 40_000),
        ("obj materials within lines", 40_000),
        ("obj materials over lines", 40_000),
        ("ply lists", 30_000),
        ("stl solids", 150_000),
    ],
)
def test_meshes_that_swell_are_not_made(tmp_path: Path, name: str, size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    import trimesh

    monkeypatch.setattr(trimesh, "load_scene", None)
    fill(name, tmp_path, size)
    (path,) = tmp_path.glob("m.*")
    data = path.read_bytes()
    found = counts(data, path.suffix)
    assert found.corners > MOST_CORNERS + len(data) or found.parts > MOST_PARTS
    assert parse_mesh(path.read_bytes(), path.suffix, GREY) is None


@pytest.mark.parametrize(
    "name",
    ["dae instances", "dae nodes", "dae triangles", "glb instances", "obj objects", "stl triangles"],
)
def test_meshes_that_do_not_are_read_and_counted_right(tmp_path: Path, name: str) -> None:
    fill(name, tmp_path, 3_000)
    (path,) = tmp_path.glob("m.*")
    mesh = parse_mesh(path.read_bytes(), path.suffix, GREY)
    assert mesh is not None
    said = counts(path.read_bytes(), path.suffix)
    assert 3 * sum(len(part.faces) for part in mesh.parts) <= max(said.corners, len(path.read_bytes()))


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "cp037"])
def test_words_of_a_mesh_are_counted_in_every_encoding(encoding: str) -> None:
    head = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
    few = "".join(f"usemtl {k}\nf 1 2 3\n" for k in range(20))
    many = "".join(f"usemtl {k}\nf 1 2 3\n" for k in range(1001))
    assert parse_mesh((head + many).encode(encoding), ".obj", GREY) is None
    read = parse_mesh((head + few).encode(encoding), ".obj", GREY)
    assert (read is not None) == (encoding == "utf-16")


def test_a_mesh_with_a_word_in_latin_1_is_read() -> None:
    assert parse_mesh("# Gr\xf6\xdfe\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n".encode("latin-1"), ".obj", GREY) is not None


def test_pictures_in_a_mesh_are_not_looked_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They may unpack to gigabytes, and some materials make others of them."""
    import PIL.Image

    looked_at = []
    monkeypatch.setattr(PIL.Image, "open", looked_at.append)
    fill("glb pictures", tmp_path, 1_000)
    (path,) = tmp_path.glob("m.*")
    mesh = parse_mesh(path.read_bytes(), path.suffix, GREY)
    assert mesh is not None
    assert [len(part.faces) for part in mesh.parts] == [1]
    assert not looked_at


@pytest.mark.parametrize("word", [b"solid\ta", b"SOLID a", b"solid"])
def test_solids_of_an_stl_are_counted_as_they_are_read(word: bytes) -> None:
    assert counts(b"%s\nendloop\n" % word * (MOST_PARTS + 1), ".stl").parts > MOST_PARTS


def test_polygons_of_a_mesh_are_as_large_as_they_say(tmp_path: Path) -> None:
    """In a file of 900 bytes, polygons of 1000 million corners took all memory."""
    fill("dae triangles", tmp_path, 3_000)
    said = (tmp_path / "m.dae").read_bytes().replace(b"<p>", b"<vcount>1000000000</vcount><p>")
    said = said.replace(b"<triangles", b"<polylist").replace(b"</triangles", b"</polylist")
    assert counts(said, ".dae").corners >= 3_000_000_000
    assert parse_mesh(said, ".dae", GREY) is None
    assert parse_mesh(said.replace(b"1000000000", b"2000 -1997"), ".dae", GREY) is None


def test_nodes_that_have_each_other_in_a_circle(tmp_path: Path) -> None:
    fill("dae doubling", tmp_path, 400)
    path = tmp_path / "m.dae"
    path.write_bytes(path.read_bytes().replace(b'<node id="n0">', b'<node id="n0"><instance_node url="#n1"/>'))
    assert parse_mesh(path.read_bytes(), path.suffix, GREY) is None


def test_a_mesh_that_comes_often_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fill("one mesh often", tmp_path, 5_000)
    read: list[Path] = []

    def counted(path: Path, rgb: meshes.Rgb, most: int, spare: int) -> ThinMesh | None:
        read.append(path)
        return thin_mesh(path, rgb, most, spare)

    monkeypatch.setattr(scene, "thin_mesh", counted)
    shapes = visuals(read_urdf(tmp_path / "arm_cmm.urdf"), GREY)
    drawn = scene._drawn(shapes, (tmp_path,))
    assert read == [tmp_path / "m.stl"]
    assert sum(parts is not None for parts in drawn["base_link"]) >= 100


def test_simplifying_begins_where_it_can_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of random triangles, which no edge can be taken from, the first forty grids would change nothing."""
    chance = np.random.default_rng(0)
    soup = meshes.Triangles(chance.uniform(-1, 1, (30_000, 3)), np.arange(30_000).reshape(-1, 3), GREY)
    grids: list[float] = []
    real = meshes._clustered
    monkeypatch.setattr(meshes, "_clustered", lambda part, cell: (grids.append(cell), real(part, cell))[1])
    (found,) = simplified([soup], 1000)
    assert len(found.faces) <= 1000
    assert len(grids) < 12


@pytest.mark.parametrize("name", [name for name in HOSTILE if hostile_files._RESULTS not in HOSTILE[name].run])
def test_every_generator_writes_a_file_of_its_size(tmp_path: Path, name: str) -> None:
    sizes = []
    for size in (20_000, 60_000):
        fill(name, tmp_path / str(size), size)
        sizes.append(sum(path.stat().st_size for path in (tmp_path / str(size)).iterdir()))
    assert sizes[0] <= sizes[1] < 400_000


def one_by_one(count: int, of: str = "l{n}", more: str = "") -> bytes:
    """Return a URDF of ``count`` joints in a row, each on the link ``of`` the one before."""
    joints = "".join(
        f'<link name="l{n + 1}"/><joint name="j{n}" type="revolute"><parent link="{of.format(n=n)}"/>'
        f'<child link="l{n + 1}"/><axis xyz="0 {n % 2} {1 - n % 2}"/><origin xyz="0.1 0 0.2"/>'
        f'<limit lower="-1" upper="1"/>{more.format(n=max(n - 1, 0)) if n else ""}</joint>'
        for n in range(count)
    )
    return f'<robot name="row"><link name="l0"/>{joints}</robot>'.encode()


def test_arms_of_a_row_of_joints_end() -> None:
    """Each of its links is the tip of an arm, the first ones of arms that can be loaded."""
    document = parse_urdf(one_by_one(MOST_JOINTS + 50), "row.urdf")
    assert [len(arm.joints) for arm in chains(document)] == list(range(MOST_JOINTS, 0, -1))
    assert [arm.tip for arm in whole_chains(document)] == [f"l{MOST_JOINTS}"]
    with pytest.raises(RobotError, match=rf"^row.urdf: more than the {MOST_JOINTS} joints .* lead to 'l240'\.$"):
        chains(document, "l240")


def test_joints_that_follow_each_other_are_followed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half a minute went into looking for each joint among all, for each that follows it."""
    document = parse_urdf(one_by_one(150, "l0", '<mimic joint="j{n}"/>'), "mimics.urdf")
    monkeypatch.setattr(Urdf, "joint", None)
    (arm,) = chains(document)
    assert arm.joints == ("j0",)
    assert len(arm.others) == 149


def test_a_link_or_joint_is_found_by_its_name_alone() -> None:
    """A joint was compared with all others, for each of those that it follows."""
    document = parse_urdf(one_by_one(300), "row.urdf")
    compared = list[str]()

    class Counted(str):
        __slots__ = ()
        __hash__ = str.__hash__

        def __eq__(self, other: object) -> bool:
            compared.append(str(other))
            return str.__eq__(self, other)

    assert document.joint(Counted("j299")).child == "l300"
    parent = document.parent_joint(Counted("l300"))
    assert parent is not None
    assert parent.name == "j299"
    assert len(compared) < 10


@pytest.mark.parametrize("kind", ["fixed", "continuous"])
def test_masses_beside_the_arm_are_placed_once(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A minute and more went into finding each of a row of masses from the arm again, and whom each of them follows."""
    n = 200
    mass = '<inertial><origin xyz="0 0 0.5"/><mass value="1"/></inertial>'
    row = "".join(
        f'<link name="m{k}">{mass}</link><joint name="k{k}" type="{kind}"><parent link="{f"m{k - 1}" if k else "l2"}"/>'
        f'<child link="m{k}"/><origin xyz="0.1 0 0"/>{f"""<mimic joint="k{k - 1}"/>""" if k else ""}</joint>'
        for k in range(n)
    )
    robot = load_robot(parse_urdf(one_by_one(3).replace(b"</robot>", row.encode() + b"</robot>"), "row.urdf"), "l3")
    asked, real = list[str](), Urdf.parent_joint
    monkeypatch.setattr(Urdf, "parent_joint", lambda urdf, link: (asked.append(link), real(urdf, link))[1])
    bodies = joint_terms._bodies(robot)
    assert [(body.joint, body.mass) for body in bodies] == [(1, 1.0)] * n
    np.testing.assert_allclose([body.centre for body in bodies], [[0.1 * (k + 1), 0.0, 0.5] for k in range(n)])
    assert len(joint_terms.weighed_at_zero(robot)) == (0 if kind == "fixed" else n)
    assert len(asked) <= 2 * n


def test_names_of_columns_are_taken_apart_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A row of joints of which few have columns: every end of every arm was looked for in every column."""
    urdf, table = tmp_path / "row.urdf", tmp_path / "table.csv"
    urdf.write_bytes(one_by_one(120))
    rows = "".join(f"{0.01 * n},{0.9 - 0.02 * n},{n * n % 7 / 7},{n},{n % 5},200\n" for n in range(8))
    table.write_text("j0 [rad],j1 [rad],j2 [rad],x [mm],y [mm],z [mm]\n" + rows)
    taken, tokens = list[str](), roles.tokens

    def counted(name: str) -> tuple[str, ...]:
        taken.append(name)
        return tokens(name)

    monkeypatch.setattr(roles, "tokens", counted)
    propose(urdf, [table])
    assert len(taken) < 10 * (120 + 6)


def test_arms_that_nothing_names_are_compared_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of hundreds of arms that share most of their joints, each was compared with all others, name by name."""
    fork = one_by_one(20).replace(
        b"</robot>",
        b"".join(
            b'<link name="b%d"/><joint name="finger%d" type="revolute"><parent link="l20"/><child link="b%d"/></joint>'
            % (n, n, n)
            for n in range(30)
        )
        + b"</robot>",
    )
    document = parse_urdf(fork, "fork.urdf")
    looked, is_finger = list[str](), picks._is_finger

    def counted(seen: Seen, name: str) -> bool:
        looked.append(name)
        return is_finger(seen, name)

    monkeypatch.setattr(picks, "_is_finger", counted)
    cut = picks._cut_short(cast("Seen", SimpleNamespace(arms=chains(document), document=document)))
    assert sorted(looked) == sorted({joint.name for joint in document.joints})
    assert {len(joints) for joints in cut} == set(range(1, 20))  # 20 joints are an arm with a hand
