"""URDF and SDF, judged by yourdfpy and by hand."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from sonar_sim.errors import SceneError
from sonar_sim.scene_file.mesh_files import NamedMesh, read_parts

ROBOT = """<?xml version="1.0"?>
<robot name="arm">
  <material name="wood"/>
  <link name="base">
    <visual name="plate"><origin xyz="0.1 0 0" rpy="0 0 0.3"/>
      <geometry><box size="1 2 0.5"/></geometry><material name="wood"/></visual>
    <visual name="pin"><origin xyz="0 0 1" rpy="0.2 0.1 0"/>
      <geometry><cylinder radius="0.1" length="2"/></geometry></visual>
    <collision><geometry><box size="9 9 9"/></geometry></collision>
  </link>
  <link name="upper"><visual><origin xyz="0 0 0.4" rpy="0 -0.5 0"/>
    <geometry><mesh filename="package://arm_description/meshes/part.stl" scale="0.1 0.2 0.3"/>
    </geometry></visual></link>
  <link name="tip"><visual><geometry><box size="0.2 0.3 0.9"/></geometry></visual></link>
  <link name="foot"><collision><geometry><sphere radius="0.3"/></geometry></collision></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <origin xyz="1 2 3" rpy="0.4 0.5 0.6"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="wrist" type="fixed"><parent link="upper"/><child link="tip"/>
    <origin xyz="0 5.5 0" rpy="1 0 0"/></joint>
  <joint name="ankle" type="fixed"><parent link="base"/><child link="foot"/></joint>
