"""Export of any world of any batch to an MJCF file that moves as in the batch."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from typing import Any

import jax
import mujoco
import numpy as np

from maax_mjx.common.checks import check_not_donated
from maax_mjx.core.env import Environment
from maax_mjx.core.state import State, plain
from maax_mjx.physics import overlaid_model


def world_of(state: State, world: int | None = None) -> State:
    """Returns one world of a batch, on the host; a state of a single world is returned as it is.

    Raises:
        ValueError: a batch without `world`, or a `world` out of range.
        RuntimeError: a state that was donated to a later step.
    """
    if not isinstance(state, State):
        raise ValueError(f"state: got {type(state).__name__}; takes a State from reset or step")
    check_not_donated(state.step)
    shape = np.shape(state.step)
    if not shape:
        if world is not None:
            raise ValueError(f"world: got {world}; the state is of a single world and takes None")
        return jax.device_get(state)
    n = int(np.prod(shape))
    if isinstance(world, bool) or not isinstance(world, int | np.integer) or not -n <= world < n:
        raise ValueError(f"world: got {world}; the state is a batch and takes an index below {n}")
    at = tuple(int(i) for i in np.unravel_index(world % n, shape))
    return jax.device_get(_take(plain(state), at))


@jax.jit
def _take(state: State, at: tuple[int, ...]) -> State:
    return jax.tree.map(lambda x: x[at], state)


def to_mjcf(env: Environment, state: State, world: int | None = None) -> str:
    """Writes a world as an MJCF string, with its current state as keyframe 0.

    Numbers are written at full precision: plain MuJoCo, started from the keyframe, follows the `c` engine to rounding.
    Custom numerics hold what a keyframe cannot: `qacc_warmstart` and `xfrc_applied`.

    Args:
        env: the environment.
        state: a state of the environment, of one world or of a batch.
        world: index of the world in the batch.

    Example:
        ```python
        model = mujoco.MjModel.from_xml_string(maax.to_mjcf(env, states, world=3))
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        data.qacc_warmstart[:] = model.numeric("qacc_warmstart").data
        ```
    """
    one = world_of(state, world)
    model = overlaid_model(env.base.model, env.base.overlay, one.world.fields)
    root = ET.fromstring(env.base.spec.to_xml())
    _write_bodies(root, model)
    _write_geoms(root, model, env)
    for element in _child(root, "actuator"):
        element.set("gear", _numbers(model.actuator(element.get("name")).gear))
    _write_sites(root, env, one)
    _write_equalities(root, model, one.data.eq_active)
    option = _child(root, "option")
    option.set("timestep", _numbers([model.opt.timestep]))
    option.set("gravity", _numbers(model.opt.gravity))
    option.set("jacobian", "dense")  # as `c` has it: with sparse matrices Newton's method diverges
    data = one.data
    key = ET.SubElement(_child(root, "keyframe"), "key", name="state")
    exact = env.base.engine.exact(data)
    for name in ("time", "qpos", "qvel", "ctrl"):
        key.set(name, _numbers(exact[name]))
    custom = _child(root, "custom")
    for name in ("qacc_warmstart", "xfrc_applied"):
        value = exact[name]
        ET.SubElement(custom, "numeric", name=name, size=str(value.size), data=_numbers(value))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode")


def _write_bodies(root: ET.Element, model: mujoco.MjModel) -> None:
    for element in root.iter("body"):
        body = model.body(element.get("name"))
        element.set("pos", _numbers(body.pos))
        if model.ngravcomp:
            element.set("gravcomp", _numbers(model.body_gravcomp[body.id : body.id + 1]))
    # Only joints of bodies: an element of an equality is called "joint", too.
    for element in _child(root, "worldbody").iter("joint"):
        joint = model.joint(element.get("name"))
        # Only joints of one degree of freedom: the others have no range, and share their damping.
        if len(joint.damping) == 1:
            element.set("damping", _numbers(joint.damping))
        if element.get("type") == "slide":
            element.set("ref", _numbers(joint.qpos0))
        if model.jnt_limited[joint.id]:
            low, high = joint.range
            # A closed range is a lock. MuJoCo's parser takes none, but takes the narrowest that is not closed.
            element.set("range", _numbers([low, max(high, np.nextafter(low, np.inf))]))


def _write_geoms(root: ET.Element, model: mujoco.MjModel, env: Environment) -> None:
    for element in root.iter("geom"):
        geom = model.geom(element.get("name"))
        element.set("friction", _numbers(geom.friction))
        if element.get("mass") is not None:
            body = geom.bodyid
            share = model.body_mass[body] / env.base.model.body_mass[body]
            element.set("mass", _numbers([env.base.spec.geom(geom.name).mass * share[0]]))
        # A compiled mesh has its own frame, which the file does not have.
        if element.get("mesh") is None:
            element.set("pos", _numbers(geom.pos))
            element.set("size", _numbers(geom.size))


def _write_equalities(root: ET.Element, model: mujoco.MjModel, active: Any) -> None:
    for element in _child(root, "equality"):
        equality = model.eq(element.get("name"))
        data = model.eq_data[equality.id]
        element.set("active", "true" if active[equality.id] else "false")
        if element.tag == "joint":
            element.set("polycoef", _numbers(data[:5]))
        else:
            element.set("anchor", _numbers(data[:3]))
            if element.tag == "weld":
                element.set("relpose", _numbers(data[3:10]))
            elif active[equality.id]:
                _connect_sites(root, element, data)


def _connect_sites(root: ET.Element, connect: ET.Element, data: np.ndarray) -> None:
    """Connects sites instead of bodies: for bodies, MuJoCo computes the second anchor at their initial pose."""
    del connect.attrib["anchor"]
    bodies = {body.get("name"): body for body in _child(root, "worldbody").iter("body")}
    for i, pos in ((1, data[:3]), (2, data[3:6])):
        site = f"{connect.get('name')}:{i}"
        ET.SubElement(bodies[connect.attrib.pop(f"body{i}")], "site", name=site, pos=_numbers(pos))
        connect.set(f"site{i}", site)


def _write_sites(root: ET.Element, env: Environment, state: State) -> None:
    places = {
        f"{kind}{i}": (pos, extent)
        for kind, positions in state.world.sites.items()
        for i, (pos, extent) in enumerate(zip(positions, env.base.sites[kind].extents_of(state.world), strict=True))
        if state.world.active[kind][i]
    }
    for element in root.iter("site"):
        if element.get("name") in places:
            pos, extent = places[str(element.get("name"))]
            element.set("pos", _numbers(pos))
            element.set("size", _numbers(np.asarray(extent) / 2))


def _child(root: ET.Element, tag: str) -> ET.Element:
    found = root.find(tag)
    return ET.SubElement(root, tag) if found is None else found


def _numbers(values: Iterable[Any]) -> str:
    return " ".join(repr(float(v)) for v in values)
