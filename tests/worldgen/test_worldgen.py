"""The object tree: its five phases, sizes and places, and the MuJoCo models that come out of it."""

from __future__ import annotations

from collections import Counter

import mujoco
import numpy as np
import pytest
from helpers import seeds
from hypothesis import given
from hypothesis import strategies as st
from mujoco import mjx

from maax_mjx.worldgen import Floor, Geom, Hinge, ObjFromXML, Slide, Wedge, WorldBuilder, WorldFullError, WorldParams

CUBE = (0.5, 0.5, 0.5)
SEEDS = range(30)
close = np.testing.assert_allclose


def world(*objects, seed=0, size=6.0, params=None, friction=None):
    """A builder with objects on its floor."""
    builder = WorldBuilder(params, seeds.seed(seed))
    floor = builder.append(Floor(size, friction=friction))
    for obj in objects:
        floor.append(obj)
    return builder


def compiled(builder):
    model = builder.to_spec().compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def kinds():
    return [Geom("box", (0.3, 0.4, 0.5)), Geom("sphere", (0.3,)), Wedge(), ObjFromXML("agent")]


def test_five_phases():
    builder, floor = WorldBuilder(), Floor(4.0)
    table, box = Geom("box", (1, 1, 0.4)), Geom("box", (0.2, 0.2, 0.2), (0.4, 0.4, 0.4))
    assert builder.append(floor) is floor
    assert floor.append(table, "top", (1.0, 0.0)) is table
    table.append(box, placement_xy=(0.0, 0.5))
    assert table.name is None
    floor.assign_names(Counter())
    assert (table.name, box.name) == ("box0", "box1")
    assert not hasattr(box, "size")
    floor.generate(seeds.rng(0))
    assert ((box.size >= 0.2) & (box.size <= 0.4)).all()
    assert not hasattr(box, "position")
    floor.locate(np.array([10.0, 20.0, 0.0]))
    close(table.position, [13, 20, 0])
    close(box.position, [13, 20 + (1 - box.size[1]) / 2, 0.4])
    close(box.centre, box.position + box.size / 2)
    spec = mujoco.MjSpec()
    floor.add_to_spec(spec, spec.worldbody)
    assert [b.name for b in spec.bodies] == ["world", "box0", "box1"]
    close(spec.body("box1").pos, box.centre)


def test_names_are_numbered_by_kind_over_the_whole_tree():
    table = Geom("box", (2, 2, 0.4))
    table.append(Geom("box", CUBE))
    table.append(Geom("sphere", (0.2,)))
    rest = [Geom("cylinder", (0.2, 0.3), name="can"), Geom("sphere", (0.2,)), Geom("box", CUBE), *kinds()[2:]]
    model, _ = compiled(world(table, *rest))
    names = ["box0", "box1", "sphere0", "can", "sphere1", "box2", "wedge0", "agent0"]
    assert [model.body(i).name for i in range(1, model.nbody)] == names
    assert [model.geom(i).name for i in range(8)] == ["floor", *names[:-1]]


@pytest.mark.parametrize(
    ("kind", "low", "high"),
    [("box", (0.2, 0.3, 0.4), (0.4, 0.3, 1.0)), ("sphere", (0.1,), (0.9,)), ("cylinder", (0.1, 0.5), (0.3, 2.0))],
)
def test_sizes_are_drawn_between_the_extents(kind, low, high):
    low, high, drawn = np.array(low), np.array(high), []
    for seed in SEEDS:
        model, data = compiled(world(Geom(kind, low, high), seed=seed))
        extents = 2 * model.geom("box0" if kind == "box" else f"{kind}0").size[: len(low)]
        height = {"box": extents[-1], "sphere": extents[0], "cylinder": extents[-1]}[kind]
        close(data.xpos[1, 2], height / 2)
        drawn.append(extents)
    drawn = np.array(drawn)
    assert ((drawn >= low - 1e-9) & (drawn <= high + 1e-9)).all()
    assert (np.ptp(drawn, axis=0) >= 0.7 * (high - low)).all()
    model, _ = compiled(world(Geom(kind, low), seed=1))
    close(2 * model.geom(1).size[: len(low)], low)


