"""Objects from XML and STL files, judged by the compiled model and by C MuJoCo."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from helpers import seeds
from mujoco import mjx

from maax_mjx.worldgen import Floor, Geom, ObjFromSTL, ObjFromXML, WorldBuilder, WorldFullError, remove_joints

close = np.testing.assert_allclose
# A cupboard of 1.2 x 0.6 x 1 m: its box is centred at (1, 2, 0.5) in the file, its body stands at the foot of that.
CUPBOARD = """<mujoco>
  <compiler angle="degree"/>
  <default><default class="note"><geom type="box" contype="0" conaffinity="0"/></default></default>
  <worldbody>
    <body name="annotation:outer_bound" pos="1 2 0"><geom class="note" pos="0 0 .5" size=".6 .3 .5"/></body>
    <body name="annotation:top" pos="1 2 1.25"><geom class="note" size=".6 .3 .25"/></body>
    <frame pos="1 2 0">
      <body name="annotation:shelf0" pos="0 0 .3"><geom class="note" size=".5 .25 .2"/></body>
      <body name="annotation:shelf1" pos="0 0 .75"><geom class="note" size=".5 .25 .2"/></body>
    </frame>
    <body name="main" pos="1 2 0">
      <geom name="main" type="box" pos="0 0 .05" size=".6 .3 .05"/>
      <geom name="middle" type="box" pos="0 0 .525" size=".6 .3 .025"/>
      <geom name="roof" type="box" pos="0 0 .975" size=".6 .3 .025"/>
      <body name="door"><joint name="hinge" type="hinge" axis="0 0 1" pos=".6 0 0"/>
        <geom type="box" pos="0 -.29 .5" size=".6 .01 .4" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
