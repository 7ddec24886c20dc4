"""Marks, transforms, cut sizes, initial positions and stacks, judged by the compiled model and by C MuJoCo."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from helpers import seeds
from mujoco import mjx

from maax_mjx.worldgen import (
    Floor,
    Geom,
    Material,
    ObjFromXML,
    Wedge,
    WorldBuilder,
    WorldFullError,
    Written,
    remove_joints,
    set_geom_attr,
    set_joint_damping,
)

close = np.testing.assert_allclose
SEEDS = range(30)


def compiled(builder):
    model = builder.to_spec().compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def world(*objects, seed=0, size=6.0):
    builder = WorldBuilder(seed=seeds.seed(seed))
    floor = builder.append(Floor(size))
    for obj in objects:
        floor.append(obj)
    return builder


def kinds():
    return [Geom("box", (0.3, 0.4, 0.5)), Geom("cylinder", (0.3, 0.2), free=True), Wedge(), ObjFromXML("agent")]


def test_marks_are_sites_where_they_were_put():
    for seed, obj in enumerate([*kinds(), *(o.mark_static() for o in kinds())]):
        assert obj.mark("middle") is obj
        obj.mark("top_corner", (1, 0, 1)).mark("above", absolute_xyz=(0.1, 0.2, 1.5), rgba=(1, 0, 0, 0.5), size=0.02)
        obj.mark("cube", (0.25, 1, 0), geom_type="box")
        model, data = compiled(world(obj, seed=seed))
        assert model.nsite == 4
        corner = obj.position
        expected = {
            "middle": obj.centre,
            "top_corner": corner + obj.size * [1, 0, 1],
            "above": corner + np.array([0.1, 0.2, 1.5]),
            "cube": corner + obj.size * [0.25, 1, 0],
        }
        for name, position in expected.items():
            close(data.site(name).xpos, position, atol=1e-9)
        body = 0 if obj.static and not isinstance(obj, ObjFromXML) else 1
        assert (model.site_bodyid == body).all()
    assert model.site("above").size[0] == 0.02
    close(model.site("above").rgba, (1, 0, 0, 0.5))
    close(model.site("middle").rgba, (0, 0, 1, 1))
    assert model.site("cube").type == mujoco.mjtGeom.mjGEOM_BOX


def test_marks_of_floors_and_of_moving_objects():
    box = Geom("box", (0.4, 0.4, 0.4), name="box").mark("grip", (1, 0.5, 0.5))
    builder = world(box)
    builder.children[0].obj.mark("goal", (1, 0.5, 0)).mark("spot", absolute_xyz=(1, 2, 0.1))
    model, data = compiled(builder)
    close(data.site("goal").xpos, [6, 3, 0])
    close(data.site("spot").xpos, [1, 2, 0.1])
    data.joint("box:x").qpos = 1.0
    data.joint("box:yaw").qpos = np.pi / 2
    mujoco.mj_forward(model, data)
    close(data.site("grip").xpos, data.body("box").xpos + np.array([0, 0.2, 0]), atol=1e-12)


def test_a_transform_sees_what_its_object_wrote():
    seen = {}

    def look(name):
        def fn(written):
            assert isinstance(written, Written)
            names = [[e.name for e in elements] for elements in (written.geoms, written.joints, written.sites)]
            seen[name] = (written.body.name, *names)

        return fn

    table = Geom("box", (1, 1, 0.4), name="table").mark("m")
    table.append(Geom("box", (0.2, 0.2, 0.2), name="lamp").mark_static().add_transform(look("lamp")))
    table.append(Geom("box", (0.2, 0.2, 0.2), name="cup", free=True).add_transform(look("cup")))
    builder = world(table.add_transform(look("table")), ObjFromXML("agent", "a").add_transform(look("agent")))
    builder.children[0].obj.add_transform(look("floor"))
    assert builder.add_transform(look("world")) is builder
    builder.to_spec()
    slides = ["x", "y", "z", "yaw"]
    hands = ["a", "a:hand_left", "a:hand_right"]
    assert seen["floor"] == ("world", ["floor"], [], [])
    assert seen["table"] == ("table", ["table"], [f"table:{s}" for s in slides], ["m"])
    assert seen["lamp"] == ("table", ["lamp"], [], [])
    assert seen["cup"] == ("cup", ["cup"], ["cup:free"], [])
    assert seen["agent"] == ("a", hands, [f"a:{s}" for s in slides], [])
    assert sorted(seen["world"][1]) == sorted(["floor", "table", "lamp", "cup", *hands])
    assert len(seen["world"][2]) == 9
    assert seen["world"][3] == ["m"]


def test_ready_made_transforms():
    box, agent = Geom("box", (0.3, 0.3, 0.3), name="box"), ObjFromXML("agent", "a")
    box.add_transform(set_geom_attr("friction", (0.2, 0.01, 0.001))).add_transform(set_geom_attr("margin", 0.02))
    box.add_transform(remove_joints("slide", (0, 0, -2)))
    agent.add_transform(remove_joints("hinge")).add_transform(set_joint_damping(7.0, ":x"))
    builder = world(box, agent)
    builder.children[0].obj.add_transform(set_geom_attr("friction", (0.9, 0, 0)))
    builder.add_transform(set_joint_damping(3.0, "box:y"))
    model, _ = compiled(builder)
    close(model.geom_friction[:, 0], [0.9, 0.2, 1, 1, 1])
    close(model.geom("box").margin, 0.02)
    joints = {model.joint(i).name: model.joint(i).damping[0] for i in range(model.njnt)}
    assert joints == {"box:x": 0.01, "box:y": 3.0, "box:yaw": 3.0, "a:x": 7.0, "a:y": 10.0, "a:z": 1.0}
    assert [model.actuator(i).name for i in range(model.nu)] == ["a:x", "a:y"]


@pytest.mark.parametrize(
    ("args", "left"),
    [
        ((), ""),
        (("slide",), "yaw free"),
        (("hinge",), "x y z free"),
        (("free",), "x y z yaw"),
        (("slide", (3, 0, 0)), "y z yaw free"),
        ((None, (0, 0, -1)), "x y free"),
        (("slide", (1, 1, 0)), "x y z yaw free"),
    ],
)
def test_removed_joints_are_gone_for_the_next_transform_too(args, left):
    seen = []
    objects = [Geom("box", (0.3, 0.3, 0.3), name="a"), Geom("box", (0.3, 0.3, 0.3), name="b", free=True)]
    for obj in objects:
        obj.add_transform(remove_joints(*args)).add_transform(set_joint_damping(5.0))
        obj.add_transform(lambda written: seen.extend(joint.name for joint in written.joints))
    builder = world(*objects)
    model, _ = compiled(builder)
    assert [model.joint(i).name[2:] for i in range(model.njnt)] == left.split()
    assert [name[2:] for name in seen] == left.split()
    close(model.dof_damping, 5.0)


@pytest.mark.parametrize(("kind", "low", "high"), [("box", (0.2, 0.2, 3), (2, 2, 4)), ("cylinder", (0.2, 1), (2, 1))])
def test_drawn_extents_are_cut_to_the_placement(kind, low, high):
    widths = []
    for seed in SEEDS:
        table = Geom("box", (1.0, 0.5, 0.4))
        top = table.append(Geom(kind, low, high, name="on_top"))
        compiled(world(table, seed=seed))
        free = Geom(kind, low, high)
        world(free, seed=seed).to_spec()
        widths.append((*top.size, *free.size))
    x, y, z, *free = np.array(widths).T
    assert (x.max(), y.max()) == ((1.0, 0.5) if kind == "box" else (0.5, 0.5))
    assert min(x.min(), y.min()) < 0.5 or kind == "cylinder"
    assert z.min() >= low[-1]
    assert max(free[0]) > 1.5  # the floor holds them all


def test_what_is_too_large_at_its_smallest_is_refused():
    for geom in (Geom("box", (0.2, 0.6, 1), (2, 2, 1)), Geom("sphere", (0.6,), (2,)), Geom("box", (0.6, 0.6, 0.6))):
        table = Geom("box", (1.0, 0.5, 0.4))
        table.append(geom)
        with pytest.raises(WorldFullError, match=r"is larger than box0's 'top'"):
            world(table).to_spec()


def crowded(seed):
    table = Geom("box", (1.5, 1.5, 0.4), (2, 2, 0.4))
    for obj in (Geom("box", (0.2, 0.2, 0.2), (0.4, 0.4, 0.4), free=True), Wedge(0.2), Geom("sphere", (0.1,))):
        table.append(obj).mark(f"on_{obj.kind}").set_material(Material(random=True))
    builder = world(table, *kinds(), seed=seed)
    builder.children[0].obj.set_material(Material("ground", texture="checker", texture_type="2d", repeat=(6, 6)))
    return builder.add_transform(remove_joints("hinge"))


def test_the_same_seed_gives_the_same_world_in_any_order():
    mjcf = {seed: crowded(seed).to_mjcf() for seed in (0, 1)}
    assert mjcf[0] != mjcf[1]
    builder = crowded(0)
    first = builder.to_xinit()
    model = builder.to_spec().compile()
    assert [builder.to_mjcf() for _ in range(2)] == [mjcf[0]] * 2
    assert builder.to_spec().to_xml() == crowded(0).to_spec().to_xml()
    assert builder.to_mjcf() == mjcf[0]
    second, other = builder.to_xinit(), crowded(0).to_xinit()
    assert first.keys() == second.keys() == other.keys() == {model.joint(i).name for i in range(model.njnt)}
    for name, value in first.items():
        assert (np.asarray(value) == second[name]).all()
        assert (np.asarray(value) == other[name]).all()
        close(model.joint(name).qpos0, value)


def test_xinit_is_where_the_objects_are():
    objects = [Geom("box", (0.4, 0.4, 0.4), name="a"), Geom("box", (0.4, 0.4, 0.4), name="b", free=True)]
    xinit = world(*objects, seed=3).to_xinit()
    assert {name: np.shape(value) for name, value in xinit.items()} == {
        "a:x": (), "a:y": (), "a:z": (), "a:yaw": (), "b:free": (7,),
    }  # fmt: skip
    assert all(isinstance(xinit[f"a:{axis}"], float) for axis in ("x", "y", "z", "yaw"))
    close([xinit[f"a:{axis}"] for axis in ("x", "y", "z", "yaw")], [*objects[0].centre, 0])
    close(xinit["b:free"], [*objects[1].centre, 1, 0, 0, 0])


@pytest.mark.parametrize("free", [False, True])
def test_stacks_rest_for_two_seconds(free):
    builder = WorldBuilder(seed=seeds.seed(3))
    floor = builder.append(Floor())
    floor.append(Geom("box", (0.5, 0.5, 0.5), free=free))
    table = floor.append(Geom("box", (1, 1, 0.4), free=free))
    table.append(Geom("box", (0.4, 0.4, 0.3), free=free)).append(Geom("box", (0.2, 0.2, 0.2), free=free))
    model, data = compiled(builder)
    start = data.xpos.copy()
    close(np.sort(start[1:, 2]), [0.2, 0.25, 0.55, 0.8])
    mujoco.mj_step(model, data, round(2.0 / model.opt.timestep))
    moved = abs(data.xpos - start)
    assert moved[:, :2].max() < 1e-3
    assert moved[:, 2].max() < 2e-3
    assert data.ncon >= 4 * 3
    on_device = mjx.put_model(model, impl="jax")
    assert mjx.make_data(on_device).qpos.shape == (4 * (7 if free else 4),)


BOX = (0.2, 0.2, 0.2)
BAD = [
    (lambda: Wedge().mark(""), "^name"),
    (lambda: Wedge().mark("a").mark("a"), "^name.*'a'"),
    (lambda: world(Wedge().mark("a"), Wedge().mark("a")).to_spec(), "^name.*'a'"),
    (lambda: Wedge().mark("a", (0, 0)), "^relative_xyz.*three"),
    (lambda: Wedge().mark("a", (0, 0, np.nan)), "^relative_xyz"),
    (lambda: Wedge().mark("a", absolute_xyz=(0, 1)), "^absolute_xyz"),
    (lambda: Wedge().mark("a", (0, 0, 0), (0, 0, 0)), "^absolute_xyz.*one of the two"),
    (lambda: Wedge().mark("a", rgba=(0, 0, 2, 1)), "^rgba"),
    (lambda: Wedge().mark("a", geom_type="mesh"), "^geom_type.*mesh.*sphere"),
    (lambda: Wedge().mark("a", size=0), "^size"),
    (lambda: WorldBuilder().mark("a"), "floor"),
    (lambda: WorldBuilder().mark_static(), "mark_static"),
    (lambda: WorldBuilder().set_material(Material("m", (1, 1, 1, 1))), "set_material"),
    (lambda: Wedge().add_transform("damp"), "^fn.*damp"),
    (lambda: set_geom_attr("fricton", 1), "^name.*fricton.*'friction'"),
    (lambda: set_geom_attr("friction", "high"), "^value.*high.*friction"),
    (lambda: set_joint_damping(-1), "^damping"),
    (lambda: remove_joints("screw"), "^joint_type.*screw.*hinge"),
    (lambda: remove_joints("hinge", (0, 0, 0)), "^axis"),
    (lambda: remove_joints("hinge", (0, 1)), "^axis"),
    (lambda: remove_joints("free", (0, 0, 1)), "^axis.*free"),
    (lambda: Geom("box", BOX, mass=0.0), "^mass"),
    (lambda: Geom("box", BOX, friction=-0.1), "^friction"),
    (lambda: Wedge(damping=-0.1), "^damping"),
    (lambda: Wedge(rgba=(1, 1, 1)), "^rgba"),
    (lambda: Floor((True, 2.0)), r"^size: got \(True, 2.0\)"),
    (lambda: Floor().append(Geom("box", BOX), "a").add_transform(None), "^fn"),
]


@pytest.mark.parametrize(("make", "match"), BAD)
def test_wrong_arguments_are_named(make, match):
    with pytest.raises(ValueError, match=match):
        make()


def test_joints_without_names_are_named():
    agent = ObjFromXML("agent", "a")
    agent.add_transform(lambda written: setattr(written.joints[0], "name", ""))
    agent.add_transform(lambda written: [written.spec.delete(a) for a in written.spec.actuators])
    with pytest.raises(ValueError, match=r"^to_xinit: got a joint without a name in body 'a'; takes names"):
        world(agent).to_xinit()