fractions = st.tuples(st.floats(0, 1), st.floats(0, 1))


@given(on_floor=fractions, on_table=fractions)
def test_placement_xy_is_a_fraction_of_the_free_span(on_floor, on_table):
    builder = WorldBuilder()
    table = builder.append(Floor(5.0)).append(Geom("box", (2, 1, 0.4)), placement_xy=on_floor)
    table.append(Geom("box", (0.5, 0.2, 0.3)), placement_xy=on_table)
    _, data = compiled(builder)
    (x, y), (u, v) = on_floor, on_table
    close(data.xpos[1], [3 * x + 1, 4 * y + 0.5, 0.2], atol=1e-9)
    close(data.xpos[2], [3 * x + 1.5 * u + 0.25, 4 * y + 0.8 * v + 0.1, 0.55], atol=1e-9)


def overlapping_pairs(model, data):
    """How many of the boxes overlap seen from above, and whether any leaves a floor of 3 m."""
    centre, half = data.geom_xpos[1:, :2], model.geom_size[1:, :2]
    meet = (abs(centre[:, None] - centre) < half[:, None] + half - 1e-9).all(axis=-1)
    return np.triu(meet, 1).sum(), ((centre < half - 1e-9) | (centre > 3 - half + 1e-9)).any()


def test_random_placement_never_overlaps():
    centres = []
    for seed in SEEDS:
        model, data = compiled(
            world(*(Geom("box", (0.3, 0.3, 0.2), (0.8, 0.8, 0.2)) for _ in range(6)), seed=seed, size=3)
        )
        assert overlapping_pairs(model, data) == (0, False)
        centres.append(data.geom_xpos[1:, :2])
    assert np.ptp(np.concatenate(centres), axis=0).min() > 2.0


def test_random_placement_avoids_given_places():
    for seed in SEEDS:
        builder = WorldBuilder(seed=seeds.seed(seed))
        floor = builder.append(Floor(3.0))
        floor.append(Geom("box", (0.8, 0.8, 1)))
        floor.append(Geom("box", (0.8, 0.8, 1)), placement_xy=(0.5, 0.5))
        assert overlapping_pairs(*compiled(builder)) == (0, False)


def test_a_floor_of_two_lengths():
    """Its plane, what lies on it, its marks and its export; a square one as before."""
    builder = WorldBuilder(seed=seeds.seed(0))
    floor = builder.append(Floor((2.0, 5.0)))
    floor.mark("far_corner", (1, 1, 0))
    for _ in range(8):
        floor.append(Geom("box", (0.5, 0.4, 0.3)))
    corner = floor.append(Geom("box", (0.4, 0.2, 0.3), name="corner"), placement_xy=(1.0, 1.0))
    model = mujoco.MjModel.from_xml_string(builder.to_mjcf())
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    close(model.geom("floor").size[:2], [1, 2.5])
    close(data.geom("floor").xpos, [1, 2.5, 0])
    close(data.site("far_corner").xpos, [2, 5, 0])
    close(corner.centre, [1.8, 4.9, 0.15])
    centre, half = data.geom_xpos[1:, :2], model.geom_size[1:, :2]
    assert (centre - half >= -1e-6).all()
    assert (centre + half <= np.array([2, 5]) + 1e-6).all()
    assert np.ptp(centre[:, 1]) > 2.5 > 2 > np.ptp(centre[:, 0])
    assert Floor(3).edges.tolist() == Floor([3, 3.0]).edges.tolist() == [3, 3]
    with pytest.raises(WorldFullError, match="wide"):
        world(Geom("box", (3.0, 1.0, 0.5), name="wide"), size=(2.0, 5.0)).to_spec()


