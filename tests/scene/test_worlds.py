"""SDF worlds: poses and frames in closed form, what is missing, and worlds others made."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from insonify.errors import WorldError
from insonify.scene.worlds import WorldWarning, load_scene

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"


def _world(folder: Path, inside: str, version: str = "1.9") -> Path:
    path = folder / "w.world"
    path.write_text(f'<sdf version="{version}"><world name="w">{inside}</world></sdf>')
    return path


def _visual(geometry: str, more: str = "", pose: str = "0 0 0 0 0 0") -> str:
    return (
        f'<link name="l"><visual name="v"><pose>{pose}</pose><geometry>{geometry}</geometry>'
        f"{more}</visual></link>"
    )


BOX = "<box><size>2 4 6</size></box>"


def test_poses_of_model_link_and_visual_nest(tmp_path: Path) -> None:
    quarter = math.pi / 2
    inside = (
        f'<model name="m"><pose>10 0 0 0 0 {quarter}</pose><link name="l"><pose>1 0 0 0 0 0</pose>'
        f'<visual name="v"><pose>0 2 0 {quarter} 0 0</pose><geometry>{BOX}</geometry></visual>'
        "</link></model>"
    )
    (body,) = load_scene(_world(tmp_path, inside)).bodies
    np.testing.assert_allclose(body.mesh.bounds.mean(axis=0), [8.0, 1.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(body.mesh.extents, [6.0, 2.0, 4.0], atol=1e-9)
    assert body.name == "m"


def test_relative_to_follows_frames_models_and_links(tmp_path: Path) -> None:
    inside = (
        '<frame name="f"><pose relative_to="a">0 0 5 0 0 0</pose></frame>'
        f'<model name="a"><pose degrees="true">1 0 0 0 0 90</pose>{_visual(BOX)}</model>'
        f'<model name="b"><pose relative_to="f">3 0 0 0 0 0</pose>{_visual(BOX)}</model>'
    )
    _, b = load_scene(_world(tmp_path, inside)).bodies
    np.testing.assert_allclose(b.mesh.bounds.mean(axis=0), [1.0, 3.0, 5.0], atol=1e-9)
    circle = (
        '<frame name="f"><pose relative_to="g"/></frame><frame name="g"><pose relative_to="f"/>'
        f'</frame><model name="a"><pose relative_to="f"/>{_visual(BOX)}</model>'
    )
    with pytest.raises(WorldError, match="circle: f -> g -> f"):
        load_scene(_world(tmp_path, circle))
    nowhere = f'<model name="a"><pose relative_to="x"/>{_visual(BOX)}</model>'
    with pytest.raises(WorldError, match="no frame: 'x'"):
        load_scene(_world(tmp_path, nowhere))


@pytest.mark.parametrize(
    ("geometry", "extents"),
    [
        (BOX, (2, 4, 6)),
        ("<sphere><radius>1.5</radius></sphere>", (3, 3, 3)),
        ("<cylinder><radius>1</radius><length>5</length></cylinder>", (2, 2, 5)),
        ("<capsule><radius>1</radius><length>5</length></capsule>", (2, 2, 7)),
        ("<ellipsoid><radii>1 2 3</radii></ellipsoid>", (2, 4, 6)),
        ("<plane><normal>1 0 0</normal><size>3 3</size></plane>", (0, 3, 3)),
    ],
)
def test_shapes_have_their_size(
    tmp_path: Path, geometry: str, extents: tuple[float, float, float]
) -> None:
    (body,) = load_scene(_world(tmp_path, f'<model name="m">{_visual(geometry)}</model>')).bodies
    np.testing.assert_allclose(body.mesh.extents, extents, rtol=0.01, atol=1e-9)


def test_materials_come_by_element_by_script_and_by_name(tmp_path: Path) -> None:
    own = "<material><insonify:reflectance>2.12</insonify:reflectance></material>"
    script = "<material><script><name>Gazebo/WoodPallet</name></script></material>"
    inside = (
        f'<model name="a">{_visual(BOX, own)}</model><model name="b">{_visual(BOX, script)}</model>'
        f'<model name="concrete_block">{_visual(BOX)}</model><model name="d">{_visual(BOX)}</model>'
    )
    scene = load_scene(_world(tmp_path, inside))
    assert [m.name for m in scene.materials] == ["v", "wood", "concrete", "default"]
    assert scene.materials[0].reflectance == 2.12


def test_meshes_scale_and_heightmaps_need_a_size(tmp_path: Path) -> None:
    model = tmp_path / "models" / "rock"
    model.mkdir(parents=True)
    trimesh.creation.box((1, 1, 1)).export(model / "rock.stl")
    mesh = "<mesh><uri>model://rock/rock.stl</uri><scale>1 2 -3</scale></mesh>"
    (body,) = load_scene(_world(tmp_path, f'<model name="m">{_visual(mesh)}</model>')).bodies
    np.testing.assert_allclose(body.mesh.extents, [1, 2, 3])
    Image.fromarray(np.array([[0, 255], [0, 255]], np.uint8)).save(tmp_path / "h.png")
    hill = "<heightmap><uri>file://h.png</uri><size>10 20 4</size><pos>0 0 -7</pos></heightmap>"
    (body,) = load_scene(_world(tmp_path, f'<model name="m">{_visual(hill)}</model>')).bodies
    np.testing.assert_allclose(body.mesh.bounds, [[-5, -10, -7], [5, 10, -3]])
    sizeless = "<heightmap><uri>file://h.png</uri></heightmap>"
    with pytest.raises(WorldError, match="no <size>"):
        load_scene(_world(tmp_path, f'<model name="m">{_visual(sizeless)}</model>'))


def test_includes_take_the_newest_sdf_and_never_run_in_circles(tmp_path: Path) -> None:
    model = tmp_path / "models" / "m"
    model.mkdir(parents=True)
    (model / "model.config").write_text(
        '<model><sdf version="1.4">old.sdf</sdf><sdf version="1.10">new.sdf</sdf></model>'
    )
    (model / "old.sdf").write_text("rubbish")
    text = f'<sdf version="1.10"><model name="x"><pose>0 0 9 0 0 0</pose>{_visual(BOX)}'
    (model / "new.sdf").write_text(text + "</model></sdf>")
    include = "<include><uri>model://m</uri><name>mine</name><pose>0 5 0 0 0 0</pose></include>"
    (body,) = load_scene(_world(tmp_path, include)).bodies
    assert body.name == "mine"
    np.testing.assert_allclose(body.mesh.bounds.mean(axis=0), [0, 5, 0], atol=1e-9)
    loop = '<sdf version="1.10"><model name="x"><include><uri>model://m</uri></include></model>'
    (model / "new.sdf").write_text(loop + "</sdf>")
    with pytest.raises(WorldError, match="include each other in a circle"):
        load_scene(_world(tmp_path, include))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<sdf version='1.9'><world>", "XML"),
        ("", "XML"),
        ("<html/>", "root is <html>"),
        ("<sdf version='7'><world name='w'/></sdf>", "version '7'"),
        ("<sdf version='1.9'><world name='w'/></sdf>", "no visual geometry"),
        ("<sdf version='1.9'><model name='m'><pose>1 2</pose></model></sdf>", "6 finite numbers"),
        ("<sdf version='1.9'><model name='m'><pose>nan 0 0 0 0 0</pose></model></sdf>", "finite"),
        (
            "<sdf version='1.9'><world name='w'><include><uri>model://no</uri></include></world>"
            "</sdf>",
            "model://no",
        ),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "bad.world"
    path.write_text(text)
    with pytest.raises(WorldError) as caught:
        load_scene(path)
    assert words in str(caught.value) and str(path) in str(caught.value)


@pytest.mark.skipif(not DATA.is_dir(), reason="needs ../shared/data, which is not here")
def test_a_real_world_loads_without_its_water_and_its_textures_on_the_web() -> None:
    with pytest.warns(WorldWarning, match=r"SunkenShip_Normal\.png"):
        scene = load_scene(DATA / "worlds/sunken_ship_site.world")
    assert [(b.name, b.material.name) for b in scene.bodies] == [
        ("herkules_seabed", "sand"),
        ("wreck", "default"),
    ]
    np.testing.assert_allclose(scene.bodies[0].mesh.extents[:2], [400, 400], rtol=0.001)
    ship = scene.bodies[1]
    np.testing.assert_allclose(ship.mesh.bounds[:, 2], [-60.4, -53.19], atol=0.01)
    assert load_scene(DATA / "models/sunken_ship_distorted", collisions=True).bodies


@pytest.mark.skipif(not DATA.is_dir(), reason="needs ../shared/data, which is not here")
def test_a_missing_mesh_names_the_file_and_the_model() -> None:
    with pytest.raises(WorldError, match=r"herkules_ship_wreck.*herkules\.dae"):
        load_scene(DATA / "worlds/herkules_ship_wreck.world")
    with pytest.raises(WorldError, match="munkholmen_seabed"):
        load_scene(DATA / "worlds/munkholmen.world")


@pytest.mark.parametrize(
    ("uri", "spared"),
    [("model://sun", True), ("https://fuel.gazebosim.org/1.0/x/models/Rock", True),
     ("model://rock", False), ("model://sunken_ship", False)],
)  # fmt: skip
def test_a_light_or_a_model_on_the_web_may_lack(tmp_path: Path, uri: str, spared: bool) -> None:
    (tmp_path / "w.sdf").write_text(
        f"<sdf version='1.9'><world name='w'><include><uri>{uri}</uri></include>"
        "<model name='b'><link name='l'><visual name='v'><geometry><box><size>1 1 1</size></box>"
        "</geometry></visual></link></model></world></sdf>"
    )
    if spared:
        with pytest.warns(WorldWarning, match="is left out"):
            assert len(load_scene(tmp_path / "w.sdf").bodies) == 1
    else:
        with pytest.raises(WorldError, match="is not there; looked in"):
            load_scene(tmp_path / "w.sdf")