</robot>
"""


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    """A robot in its package."""
    package = tmp_path / "arm_description"
    (package / "meshes").mkdir(parents=True)
    (package / "urdf").mkdir()
    trimesh.creation.icosphere(subdivisions=1).export(package / "meshes" / "part.stl")
    path = package / "urdf" / "arm.urdf"
    path.write_text(ROBOT)
    return path


def bounds(parts: list[NamedMesh]) -> np.ndarray:
    points = np.concatenate([part.mesh.vertices for part in parts])
    return np.array([points.min(axis=0), points.max(axis=0)])


def test_a_robot_stands_as_another_reader_has_it(robot: Path) -> None:
    yourdfpy = pytest.importorskip("yourdfpy")
    parts = [part for part in read_parts(robot) if part.name != "foot"]

    def located(fname: str, dir: str = "") -> str:  # noqa: A002, ARG001 names of the library
        return str(robot.parents[1] / fname.removeprefix("package://arm_description/"))

    theirs: Any = yourdfpy.URDF.load(str(robot), filename_handler=located)
    assert bounds(parts) == pytest.approx(np.asarray(theirs.scene.bounds), abs=0.01)
    assert [(part.name, part.material) for part in parts] == [
        ("base/pin", ""),
        ("tip", ""),
        ("upper", ""),
        ("base/plate", "wood"),
    ]


def test_a_link_without_visuals_has_its_collisions(robot: Path) -> None:
    (foot,) = [part for part in read_parts(robot) if part.name == "foot"]
    assert np.ptp(bounds([foot]), axis=0) == pytest.approx([0.6, 0.6, 0.6], abs=0.01)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ('<sphere radius="0.3"/>', "<torus/>", "link 'foot': no geometry 'torus'"),
        ('radius="0.3"', 'radius="big"', "link 'foot': sphere: 'big' is not 1 numbers"),
        (
            '<parent link="base"/><child link="upper"/>',
            '<parent link="tip"/><child link="upper"/>',
            "hangs on itself",
        ),
        ("part.stl", "none.stl", r"link .*: there is no '.*none\.stl'"),
        (
            'filename="package://arm_description/meshes/part.stl"',
            'filename="arm.urdf"',
            "cannot be",
        ),
        ('<child link="upper"/>', '<child link="lower"/>', "there are 0 links 'lower'"),
        ('<link name="upper">', '<link name="tip">', "there are 0 links 'upper'"),
        ('<link name="base">', '<link name="tip"/><link name="base">', "there are 2 links 'tip'"),
        (
            '<parent link="base"/><child link="foot"/>',
            '<parent link="base"/><child link="tip"/>',
            "two",
        ),
        ("</robot>", "", "not XML"),
    ],
)
def test_a_broken_robot_is_refused_by_name(robot: Path, old: str, new: str, reason: str) -> None:
    robot.write_text(ROBOT.replace(old, new))
    with pytest.raises(SceneError, match=f"(arm.urdf|stl).*{reason}"):
        read_parts(robot)


@pytest.mark.parametrize(
    "shape",
    [
        '<box size="1 -2 1"/>',
        '<sphere radius="-1"/>',
        '<sphere radius="0"/>',
        '<cylinder radius="-1" length="1"/>',
        '<cylinder radius="1" length="0"/>',
        '<capsule radius="1" length="-1"/>',
        "<box><size>1 0 1</size></box>",
        "<sphere><radius>-1</radius></sphere>",
        "<ellipsoid><radii>1 2 -1</radii></ellipsoid>",
        "<cylinder><radius>-1</radius><length>1</length></cylinder>",
        "<capsule><radius>1</radius><length>0</length></capsule>",
        "<cone><radius>1</radius><length>-1</length></cone>",
        "<plane><size>-1 1</size></plane>",
    ],
)
def test_sizes_of_a_shape_are_more_than_0(tmp_path: Path, shape: str) -> None:
    visual = f'<link name="l"><visual name="v"><geometry>{shape}</geometry></visual></link>'
    sdf, kind = "</" in shape, re.findall("[a-z]+", shape)[0]
    path = tmp_path / ("m.sdf" if sdf else "m.urdf")
    robot, model = f'<robot name="m">{visual}</robot>', f'<model name="m">{visual}</model>'
    path.write_text(f"<sdf>{model}</sdf>" if sdf else robot)
    place = "m/l/v" if sdf else "link 'l'"
    with pytest.raises(SceneError, match=f"{path.name}: {place}: {kind}: .* is not more than 0"):
        read_parts(path)


WORLD = """<?xml version="1.0"?>
<sdf version="1.9"><world name="bay">
  <light name="sun" type="directional"/>
  <model name="ground"><static>true</static><pose>0 0 -10 0 0 0</pose><link name="link">
    <visual name="visual"><geometry><plane><normal>0 0 1</normal><size>40 20</size></plane>
      </geometry><material><script><name>mud</name></script></material></visual></link></model>
  <model name="rig"><pose degrees="true">5 0 -4 0 0 90</pose>
    <frame name="deck" attached_to="leg"><pose>0 0 2 0 0 0</pose></frame>
    <link name="leg"><pose>1 0 0 0 0 0</pose>
      <visual name="pile"><geometry><cylinder><radius>0.5</radius><length>4</length></cylinder>
        </geometry></visual></link>
    <link name="box"><pose relative_to="deck">0 3 0 0 0 0</pose>
      <visual name="v"><pose rotation_format="quat_xyzw">0 0 1 0 0 0.7071068 0.7071068</pose>
        <geometry><box><size>2 0.2 0.4</size></box></geometry></visual></link>
    <model name="lamp"><pose relative_to="box">0 0 5 0 0 0</pose><link name="l">
      <collision name="c"><geometry><capsule><radius>0.1</radius><length>1</length></capsule>
        </geometry></collision></link></model>
  </model>
  <include><uri>model://buoy</uri><name>north</name><pose>0 9 -1 0 0 0</pose></include>
</world></sdf>
"""
BUOY = """<sdf version="1.6"><model name="buoy"><pose>7 7 7 0 0 0</pose><link name="l">
  <visual name="hull"><geometry><mesh><uri>model://buoy/meshes/hull.stl</uri>
    <scale>2 2 2</scale></mesh></geometry></visual></link></model></sdf>