def test_drawn_places_keep_the_margin():
    """From each other, from given ones, and from the edges of the floor and of a table's top."""
    margin, nearest = 0.3, []
    for seed in SEEDS:
        table = Geom("box", (2.0, 1.6, 0.4), name="table")
        for _ in range(2):
            table.append(Geom("box", (0.2, 0.2, 0.1)))
        objects = [Geom("box", (0.2, 0.2, 0.2), (0.6, 0.6, 0.2)) for _ in range(4)]
        builder = world(table, *objects, seed=seed, size=(6.0, 7.0), params=WorldParams(placement_margin=margin))
        floor = builder.children[0].obj
        given = floor.append(Geom("box", (0.5, 0.5, 0.5)), placement_xy=(0.0, 0.0))
        model = builder.to_spec().compile()
        close(given.position, 0)
        for parent, drawn in ((floor, [table, *objects]), (table, [child.obj for child in table.children])):
            low, high = (np.array([o.position[:2] + end * o.size[:2] for o in drawn]) for end in (0, 1))
            edges = np.minimum(low - parent.position[:2], parent.position[:2] + parent.size[:2] - high)
            everything = [*drawn, given] if parent is floor else drawn
            gaps = [
                np.maximum(a.position - b.position - b.size, b.position - a.position - a.size)[:2].max()
                for i, a in enumerate(everything)
                for b in everything[:i]
            ]
            assert min(gaps) >= margin - 1e-9
            assert edges.min() >= margin - 1e-9
            nearest.append((min(gaps), edges.min()))
        assert model.nbody == 9
    assert np.min(nearest, axis=0).max() < margin + 0.1
    too_wide = Geom("box", (5.5, 0.5, 0.5), name="wide")
    with pytest.raises(WorldFullError, match=r"^wide of size .* with a margin of 0.3 m"):
        world(too_wide, params=WorldParams(placement_margin=margin)).to_spec()
    with pytest.raises(WorldFullError, match=r"no room for box1 .* with a margin of 0.8 m"):
        world(*(Geom("box", (2, 2, 1)) for _ in range(2)), params=WorldParams(placement_margin=0.8), size=5).to_spec()


def test_full_worlds_are_refused():
    with pytest.raises(WorldFullError, match="huge"):
        world(Geom("box", (0.5, 3.1, 0.5), name="huge"), size=3).to_spec()
    with pytest.raises(WorldFullError, match="box1"):
        world(*(Geom("box", (1.6, 1.6, 1)) for _ in range(2)), size=3).to_spec()
    table = Geom("box", (1, 1, 0.4))
    table.append(Geom("box", (0.5, 1.1, 0.5), name="wide"))
    with pytest.raises(WorldFullError, match="wide"):
        world(table).to_spec()
    world(Geom("box", (3, 3, 1)), size=3).to_spec()  # what fits exactly, fits


def test_parking_stacks_without_touching():
    builder = WorldBuilder()
    floor = builder.append(Floor(6.0))
    for extent in (0.3, 4.0, 0.5, 2.0):
        floor.append(Geom("box", (extent, extent, extent)), "parking", (0.5, 0.5))
    model, data = compiled(builder)
    low, high = (data.geom_xpos[1:, 2] + s * model.geom_size[1:, 2] for s in (-1, 1))
    assert low[0] >= 20
    assert (low[1:] - high[:-1] > 0.5).all()
    close(data.geom_xpos[1:, :2], 3)


@pytest.mark.parametrize("free", [False, True])
def test_nested_stacks_rest_where_they_were_put(free):
    builder = WorldBuilder(seed=seeds.seed(3))
    table = builder.append(Floor()).append(Geom("box", (1, 1, 0.4), free=free))
    box = table.append(Geom("box", (0.4, 0.4, 0.3), free=free))
    box.append(Geom("cylinder", (0.2, 0.2), free=free))
    model, data = compiled(builder)
    start = data.xpos.copy()
    close(start[1:, 2], [0.2, 0.55, 0.8])
    for _ in range(200):
        mujoco.mj_step(model, data)
    close(data.xpos, start, rtol=0, atol=2e-3)
    assert data.ncon >= 3


def test_the_seed_determines_the_mjcf():
    def mjcf(seed):
        return world(*kinds(), Geom("box", (0.1, 0.1, 0.1), (0.5, 0.5, 0.5)), seed=seed).to_mjcf()

    assert mjcf(0) == mjcf(0)
    assert len({mjcf(seed) for seed in SEEDS}) == len(SEEDS)
    builder = world(*kinds())
    assert builder.to_mjcf() == builder.to_mjcf()