</mujoco>"""


@pytest.fixture
def cupboard(tmp_path):
    (tmp_path / "cupboard.xml").write_text(CUPBOARD)
    return lambda name="c": ObjFromXML(tmp_path / "cupboard.xml", name)


def on_floor(obj, seed=0, size=4.0, at=(0.5, 0.5)):
    builder = WorldBuilder(seed=seeds.seed(seed))
    builder.append(Floor(size)).append(obj, placement_xy=at)
    return builder


def compiled(builder):
    model = builder.to_spec().compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


@pytest.mark.parametrize("static", [False, True])
def test_annotations_become_placements_and_leave_the_model(cupboard, static):
    thing = cupboard()
    if static:
        thing.mark_static()
    for name, origin in (("top", 1.0), ("shelf0", 0.1), ("shelf1", 0.55)):
        obj = Geom("box", (0.2, 0.1, 0.3), name=f"on_{name}")
        thing.append(obj, name, (0.0, 1.0))
        obj.expected = origin + 0.15
    model, data = compiled(on_floor(thing))
    assert not [model.body(i).name for i in range(model.nbody) if "annotation" in model.body(i).name]
    assert model.ngeom == 1 + 4 + 3
    close(data.body("c").xpos, [2, 2, 0], atol=1e-12)
    close(data.geom("c:roof").xpos, [2, 2, 0.975])
    assert thing.placements.keys() == {"top", "shelf0", "shelf1"}
    for child in thing.children:
        x, y = (-0.6, 0.3) if child.placement == "top" else (-0.5, 0.25)
        close(data.body(child.obj.name).xpos, [2 + x + 0.1, 2 + y - 0.05, child.obj.expected], atol=1e-9)
    assert thing.children[0].obj.position[2] == 1.0


def test_what_is_in_a_cupboard_stays_there(cupboard):
    thing = cupboard().mark_static()
    for name in ("top", "shelf0", "shelf1"):
        thing.append(Geom("box", (0.2, 0.2, 0.2), name=name, free=True), name)
    model, data = compiled(on_floor(thing, seed=4))
    start = data.xpos.copy()
    mujoco.mj_step(model, data, 400)
    close(data.xpos, start, rtol=0, atol=1e-3)


def test_placement_names_are_prefixes(cupboard):
    heights = []
    for seed in range(200):
        thing = cupboard()
        box = thing.append(Geom("box", (0.2, 0.2, 0.2)), "shelf")
        on_floor(thing, seed).to_spec()
        heights.append(round(float(box.position[2]), 6))
    counts = np.unique(heights, return_counts=True)
    assert counts[0].tolist() == [0.1, 0.55]
    assert counts[1].min() > 70  # of 200; 70 or fewer has a chance of 2e-5
    thing = cupboard()
    box = thing.append(Geom("box", (0.2, 0.2, 0.2)), "to")
    on_floor(thing).to_spec()
    assert box.position[2] == 1.0


def test_an_exact_placement_name_wins(cupboard, tmp_path):
    (tmp_path / "other.xml").write_text(CUPBOARD.replace("annotation:shelf0", "annotation:shelf"))
    for seed in range(20):
        thing = ObjFromXML(tmp_path / "other.xml")
        box = thing.append(Geom("box", (0.2, 0.2, 0.2)), "shelf")
        on_floor(thing, seed).to_spec()
        close(box.position[2], 0.1)


@pytest.mark.parametrize(
    ("extent", "placement"), [((0.2, 0.2, 0.41), "shelf0"), ((1.1, 0.2, 0.2), "shelf1"), ((0.2, 0.2, 0.51), "top")]
)
def test_children_must_fit_into_a_placement(cupboard, extent, placement):
    thing = cupboard()
    thing.append(Geom("box", extent, name="big"), placement)
    with pytest.raises(WorldFullError, match=rf"^big of size .*{placement}"):
        on_floor(thing).to_spec()
    exact = {"shelf0": (1.0, 0.5, 0.4), "shelf1": (1.0, 0.5, 0.4), "top": (1.2, 0.6, 0.5)}[placement]
    thing = cupboard()
    thing.append(Geom("box", exact), placement)
    on_floor(thing).to_spec()


def test_static_things_on_static_things_on_a_movable_one(cupboard):
    """Positions are absolute in the tree and relative in nested bodies."""
    table = Geom("box", (2.0, 2.0, 0.5), name="table")
    thing = table.append(cupboard().mark_static(), placement_xy=(1.0, 0.0))
    lamp = thing.append(Geom("box", (0.2, 0.2, 0.2), name="lamp").mark_static(), "top", (0.0, 0.0))
    thing.mark("corner", (0, 0, 0))
    model, data = compiled(on_floor(table))
    assert model.body("c").parentid[0] == model.body("table").id
    assert model.geom("lamp").bodyid[0] == model.body("c").id
    close(data.geom("lamp").xpos, lamp.centre)
    close(lamp.centre, [1.8 + 0.1, 1.0 + 0.1, 1.6])
    close(data.site("corner").xpos, [1.8, 1.0, 0.5], atol=1e-9)


def test_colours_reach_every_geom(tmp_path):
    (tmp_path / "cupboard.xml").write_text(CUPBOARD)
    model, _ = compiled(on_floor(ObjFromXML(tmp_path / "cupboard.xml", rgba=(1, 0, 0, 1))))
    close(model.geom_rgba[1:], np.tile([1, 0, 0, 1], (4, 1)))


def test_text_is_as_good_as_a_file(cupboard):
    from_file, from_text = cupboard("c"), ObjFromXML(f"\n  {CUPBOARD}", "c")
    assert on_floor(from_text).to_mjcf() == on_floor(from_file).to_mjcf()
    assert (from_file.kind, ObjFromXML(CUPBOARD).kind) == ("cupboard", "obj")


def test_bad_text_is_named():
    with pytest.raises(ValueError, match=r"^source: the text is not MJCF that MuJoCo takes: .*XML"):
        ObjFromXML("<mujoco><worldbody>")
    with pytest.raises(ValueError, match=r"^source: got the text without a body 'annotation:outer_bound'"):
        ObjFromXML("<mujoco/>")


BAD_XML = [
    ('pos="1 2 1.25"><geom class="note" size=".6 .3 .25"/>', ">", "annotation:top.*no box"),
    (
        'pos="1 2 1.25"><geom class="note"',
        'pos="1 2 1.25"><geom class="note" type="ellipsoid"',
        "annotation:top.*no box",
    ),
    ('pos="1 2 1.25">', 'pos="1 2 1.25" euler="0 0 30">', "annotation:top.*turned"),
    ('name="main" pos="1 2 0"', 'name="main" euler="0 0 90"', "main.*turned"),
    ("</worldbody>", '<body name="stray"/></worldbody>', "stray"),
    ("</worldbody>", "</wordbody>", "is not MJCF"),
    ('size=".6 .3 .025"', 'size="-1 .3 .025"', "MuJoCo"),
]


@pytest.mark.parametrize(("old", "new", "match"), BAD_XML)
def test_bad_xml_files_are_named(tmp_path, old, new, match):
    assert old in CUPBOARD
    (tmp_path / "bad.xml").write_text(CUPBOARD.replace(old, new))
    with pytest.raises(ValueError, match=rf"(?s)^source: .*{match}"):
        ObjFromXML(tmp_path / "bad.xml")
    with pytest.raises(ValueError, match=r"^rgba"):
        ObjFromXML("agent", rgba=(1.0, 0.0, 0.0))


# A gate that hangs on an arm with a ball joint.
GATE = """<mujoco><compiler angle="degree"/><worldbody>
  <body name="annotation:outer_bound"><geom type="box" size=".5 .5 .5"/></body>
  <body name="main">
    <joint name="x" type="slide" axis="1 0 0"/> <joint name="yaw" axis="0 0 1"/>
    <geom name="main" size=".1"/>
    <frame euler="0 0 90"><body pos=".2 0 0"><joint name="ball" type="ball"/><geom size=".05"/>
      <body pos="0 0 .1"><joint name="gate" axis="0 1 0" range="-90 90"/>
        <geom type="box" pos=".1 0 0" size=".1 .02 .05"/></body></body></frame>
  </body>
