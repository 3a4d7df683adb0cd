"""Examples are found by name, and nothing outside their folder is."""

import os
import time
from importlib import metadata
from pathlib import Path

import pytest

from calib.foundations.errors import RobotError
from calib.robot import sources

FOLDER = sources.examples_folder()


def test_a_plain_path_is_itself() -> None:
    assert sources.resolve("no/such/file.urdf") == Path("no/such/file.urdf")
    assert sources.resolve(Path("arm.urdf")) == Path("arm.urdf")
    assert sources.resolve("./example:arm.urdf") == Path("./example:arm.urdf")


@pytest.mark.parametrize("kind", [str, Path])
def test_an_example_is_a_file_of_the_package(kind: type) -> None:
    found = sources.resolve(kind("example:panda_description/urdf/panda.urdf"))
    assert found == FOLDER / "panda_description/urdf/panda.urdf"
    assert found.is_file()


def test_examples_lists_urdfs_that_resolve() -> None:
    listed = sources.examples()
    assert len(listed) >= 50
    assert list(listed) == sorted(listed)
    assert "example:ur_description/urdf/ur5_robot.urdf" in listed
    assert all(sources.resolve(name).suffix == ".urdf" for name in listed)


@pytest.mark.parametrize(
    ("path", "sentence"),
    [
        ("example:..", "example:..: an example is a path inside the folder of the examples, without '..'."),
        (
            "example:panda_description/../../../secret",
            "example:panda_description/../../../secret: "
            "an example is a path inside the folder of the examples, without '..'.",
        ),
        (
            "example:/etc/passwd",
            "example:/etc/passwd: an example is a path inside the folder of the examples, without '..'.",
        ),
        (
            "example:xarm7.urdf",
            "example:xarm7.urdf: there is no such example; did you mean example:xarm_description/urdf/xarm7.urdf?",
        ),
        (
            "example:z1_description/urdf/z2.urdf",
            "example:z1_description/urdf/z2.urdf: there is no such example; "
            "did you mean example:z1_description/urdf/z1.urdf or ",
        ),
        ("example:", f"example:: there is no such example; they are the files in {FOLDER}."),
        ("example:qqqq", f"example:qqqq: there is no such example; they are the files in {FOLDER}."),
        ("example:a\0b", f"example:a\0b: there is no such example; they are the files in {FOLDER}."),
        (
            "example:" + "q" * 5000,
            f"example:{'q' * 192}: there is no such example; they are the files in {FOLDER}.",
        ),
    ],
)
def test_what_is_no_example(path: str, sentence: str) -> None:
    with pytest.raises(RobotError) as caught:
        sources.resolve(path)
    assert str(caught.value).startswith(sentence)


def test_a_folder_is_no_example() -> None:
    with pytest.raises(RobotError, match="there is no such example; did you mean example:panda_description/urdf/panda"):
        sources.resolve("example:panda_description")


def test_examples_of_another_package_manager_lie_under_the_prefix(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def missing(name: str) -> metadata.Distribution:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "distribution", missing)
    monkeypatch.setattr("sys.prefix", str(tmp_path))
    with pytest.raises(RobotError) as caught:
        sources.examples()
    assert str(caught.value) == "The example robots are not installed; install the package example-robot-data."
    robot = tmp_path / "share/example-robot-data/robots/arm/arm.urdf"
    robot.parent.mkdir(parents=True)
    robot.touch()
    assert sources.examples() == ("example:arm/arm.urdf",)
    assert sources.resolve("example:arm/arm.urdf") == robot


def looking_like(*uris: str) -> bytes:
    visuals = "".join(f'<visual><geometry><mesh filename="{uri}"/></geometry></visual>' for uri in uris)
    return f'<robot name="r"><link name="a">{visuals}</link></robot>'.encode()


def package(folder: Path, name: str) -> Path:
    folder.mkdir(parents=True)
    (folder / "package.xml").write_text(f"<package><name>{name}</name></package>")
    (folder / "meshes").mkdir()
    (folder / "meshes" / "a.stl").write_text("solid a\nendsolid a\n")
    return folder


def test_packages_are_found_above_the_urdf_beside_it_and_in_sourced_workspaces(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = package(tmp_path / "src" / "arm_description", "arm_description")
    package(tmp_path / "src" / "tools", "tools")
    package(tmp_path / "install" / "share" / "gripper", "gripper")
    package(tmp_path / "src" / "liar", "somebody_else")
    (own / "urdf").mkdir()
    names = ("arm_description", "tools", "gripper", "liar", "nowhere")
    source = looking_like(*(f"package://{name}/meshes/a.stl" for name in names))
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / 'install'}:/nowhere")
    roots = sources.package_folders(source, own / "urdf" / "arm.urdf")
    found = {uri: sources.find_mesh(uri, roots) for uri in sources.mesh_uris(source)}
    where = {uri.split("/")[2]: path and path.parents[1].name for uri, path in found.items()}
    assert where == dict.fromkeys(names) | {name: name for name in names[:3]}


def test_a_pipe_in_the_place_of_a_manifest_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "package.xml")
    source = looking_like("package://arm/a.stl")
    assert sources.package_folders(source, tmp_path / "urdf" / "arm.urdf") == ()


def test_meshes_are_those_of_visuals_and_collisions_as_xml_has_them() -> None:
    source = looking_like("package://a/x&amp;y.stl", "a.stl", "a.stl")
    source = source.replace(b"</link>", b'<!-- <mesh filename="old.stl"/> --><mesh filename="no.stl"/></link>')
    collision = b'<collision><geometry><mesh filename="c.stl"/></geometry></collision></link>'
    source = source.replace(b"</link>", collision)
    assert sources.mesh_uris(source) == ("package://a/x&y.stl", "a.stl", "c.stl")
    assert sources.mesh_uris(source.decode().encode("utf-16")) == ("package://a/x&y.stl", "a.stl", "c.stl")
    assert sources.mesh_uris(source, ("visual",)) == ("package://a/x&y.stl", "a.stl")
    assert sources.mesh_uris(b"<robot") == ()


def test_long_paths_below_many_roots_are_looked_for_quickly(tmp_path: Path) -> None:
    begun = time.process_time()
    assert all(sources.find_mesh(f"{k}{'/a' * 450}", (tmp_path,) * 100) is None for k in range(100))
    assert time.process_time() - begun < 5.0