def test_models_load_in_mujoco_and_mjx():
    builder = world(*kinds(), params=WorldParams(0.002, -5.0, 7, 9), friction=0.3)
    model, _ = compiled(builder)
    loaded = mujoco.MjModel.from_xml_string(builder.to_mjcf())
    for name in ("nbody", "njnt", "nu", "ngeom", "nmesh"):
        assert getattr(loaded, name) == getattr(model, name)
    for name in ("body_pos", "qpos0", "geom_size", "geom_friction", "dof_damping", "body_mass"):
        close(getattr(loaded, name), getattr(model, name), rtol=1e-5, atol=1e-5)
    for m in (model, loaded):
        assert (m.opt.timestep, m.opt.iterations, m.opt.ls_iterations) == (0.002, 7, 9)
        assert m.opt.solver == mujoco.mjtSolver.mjSOL_NEWTON
        close(m.opt.gravity, [0, 0, -5])
        close(m.geom("floor").friction[0], 0.3)
        assert mjx.put_model(m, impl="jax").nq == 16


def test_agent():
    yellow = (1.0, 1.0, 0.0, 1.0)
    model, data = compiled(world(ObjFromXML("agent", rgba=yellow), ObjFromXML("agent"), ObjFromXML("agent", "bob")))
    parts = ["x", "y", "z", "yaw"]
    names = ["agent0", "agent1", "bob"]
    assert [model.body(i).name for i in range(model.nbody)] == ["world", *names]
    assert [model.joint(i).name for i in range(model.njnt)] == [f"{n}:{p}" for n in names for p in parts]
    assert [model.actuator(i).name for i in range(model.nu)] == [f"{n}:{p}" for n in names for p in ("x", "y", "yaw")]
    geoms = [f"{n}{g}" for n in names for g in ("", ":hand_left", ":hand_right")]
    assert [model.geom(i).name for i in range(model.ngeom)] == ["floor", *geoms]
    close(model.body_mass[1:], 1)
    close(model.dof_damping, [10, 10, 1, 10] * 3)
    for i in range(model.nu):
        assert model.actuator(i).trnid[0] == model.joint(model.actuator(i).name).id
    close(model.actuator_gear, np.eye(6)[[0]] * 100 * np.ones((9, 1)))
    close(model.actuator_ctrlrange, np.tile([-1, 1], (9, 1)))
    assert model.actuator_ctrllimited.all()
    assert model.geom("agent0").type == mujoco.mjtGeom.mjGEOM_SPHERE
    close(model.geom("agent0").size[0], 0.15)
    close(model.geom_rgba[1:4], np.tile(yellow, (3, 1)))
    for side in ("left", "right"):
        hand = model.geom(f"agent0:hand_{side}")
        assert hand.contype[0] == hand.conaffinity[0] == 0
        assert data.geom(f"agent0:hand_{side}").xpos[1] < data.body("agent0").xpos[1] - 0.1
    assert model.geom("agent0").contype[0]
    assert model.geom("agent0").conaffinity[0]


def test_wedge_rises_at_45_degrees_towards_low_y():
    model, data = compiled(world(Wedge(0.5, "ramp", mass=1.0)))
    x, y, z = data.xpos[1] - 0.25
    close(z, 0, atol=1e-9)
    close(model.body_mass[1], 1)
    geom = np.zeros(1, np.int32)

    def surface(dx, dy):
        above, down = np.array([x + dx, y + dy, 2.0]), np.array([0.0, 0.0, -1.0])
        height = 2.0 - mujoco.mj_ray(model, data, above, down, None, 1, -1, geom)
        return height, model.geom(geom[0]).name

    for dx in (0.01, 0.25, 0.49):
        for dy in (0.01, 0.125, 0.25, 0.375, 0.49):
            height, name = surface(dx, dy)
            close(height, 0.5 - dy, atol=1e-6)
            assert name == "ramp"
    for dx, dy in ((-0.01, 0.25), (0.51, 0.25), (0.25, -0.01), (0.25, 0.51)):
        assert surface(dx, dy)[1] == "floor"


