"""Materials, judged by the compiled model and its pixels."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from helpers import seeds
from mujoco import mjx
from PIL import Image

from maax_mjx.worldgen import Floor, Geom, Material, ObjFromXML, Wedge, WorldBuilder

close = np.testing.assert_allclose
RED, BLUE = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


def world(*objects, seed=0):
    builder = WorldBuilder(seed=seeds.seed(seed))
    floor = builder.append(Floor())
    for obj in objects:
        floor.append(obj)
    return builder


def box(material, name=None):
    return Geom("box", (0.3, 0.3, 0.3), name=name).set_material(material)


def pixels(model, name):
    """The pixels of a texture, (height, width, 3), in [0, 1]."""
    texture = model.texture(name)
    start, height, width = (int(getattr(texture, field)[0]) for field in ("adr", "height", "width"))
    return model.tex_data[start : start + height * width * 3].reshape(height, width, 3) / 255


def test_a_plain_colour():
    obj = Geom("box", (0.3, 0.3, 0.3), rgba=(0, 1, 0, 1))
    assert obj.set_material(Material("skin", rgba=(*RED, 0.5))) is obj
    model = world(obj, Geom("box", (0.3, 0.3, 0.3))).to_spec().compile()
    assert (model.nmat, model.ntex) == (1, 0)
    assert model.geom_matid.tolist() == [-1, 0, -1]
    close(model.material("skin").rgba, (*RED, 0.5))
    close(model.geom("box0").rgba, (*RED, 0.5))


@pytest.mark.parametrize("texture", ["checker", "gradient", "flat"])
@pytest.mark.parametrize("texture_type", ["cube", "2d"])
def test_textures_are_made_of_their_two_colours(texture, texture_type):
    material = Material("m", texture=texture, rgb1=RED, rgb2=BLUE, texture_type=texture_type)
    model = world(box(material)).to_spec().compile()
    picture = pixels(model, "m")
    if texture_type == "cube":
        faces = picture.reshape(6, -1, 3)  # right, left, up, down, front, back
        assert picture.shape == (6 * 64, 64, 3)
    else:
        faces = picture.reshape(1, -1, 3)
        assert picture.shape == (64, 64, 3)
    close(model.geom("box0").rgba, 1)
    assert model.mat_texid[0, mujoco.mjtTextureRole.mjTEXROLE_RGB] == 0
    assert (picture[..., 1] == 0).all()
    if texture == "checker":
        red = (faces == RED).all(axis=-1)
        assert (red | (faces == BLUE).all(axis=-1)).all()
        close(red.mean(axis=1), 0.5)
    elif texture == "gradient":
        assert len(np.unique(faces.reshape(-1, 3), axis=0)) > 20
    else:
        assert [tuple(face[0]) for face in faces] == ([RED] * 3 + [BLUE] + [RED] * 2)[: len(faces)]


def test_one_material_on_several_objects_and_a_name_for_each():
    shared, nameless = Material("shared", texture="flat"), Material(texture="checker")
    objects = [box(shared, "a"), box(shared, "b"), box(Material("shared", texture="flat"), "c")]
    more = [box(nameless, "d"), ObjFromXML("agent", "e").set_material(nameless), Wedge(name="f")]
    model = world(*objects, *more).to_spec().compile()
    assert [model.material(i).name for i in range(model.nmat)] == ["shared", "d", "e"]
    named = [model.material(i).name if i >= 0 else None for i in model.geom_matid]
    assert named == [None, *["shared"] * 3, "d", "e", "e", "e", None]


def look(name, seed=None, **options):
    model = world(box(Material(name, random=True, seed=seed, **options))).to_spec().compile()
    picture = pixels(model, 0).tobytes() if model.ntex else b""
    return model.mat_rgba[0].tobytes() + picture


def test_a_random_look_belongs_to_its_name():
    names = [f"m{i}" for i in range(30)]
    looks = [look(name) for name in names]
    assert looks == [look(name) for name in names]
    assert len(set(looks)) == 30
    assert 5 <= sum(len(x) == 16 for x in looks) <= 25  # plain ones and textures
    assert look("m0", seed=1) != look("m0") == look("m0", seed=0)


def test_a_random_look_is_the_same_on_every_machine():
    """Written down from another process: a hash that is salted, or another draw, would differ."""
    oak = Material("oak", texture="checker", rgb1=(0.702, 0.406, 0.511), rgb2=(0.638, 0.356, 0.681))
    assert Material("oak", random=True).resolve("box0") == oak
    assert Material("clay", random=True).resolve("box0") == Material("clay", rgba=(0.008, 0.638, 0.908, 1.0))
    assert Material(random=True).resolve("oak") == oak


def test_random_keeps_what_is_given():
    for i in range(10):
        given = Material(f"m{i}", texture="checker", rgb1=RED, random=True)
        picture = pixels(world(box(given)).to_spec().compile(), f"m{i}").reshape(-1, 3)
        colours = np.unique(picture, axis=0)
        assert len(colours) == 2
        assert RED in [tuple(c) for c in colours]
        tinted = world(box(Material(f"m{i}", rgba=(*BLUE, 1), random=True))).to_spec().compile()
        assert tinted.ntex == 1
        close(tinted.mat_rgba[0], (*BLUE, 1))


def test_worlds_with_materials_load_in_mujoco_and_mjx():
    builder = world(box(Material(texture="checker")), ObjFromXML("agent").set_material(Material("m", (*RED, 1))))
    builder.children[0].obj.set_material(Material("g", texture="gradient", texture_type="2d", repeat=(4, 2)))
    model = mujoco.MjModel.from_xml_string(builder.to_mjcf())
    assert (model.nmat, model.ntex) == (3, 2)
    close(model.material("g").texrepeat, [4, 2])
    assert mjx.make_data(mjx.put_model(model, impl="jax")).qpos.shape == (8,)


def png(path, colours):
    """A PNG file of 8 by 8 fields of one pixel each, (8, 8, channels), or with other sizes."""
    Image.fromarray(np.asarray(colours, np.uint8)).save(path)
    return path


@pytest.mark.parametrize("texture_type", ["cube", "2d"])
@pytest.mark.parametrize("channels", [3, 4])
def test_a_picture_from_a_file(tmp_path, monkeypatch, texture_type, channels):
    """Its pixels are in the model, and in that of the exported file, wherever that is loaded."""
    colours = seeds.rng(0).integers(0, 256, (8, 8, channels))
    png(tmp_path / "Letters.PNG", colours)
    monkeypatch.chdir(tmp_path)
    material = Material("m", texture="Letters.PNG", texture_type=texture_type)
    assert material == Material("m", texture=tmp_path / "Letters.PNG", texture_type=texture_type)
    assert hash(material) == hash(material.resolve("box0"))
    builder = world(box(material), box(material))
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    for model in (builder.to_spec().compile(), mujoco.MjModel.from_xml_string(builder.to_mjcf())):
        assert (model.ntex, model.nmat) == (1, 1)
        close(pixels(model, "m")[:8] * 255, colours[..., :3])
        close(model.geom("box0").rgba, 1)
        assert model.geom_matid.tolist() == [-1, 0, 0]
    assert mjx.put_model(model, impl="jax").nq == 8


def test_a_picture_that_repeats_and_is_tinted(tmp_path):
    path = png(tmp_path / "tiles.png", np.zeros((4, 12, 3)))
    tiles = Material("m", (1, 0.5, 0.5, 1), path, texture_type="2d", repeat=(3, 2))
    model = world(box(tiles)).to_spec().compile()
    assert pixels(model, "m").shape == (4, 12, 3)
    close(model.material("m").texrepeat, [3, 2])
    close(model.material("m").rgba, [1, 0.5, 0.5, 1])


def test_bad_pictures_are_named(tmp_path):
    good = png(tmp_path / "good.png", np.zeros((8, 8, 3)))
    wide = png(tmp_path / "wide.png", np.zeros((8, 9, 3)))
    (tmp_path / "text.png").write_text("a picture of a cat")
    (tmp_path / "cut.png").write_bytes(good.read_bytes()[:50])
    (tmp_path / "empty.png").write_bytes(b"")
    jpeg = png(tmp_path / "photo.jpg", np.zeros((8, 8, 3)))
    jpeg.rename(tmp_path / "photo.png")
    for name, match in [
        ("missing.png", "which is no file; takes a PNG file"),
        ("photo.png", "which holds no PNG image; takes"),
        ("text.png", "which holds no PNG image; takes"),
        ("empty.png", "which holds no PNG image; takes"),
        ("cut.png", r"which MuJoCo refuses \(.*\); takes a whole PNG image"),
        ("wide.png", r"which MuJoCo refuses \(.*\); takes .*'cube' a square one"),
        ("good.tiff", "takes one of .*'checker'.*, or the path of a PNG file"),
    ]:
        with pytest.raises(ValueError, match=rf"^texture: got .*{name}'\)?[;,] {match}"):
            Material("m", texture=tmp_path / name)
    Material("m", texture=wide, texture_type="2d")
    for options, match in [
        ({"rgb1": RED}, "^rgb1: got .* without a texture of colours; takes None there"),
        ({"random": True}, "^random: got True with a file as texture; takes False"),
        ({"repeat": (2, 2)}, "^repeat.*2d"),
    ]:
        with pytest.raises(ValueError, match=match):
            Material("m", texture=good, **options)
    with pytest.raises(ValueError, match=r"^texture: got 7; takes one of"):
        Material("m", texture=7)


PLAIN = Material("m", (1, 1, 1, 1))


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: Material("m"), "^rgba.*random"),
        (lambda: Material("", RED), "^name"),
        (lambda: Material("m", RED), "^rgba"),
        (lambda: Material("m", (*RED, 2)), "^rgba"),
        (lambda: Material("m", texture="wood"), "^texture.*wood.*checker"),
        (lambda: Material("m", texture="flat", rgb1=(1, 1)), "^rgb1"),
        (lambda: Material("m", texture="flat", rgb2=(1, 1, 7)), "^rgb2"),
        (lambda: Material("m", (*RED, 1), rgb1=RED), "^rgb1.*without a texture"),
        (lambda: Material("m", texture="flat", texture_type="sphere"), "^texture_type.*sphere.*cube"),
        (lambda: Material("m", texture="flat", repeat=(2, 2)), "^repeat.*2d"),
        (lambda: Material("m", texture="flat", texture_type="2d", repeat=(2, 0)), "^repeat"),
        (lambda: Material("m", texture="flat", rgb1=RED, rgb2=RED, random=True), "^random"),
        (lambda: Material("m", texture="flat", seed=3), "^seed"),
        (lambda: Material("m", random=True, seed="x"), "^seed"),
        (lambda: Wedge().set_material(RED), "^material"),
        (lambda: Wedge().set_material(PLAIN).set_material(PLAIN), "^material.*already"),
        (lambda: world(box(PLAIN), box(Material("m", (0, 1, 1, 1)))).to_spec(), "^name.*'m'"),
    ],
)
def test_wrong_arguments_are_named(make, match):
    with pytest.raises(ValueError, match=match):
        make()