</worldbody></mujoco>"""


def test_default_poses_are_where_a_world_begins(cupboard):
    """In keyframe 0, in `to_xinit` and in the exported file; the pose is MuJoCo's own of that qpos."""
    builder = WorldBuilder()
    floor = builder.append(Floor())
    key = '<keyframe><key name="own" qpos="1 1 1 0 0 0 1"/></keyframe></mujoco>'
    gate = ObjFromXML(
        GATE.replace("</mujoco>", key), "g", default_qpos={"gate": 0.5, "ball": (0, 2, 0, 0), "yaw": [np.pi / 2]}
    )
    floor.append(gate, placement_xy=(0.5, 0.5))
    floor.append(ObjFromXML(CUPBOARD, "c", default_qpos={"hinge": -1.0}), placement_xy=(0.1, 0.1))
    floor.append(cupboard("closed"), placement_xy=(0.9, 0.9))
    loaded = mujoco.MjModel.from_xml_string(builder.to_mjcf())
    for model in (builder.to_spec().compile(), loaded):
        assert [model.key(i).name for i in range(model.nkey)] == ["start"]
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_forward(model, data)
        wanted = {
            "g:x": 3.0,
            "g:yaw": np.pi / 2,
            "g:ball": (0, 1, 0, 0),
            "g:gate": 0.5,
            "c:hinge": -1.0,
            "closed:hinge": 0,
        }
        for name, qpos in wanted.items():
            close(data.joint(name).qpos, qpos, atol=1e-5)
        # The arm of the gate points to -x: up to the frame's y, turned by the yaw. The ball turns its z downwards.
        close(data.body("g:body0").xpos - data.body("g").xpos, [-0.2, 0, 0], atol=1e-5)
        close(data.body("g:body1").xpos - data.body("g:body0").xpos, [0, 0, -0.1], atol=1e-5)
        turn = data.body("c:door").xmat.reshape(3, 3)
        close(turn[:, 0], [np.cos(1), -np.sin(1), 0], atol=1e-5)
        close(data.body("closed:door").xmat.reshape(3, 3), np.eye(3), atol=1e-5)
    xinit = builder.to_xinit()
    assert xinit.keys() == wanted.keys()
    for name, qpos in wanted.items():
        close(xinit[name], qpos, atol=1e-5)
    assert on_floor(cupboard()).to_spec().compile().nkey == 0