def test_qpos_of_slides_is_the_absolute_position():
    model, data = compiled(world(*kinds(), seed=5))
    close(data.qpos.reshape(4, 4), np.concatenate([data.xpos[1:], np.zeros((4, 1))], axis=1), atol=1e-12)
    target = np.array([[1.0, 2.0, 3.0, 0.5], [4.0, 0.5, 1.0, -0.2], [0, 0, 0, 3.0], [-7.0, 8.0, 0.1, 1.0]])
    data.qpos[:] = target.ravel()
    mujoco.mj_forward(model, data)
    close(data.xpos[1:], target[:, :3], atol=1e-12)
    yaw = 2 * np.arctan2(data.xquat[1:, 3], data.xquat[1:, 0])
    close(yaw, target[:, 3], atol=1e-12)


def test_free_and_static_objects():
    free, stays = [Geom("box", CUBE, name="a", free=True), Wedge(0.5, "b", free=True)], Geom("box", CUBE, name="c")
    wedge = Wedge(0.4, "d")
    assert stays.mark_static() is stays
    model, data = compiled(world(*free, stays, wedge.mark_static(), seed=2))
    assert [model.joint(i).name for i in range(model.njnt)] == ["a:free", "b:free"]
    assert (model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).all()
    close(data.qpos.reshape(2, 7)[:, :3], data.xpos[1:3])
    assert model.nbody == 3
    for obj in (stays, wedge):
        assert model.geom(obj.name).bodyid[0] == 0
    close(data.geom("c").xpos, stays.centre)
    close(data.geom("c").xpos[2], 0.25)


def test_a_static_child_joins_its_movable_parent():
    builder = WorldBuilder()
    table = builder.append(Floor()).append(Geom("box", (1, 1, 0.4), name="table"), placement_xy=(0.5, 0.5))
    lamp = table.append(Geom("box", (0.2, 0.2, 0.2), name="lamp").mark_static(), placement_xy=(0.0, 0.0))
    model, data = compiled(builder)
    assert model.geom("lamp").bodyid[0] == model.body("table").id
    close(data.geom("lamp").xpos, lamp.centre)


def test_a_static_object_from_xml_has_no_joints():
    assert compiled(world(ObjFromXML("agent").mark_static()))[0].njnt == 0


def test_joint_and_surface_options():
    options = dict(mass=3.0, friction=0.4, damping=0.7, rgba=(0.1, 0.2, 0.3, 1.0))
    objects = [Geom("box", CUBE, **options), Wedge(0.5, **options), Geom("sphere", (0.5,), free=True, **options)]
    model, _ = compiled(world(*objects, Geom("box", CUBE), Wedge()))
    close(model.dof_damping, [0.7] * (4 + 4 + 6) + [0.01] * 4 + [0.1] * 4)
    # Damping is linear in the velocity: MuJoCo's higher coefficients are zero.
    assert model.dof_dampingpoly.size
    assert not model.dof_dampingpoly.any()
    close(model.body_mass[1:], [3, 3, 3, 1, 1])
    close(model.geom_friction[:, 0], [1, 0.4, 0.4, 0.4, 1, 1])
    close(model.geom_rgba[1:4], np.tile(options["rgba"], (3, 1)), rtol=1e-6)
    assert (model.geom_condim == 3).all()


def test_a_door_turns_about_its_hinge_and_a_drawer_slides():
    half, angle = 0.3, 0.7
    hinge = Hinge(anchor=(-half, 0, 0), range=(-1, 2))
    builder = WorldBuilder()
    floor = builder.append(Floor())
    door = floor.append(
        Geom("box", (2 * half, 0.06, 1.0), name="door", joint=hinge, damping=0.5), placement_xy=(0.5, 0.5)
    )
    drawer = Geom("box", (0.2, 0.2, 0.2), name="drawer", joint=Slide(axis=(0, 2, 0), range=(0, 0.4)))
    floor.append(drawer, placement_xy=(0.1, 0.1))
    model, data = compiled(builder)
    assert [model.joint(i).name for i in range(model.njnt)] == ["door:hinge", "drawer:slide"]
    close(model.jnt_range, [[-1, 2], [0, 0.4]])
    assert model.jnt_limited.all()
    close(model.dof_damping, [0.5, 0.01])
    start = door.centre, drawer.centre
    data.qpos[:] = angle, 0.25
    mujoco.mj_kinematics(model, data)
    close(data.geom("door").xpos - start[0], [half * np.cos(angle) - half, half * np.sin(angle), 0], atol=1e-9)
    close(data.geom("drawer").xpos - start[1], [0, 0.25, 0], atol=1e-9)
    # A push opens the door as far as it goes.
    model.geom_conaffinity[:] = model.geom_contype[:] = 0
    for _ in range(1000):
        data.qfrc_applied[0] = 1.0
        mujoco.mj_step(model, data)
    close(data.qpos[0], 2.0, atol=0.05)