"""


@pytest.fixture
def world(tmp_path: Path) -> Path:
    """A world with a model in the folder beside it."""
    buoy = tmp_path / "models" / "buoy"
    (buoy / "meshes").mkdir(parents=True)
    (buoy / "model.config").write_text("<model><sdf version='1.6'>hull.sdf</sdf></model>")
    (buoy / "hull.sdf").write_text(BUOY)
    trimesh.creation.box(extents=(1, 1, 1)).export(buoy / "meshes" / "hull.stl")
    path = tmp_path / "bay.world"
    path.write_text(WORLD)
    return path


@pytest.mark.parametrize("folder", ["models", "elsewhere"])
def test_a_world_is_laid_out_by_its_frames(
    world: Path, monkeypatch: pytest.MonkeyPatch, folder: str
) -> None:
    if folder != "models":
        (world.parent / "models").rename(world.parent / folder)
        monkeypatch.setenv("GZ_SIM_RESOURCE_PATH", str(world.parent / folder))
    parts = {part.name: part for part in read_parts(world)}
    assert parts["ground/link/visual"].material == "mud"
    expected = {
        # The rig's x points north; its deck is above the leg, 1 m ahead of its middle.
        "ground/link/visual": ([-20, -10, -10], [20, 10, -10]),
        "rig/leg/pile": ([4.5, 0.5, -6], [5.5, 1.5, -2]),
        "rig/box/v": ([1, 0.9, -1.2], [3, 1.1, -0.8]),
        "rig/lamp/l/c": ([1.9, 0.9, 2.4], [2.1, 1.1, 3.6]),
        "north/l/hull": ([-1, 8, -2], [1, 10, 0]),
    }
    assert set(parts) == set(expected)
    for name, (low, high) in expected.items():
        assert parts[name].mesh.bounds[0] == pytest.approx(low, abs=1e-3), name
        assert parts[name].mesh.bounds[1] == pytest.approx(high, abs=1e-3), name


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("<uri>model://buoy</uri>", "<uri>model://boat</uri>", "there is no 'model://boat'"),
        ('relative_to="deck"', 'relative_to="dock"', "no frame 'dock'"),
        ('relative_to="deck"', 'relative_to="world"', "model 'rig': no frame 'world'"),
        ('relative_to="deck"', 'relative_to="lamp::l"', "no frame 'lamp::l'"),
        (
            'name="rig"',
            'name="rig" placement_frame="dock"',
            "placement_frame of model 'rig': no frame 'dock'",
        ),
        (
            "<pose>0 9 -1 0 0 0</pose>",
            "<placement_frame>l</placement_frame>",
            "placement_frame, but no pose",
        ),
        ('attached_to="leg"', 'attached_to="deck"', "refers to itself"),
        ("<pose>1 0 0 0 0 0</pose>", "<pose>1 0 0</pose>", "is not 6 numbers"),
        ("<size>2 0.2 0.4</size>", "", "is not 3 numbers"),
        ("<plane>", "<heightmap/><plane>", "terrain"),
        ('name="rig"', 'name="ground"', "two elements <model> are called 'ground'"),
        ('link name="box"', 'link name="leg"', "two elements <link> are called 'leg'"),
        ("sdf", "gazebo", "its root is <gazebo>"),
    ],
)
def test_a_broken_world_is_refused_by_name(
    world: Path, monkeypatch: pytest.MonkeyPatch, old: str, new: str, reason: str
) -> None:
    monkeypatch.setenv("GZ_SIM_RESOURCE_PATH", str(world.parent / "models"))
    world.write_text(WORLD.replace(old, new))
    with pytest.raises(SceneError, match=f"bay.world.*{reason}"):
        read_parts(world)


def test_a_world_that_includes_itself_ends(tmp_path: Path) -> None:
    path = tmp_path / "loop.sdf"
    path.write_text('<sdf><model name="m"><include><uri>loop.sdf</uri></include></model></sdf>')
    with pytest.raises(SceneError, match="deep"):
        read_parts(path)


def test_a_visual_may_stand_relative_to_another_frame(tmp_path: Path) -> None:
    path = tmp_path / "one.sdf"
    path.write_text(
        """<sdf version="1.9"><model name="m">
  <frame name="mast"><pose>5 0 0 0 0 0</pose></frame>
  <link name="base"><pose>0 3 0 0 0 0</pose>
    <visual name="lamp"><pose relative_to="mast">0 0 2 0 0 0</pose>
      <geometry><box><size>1 1 1</size></box></geometry></visual></link>
</model></sdf>"""
    )
    assert bounds(list(read_parts(path))).mean(axis=0) == pytest.approx([5.0, 0.0, 2.0])


CRANE = """<sdf version="1.9"><model name="crane" placement_frame="foot"><pose>50 0 0 0 0 0</pose>
  <frame name="hook"><pose>0 2 6 0 0 0</pose></frame>
  <link name="foot"><pose>0 0 -3 0 0 0.5</pose></link>
  <link name="cab"><pose>1 0 0 0 0 0</pose>
    <visual name="v"><geometry><box><size>1 1 1</size></box></geometry></visual></link>