BAD_POSES = [
    ({"door": 1.0}, r"got a value for 'door'; takes joints of the file, .*\['ball', 'gate', 'yaw'\]"),
    ({"x": 1.0}, r"got a value for 'x'; takes joints of the file, except the slides"),
    ({"gate": (1, 2)}, r"default_qpos\['gate'\]: got \(1, 2\); takes a number"),
    ({"gate": "open"}, r"default_qpos\['gate'\]: got .*'open'.*; takes a number"),
    ({"gate": True}, r"default_qpos\['gate'\]: got .*True.*; takes a number"),
    ({"ball": 1.0}, r"default_qpos\['ball'\]: got 1.0; takes a quaternion"),
    ({"ball": (0, 0, 0, 0)}, r"default_qpos\['ball'\]: got \(0, 0, 0, 0\); takes a quaternion"),
    ([1.0], r"got \[1.0\]; takes a dict"),
]


@pytest.mark.parametrize(("pose", "match"), BAD_POSES)
def test_bad_default_poses_are_named(pose, match):
    with pytest.raises(ValueError, match=rf"^default_qpos.*{match}|^{match}"):
        ObjFromXML(GATE, default_qpos=pose)


def test_default_poses_that_a_world_cannot_have_are_named():
    for change, match in [
        (lambda gate: gate.mark_static(), "got gate of g, which is static; takes None"),
        (
            lambda gate: gate.add_transform(remove_joints("hinge", (0, 1, 0))),
            "got a value for 'g:gate', which the world",
        ),
    ]:
        gate = ObjFromXML(GATE, "g", default_qpos={"gate": 0.5})
        change(gate)
        with pytest.raises(ValueError, match=f"^default_qpos: {match}"):
            on_floor(gate).to_spec()
    with pytest.raises(ValueError, match=r"^default_qpos: got 2 for 'g:gate'; takes a value in its range \[-1.57"):
        on_floor(ObjFromXML(GATE, "g", default_qpos={"gate": 2.0})).to_spec()


TETRAHEDRON = np.array([[0, 0, 0], [0.6, 0, 0], [0, 0.4, 0], [0, 0, 0.3]]) + np.array([5.0, -3.0, 2.0])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def write_stl(path, vertices=TETRAHEDRON, faces=FACES, count=None):
    """A binary STL file: 80 bytes, the count, and 50 bytes a triangle."""
    facets = b"".join(bytes(12) + np.asarray(vertices)[face].astype("<f4").tobytes() + bytes(2) for face in faces)
    path.write_bytes(bytes(80) + np.uint32(len(faces) if count is None else count).tobytes() + facets)
    return path


@pytest.fixture
def stl(tmp_path):
    return write_stl(tmp_path / "tetra.stl")


@pytest.mark.parametrize("options", [{}, {"free": True}, {"static": True}])
def test_an_stl_fills_its_bounding_box_in_its_placement(stl, options):
    obj = ObjFromSTL(stl, friction=0.3, rgba=(1, 0, 0, 1), **{k: v for k, v in options.items() if k != "static"})
    if "static" in options:
        obj.mark_static()
    model, data = compiled(on_floor(obj, at=(1.0, 0.0)))
    geom = model.geom("tetra0")
    start, n = model.mesh_vertadr[geom.dataid[0]], model.mesh_vertnum[geom.dataid[0]]
    assert n == 4
    vertices = model.mesh_vert[start : start + n] @ data.geom("tetra0").xmat.reshape(3, 3).T + data.geom("tetra0").xpos
    expected = TETRAHEDRON - TETRAHEDRON.min(axis=0) + [4.0 - 0.6, 0.0, 0.0]
    close(np.unique(vertices.round(5), axis=0), np.unique(expected.round(5), axis=0), atol=2e-5)
    assert geom.condim[0] == 6
    close(geom.friction[0], 0.3)
    close(geom.rgba, (1, 0, 0, 1))
    joints = {"free": ["free"], "static": []}.get(next(iter(options), ""), ["x", "y", "z", "yaw"])
    assert [model.joint(i).name for i in range(model.njnt)] == [f"tetra0:{joint}" for joint in joints]
    if not options:
        close(model.dof_damping, 0.1)