XML = '<mujoco><worldbody><body name="{}"><geom type="box" size=".1 .1 .1"/></body></worldbody></mujoco>'


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: WorldParams(timestep=0.0), "^timestep"),
        (lambda: WorldParams(iterations=0), "^iterations"),
        (lambda: WorldParams(ls_iterations=0), "^ls_iterations"),
        (lambda: WorldBuilder().to_spec(), "floor"),
        (lambda: world().append(Floor()), "^obj"),
        (lambda: Floor(0.0), "^size"),
        (lambda: Floor(-1.0), "^size"),
        (lambda: Floor((4.0, 0.0)), r"^size: got .4.0, 0.0.; takes a positive length in metres, or two"),
        (lambda: Floor((4.0, 5.0, 6.0)), "^size: got .4.0, 5.0, 6.0.; takes"),
        (lambda: Floor("wide"), "^size: got 'wide'; takes"),
        (lambda: WorldParams(placement_margin=-0.1), "^placement_margin: got -0.1; takes a number of at least 0"),
        (lambda: Geom("cone", (1, 1, 1)), "^geom_type.*cone"),
        (lambda: Geom("box", (1, 1)), "^min_size"),
        (lambda: Geom("sphere", (1, 1)), "^min_size"),
        (lambda: Geom("cylinder", (1,)), "^min_size"),
        (lambda: Geom("box", (1, 0, 1)), "^min_size"),
        (lambda: Geom("box", (1, 1, 1), (1, 0.5, 1)), "max_size"),
        (lambda: Geom("box", (1, 1, 1), (1, 1)), "max_size"),
        (lambda: Geom("box", CUBE, joint="hinge"), "^joint: got 'hinge'"),
        (lambda: Geom("box", CUBE, joint=Slide(), free=True), "^joint: got Slide.*free=True; takes"),
        (lambda: Hinge(axis=(0, 0, 0)), "^axis.*not all zero"),
        (lambda: Hinge(anchor=(0, 0)), "^anchor: got .0, 0.; takes three numbers"),
        (lambda: Hinge(range=(1, -1)), "^range: got .1, -1.; takes .* radians with low < high"),
        (lambda: Slide(axis="x"), "^axis: got 'x'; takes three numbers"),
        (lambda: Slide(range=0.4), "^range: got 0.4; takes .* metres"),
        (lambda: Wedge(0.0), "^extent"),
        (lambda: ObjFromXML("no_such_file"), "^source.*no_such_file.*agent"),
        (lambda: Floor().append(Wedge(), placement_xy=(0.5, 1.1)), "^placement_xy"),
        (lambda: Floor().append(Wedge(), placement_xy=(-0.1, 0.5)), "^placement_xy"),
        (lambda: [Floor().append(w) for w in [Wedge()] * 2], "^obj.*parent"),
    ],
)
def test_wrong_arguments_are_named(make, match):
    with pytest.raises(ValueError, match=match):
        make()


def test_wrong_placements_and_files_are_named(tmp_path):
    builder = WorldBuilder()
    builder.append(Floor()).append(Wedge(), "bottom")
    with pytest.raises(ValueError, match=r"^placement_name.*bottom.*top"):
        builder.to_spec()
    for present, missing in (("main", "annotation:outer_bound"), ("annotation:outer_bound", "main")):
        (tmp_path / "thing.xml").write_text(XML.format(present))
        with pytest.raises(ValueError, match=f"^source.*{missing}"):
            ObjFromXML(tmp_path / "thing.xml")