</model></sdf>
"""


def test_models_may_be_included_without_a_name(tmp_path: Path) -> None:
    (tmp_path / "crane.sdf").write_text(CRANE.replace('name="crane" ', ""))
    include = "<include><uri>crane.sdf</uri><pose>{} 0 0 0 0 0</pose></include>"
    path = tmp_path / "port.world"
    world = include.format(10) + include.format(20)
    path.write_text(f'<sdf version="1.9"><world name="w">{world}</world></sdf>')
    assert len(read_parts(path)) == 2


def test_frames_may_refer_to_an_included_model(tmp_path: Path) -> None:
    (tmp_path / "crane.sdf").write_text(CRANE)
    lamp = (
        '<model name="lamp"><pose relative_to="{}">0 0 1 0 0 0</pose><link name="l"><visual '
        'name="v"><geometry><box><size>1 1 1</size></box></geometry></visual></link></model>'
    )
    path = tmp_path / "port.world"
    for name, pose, expected in (
        ("<name>c1</name>", "<pose>10 20 0 0 0 0</pose>", [10.0, 20.0]),
        ("", "", [50.0, 0.0]),
    ):
        include = f"<include><uri>crane.sdf</uri>{name}{pose}</include>"
        world = include + lamp.format("c1" if name else "crane")
        path.write_text(f'<sdf version="1.9"><world name="w">{world}</world></sdf>')
        (found,) = (part for part in read_parts(path) if part.name == "lamp/l/v")
        # The crane's foot is at its pose, turned and 3 m below its own origin.
        assert bounds([found]).mean(axis=0) == pytest.approx([*expected, 4.0])


def middle_of_cab(path: Path) -> np.ndarray:
    (cab,) = (part for part in read_parts(path) if part.name.endswith("cab/v"))
    return np.asarray(bounds([cab]).mean(axis=0))


def test_a_models_pose_is_that_of_its_placement_frame(tmp_path: Path) -> None:
    crane = tmp_path / "crane.sdf"
    crane.write_text(CRANE)
    # Seen from the foot, which is turned to port, the cab is 1 m ahead, turned back, and 3 m up.
    ahead, port = np.cos(0.5), -np.sin(0.5)
    assert middle_of_cab(crane) == pytest.approx([50 + ahead, port, 3.0])
    world = tmp_path / "port.world"
    include = "<include><uri>crane.sdf</uri>{}<pose>10 20 0 0 0 {}</pose></include>"
    quarter = np.pi / 2
    for frame, yaw_rad, expected in (
        ("", 0.0, [10 + ahead, 20 + port, 3.0]),
        ("<placement_frame>hook</placement_frame>", 0.0, [11.0, 18.0, -6.0]),
        ("<placement_frame>hook</placement_frame>", quarter, [12.0, 21.0, -6.0]),
        ("<placement_frame>__model__</placement_frame>", 0.0, [11.0, 20.0, 0.0]),
    ):
        text = include.format(frame, yaw_rad)
        world.write_text(f'<sdf version="1.9"><world name="w">{text}</world></sdf>')
        assert middle_of_cab(world) == pytest.approx(expected)


def test_frames_may_refer_to_a_nested_model_that_is_placed_by_a_frame(tmp_path: Path) -> None:
    path = tmp_path / "quay.sdf"
    nested = CRANE.partition(">")[2].replace("</sdf>", "").replace('"foot"', '"hook"', 1)
    path.write_text(
        f"""<sdf version="1.9"><model name="quay">{nested}
  <link name="lamp"><pose relative_to="crane">0 0 1 0 0 0</pose>
    <visual name="v"><geometry><box><size>1 1 1</size></box></geometry></visual></link>
</model></sdf>"""
    )
    assert middle_of_cab(path) == pytest.approx([51.0, -2.0, -6.0])
    (lamp,) = (part for part in read_parts(path) if part.name == "quay/lamp/v")
    assert bounds([lamp]).mean(axis=0) == pytest.approx([50.0, -2.0, -5.0])