def test_the_mass_of_an_stl(stl):
    volume = 0.6 * 0.4 * 0.3 / 6
    for options, mass in (({}, 1.0), ({"mass": 2.5}, 2.5), ({"density": 500.0}, 500 * volume)):
        close(compiled(on_floor(ObjFromSTL(stl, **options)))[0].body("tetra0").mass[0], mass, rtol=1e-5)


def test_stl_objects_share_meshes_load_anywhere_and_rest(stl, tmp_path):
    (tmp_path / "b").mkdir()
    other = write_stl(tmp_path / "b" / "tetra.stl", 2 * TETRAHEDRON)
    builder = WorldBuilder(seed=seeds.seed(1))
    floor = builder.append(Floor())
    for path in (stl, stl, other):
        floor.append(ObjFromSTL(path, free=True))
    model = mujoco.MjModel.from_xml_string(builder.to_mjcf())
    assert (model.nmesh, model.nbody) == (2, 4)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 400)
    close(data.qpos, model.qpos0, atol=2e-3)
    assert mjx.make_data(mjx.put_model(model, impl="jax")).qpos.shape == (21,)


def test_bad_stl_files_are_named(tmp_path, stl):
    flat = write_stl(tmp_path / "flat.stl", TETRAHEDRON * [1, 1, 0])
    text, short, empty, nan = (tmp_path / f"{name}.stl" for name in ("text", "short", "empty", "nan"))
    text.write_text("solid thing\nfacet normal 0 0 0\nouter loop\nvertex 0 0 0\n" * 9)
    short.write_bytes(stl.read_bytes()[:-1])
    empty.write_bytes(b"")
    write_stl(nan, TETRAHEDRON * np.nan)
    none = write_stl(tmp_path / "none.stl", faces=[])
    for path, match in [
        (tmp_path / "missing.stl", "no file"), (tmp_path, "no file"), (flat, "MuJoCo"), (text, "save it as binary"),
        (short, "bytes"), (empty, "0 bytes"), (nan, "finite"), (none, "0 triangles"),
    ]:  # fmt: skip
        with pytest.raises(ValueError, match=rf"^path: got '.*{path.stem}.*{match}"):
            ObjFromSTL(path)
    for options in ({"mass": 0}, {"mass": 1.0, "density": 2.0}, {"density": -1.0}, {"friction": -1}, {"damping": "a"}):
        name = list(options)[-1]
        with pytest.raises(ValueError, match=f"^{name}: got"):
            ObjFromSTL(stl, **options)


def test_bodies_that_a_file_excludes_from_contact_are_excluded_in_the_world():
    """Also where one is "main", which gets another name."""
    desk = """<mujoco><worldbody><body name="main"><joint name="x" type="slide" axis="1 0 0"/>
        <geom name="main" type="box" size=".2 .2 .1"/>
        <body name="drawer"><joint name="d" type="slide"/><geom name="front" type="box" size=".1 .1 .05"/></body></body>
        <body name="annotation:outer_bound"><geom type="box" size=".2 .2 .1"/></body></worldbody>
        <contact><exclude body1="main" body2="drawer"/></contact></mujoco>"""
    floor, builder = Floor(4.0), WorldBuilder()
    for i in range(2):
        floor.append(ObjFromXML(desk, f"desk{i}"), placement_xy=(0.3 + 0.4 * i, 0.5))
    builder.append(floor)
    model = builder.to_spec().compile()
    pairs = {(model.body(f"desk{i}").id, model.body(f"desk{i}:drawer").id) for i in range(2)}
    assert {(int(s) >> 16, int(s) & 0xFFFF) for s in model.exclude_signature} == pairs
