"""Firmness of an agent's hold on what it carries, by the way it holds.

Plain MuJoCo on an exported world: an agent carries a box under full force through an arena of four walls. The project's
own way (`GrabObjects`) is a connect to the box's centre and a joint equality of the two yaws. Beside it are a weld, the
same with MuJoCo's default softness, and a spring-damper that pushes agent and box by `xfrc_applied`. All begin alike,
and the agent's forces are the same.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import jax
import mujoco
import numpy as np

import maax_mjx as maax
from maax_mjx.benchmarks.bench import Options, benchmark
from maax_mjx.benchmarks.record import Measured
from maax_mjx.common.annotated import Count, PositiveCount
from maax_mjx.common.checks import check_positive
from maax_mjx.common.progress import progress
from maax_mjx.core.env import Base
from maax_mjx.wrappers.equalities import add_equality
from maax_mjx.wrappers.grabs.slots import GrabSlots

AGENT, BOX = "agent0", "box0"
PLACE = np.array([0.45, -0.05])
"""Metres from the agent to the box, in the agent's frame: 0.2 m from its centre to the box's face."""
LOST = 0.5
"""Metres off its place, from which on a box counts as lost."""
CONNECT, WELD, SOFT_WELD, SPRING = "connect + yaw joint", "weld", "weld, MuJoCo's defaults", "spring-damper"


@dataclass
class Config(Options):
    """Options.

    Attributes:
        steps: physics steps of 5 ms per method.
        held: for how many steps a force is held.
        stiffness: of the spring-dampers, in N/m.
        damping: of the spring-dampers, in N s/m; of 10 to 130, 15 stayed stable up to the largest stiffness.
        frames: for how many physics steps a spring-damper's force stays as it is; a wrapper sets it once per env step,
            which has one physics step in `hide_and_seek`, and 15 in `hide_and_seek_full`.
        seed: of the forces.
    """

    steps: PositiveCount = 20_000
    held: PositiveCount = 20
    stiffness: tuple[float, ...] = (1000.0, 2000.0, 5000.0, 10_000.0, 15_000.0)
    damping: float = 15.0
    frames: tuple[PositiveCount, ...] = (1, 15)
    seed: Count = 0

    def check(self) -> None:
        super().check()
        check_positive("damping", self.damping)
        for stiffness in self.stiffness:
            check_positive("stiffness", stiffness)


@dataclass(frozen=True)
class Case:
    """One way to hold; stiffness and frames are those of a spring-damper, in N/m and physics steps."""

    method: str
    stiffness: float | None
    frames: int | None


@dataclass(frozen=True)
class Row(Case, Measured):
    """A case.

    Attributes:
        rows_per_pair: constraint rows of an agent that holds an object.
        median_mm: how far the box is from its place at the agent's side, over all steps; None where it was lost.
        p99_mm: the same, in one step of a hundred.
        p99_degrees: how far it is turned, in one step of a hundred.
        stable: whether it was never lost.
        us_per_step: median of `mj_step` alone; what a spring-damper takes to compute its force is not in it.
        steps: physics steps until it was lost, or all.
    """

    rows_per_pair: int
    median_mm: float | None
    p99_mm: float | None
    p99_degrees: float | None
    stable: bool
    us_per_step: float
    steps: int


class Carrier:
    """An agent beside a box that it holds."""

    def __init__(self, env: Base, file: str, method: str):
        spec = mujoco.MjSpec.from_string(file)
        if method == CONNECT:
            GrabSlots(env.agents, env.objects(["box"])).spec_step(spec)
        if method in (WELD, SOFT_WELD):
            add_equality(spec, WELD, mujoco.mjtEq.mjEQ_WELD, AGENT, BOX)
        if method == SOFT_WELD:
            default = mujoco.MjSpec().add_equality()
            spec.equality(WELD).solref, spec.equality(WELD).solimp = default.solref, default.solimp
        self.model = spec.compile()
        # MuJoCo would put back a world that diverges, and so hide it.
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self.data = mujoco.MjData(self.model)
        mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        self.agent, self.box = self.model.body(AGENT).id, self.model.body(BOX).id
        for name, xy in ((AGENT, 3.0 - PLACE), (BOX, np.full(2, 3.0))):
            for axis, value in zip(("x", "y", "yaw"), (*xy, 0.0), strict=True):
                self.data.joint(f"{name}:{axis}").qpos[0] = value
        mujoco.mj_kinematics(self.model, self.data)
        self.place = self.data.xpos[self.box] - self.data.xpos[self.agent]
        for equality in range(self.model.neq):
            self._aim(equality)
        mujoco.mj_forward(self.model, self.data)

    def _aim(self, equality: int) -> None:
        """Aims an equality at the pose of now and switches it on, as `GrabSlots.hold` does."""
        data, kind = self.model.eq_data[equality], self.model.eq_type[equality]
        data[:] = 0.0
        if kind == mujoco.mjtEq.mjEQ_CONNECT:
            data[:3] = self.place
        elif kind == mujoco.mjtEq.mjEQ_WELD:
            data[3:6], data[6], data[10] = self.place, 1.0, 1.0
        else:
            data[1] = 1.0
        self.data.eq_active[equality] = True

    def offset(self) -> tuple[float, float]:
        """Metres and radians by which the box is off its place at the agent's side."""
        away, turned = self._away()
        return float(np.linalg.norm(away)), abs(turned)

    def _away(self) -> tuple[np.ndarray, float]:
        """Way from where the box is to where it should be, in the world's frame, and the angle."""
        turn = self.data.xmat[self.agent].reshape(3, 3)
        yaw = self.data.joint(f"{AGENT}:yaw").qpos[0] - self.data.joint(f"{BOX}:yaw").qpos[0]
        return self.data.xpos[self.agent] + turn @ self.place - self.data.xpos[self.box], float(yaw)

    def pull(self, stiffness: float, damping: float) -> None:
        """Sets the forces of a spring-damper, which act on the agent through its arm.

        It turns the box as much as it moves it: for its torque, both numbers are times its radius of gyration squared.
        """
        data, model = self.data, self.model
        radius2 = model.body_inertia[self.box, 2] / model.body_mass[self.box]
        away, yaw = self._away()
        arm = data.xpos[self.box] - data.xpos[self.agent]
        speed, turning = np.zeros(3), 0.0
        for name, sign in ((AGENT, 1.0), (BOX, -1.0)):
            speed += sign * np.array([data.joint(f"{name}:{axis}").qvel[0] for axis in "xyz"])
            turning += sign * float(data.joint(f"{name}:yaw").qvel[0])
        speed += np.cross([0.0, 0.0, data.joint(f"{AGENT}:yaw").qvel[0]], arm)
        force = stiffness * away + damping * speed
        torque = np.array([0.0, 0.0, radius2 * (stiffness * yaw + damping * turning)])
        data.xfrc_applied[self.box] = [*force, *torque]
        data.xfrc_applied[self.agent] = [*-force, *(-torque - np.cross(arm, force))]


@cache
def world() -> tuple[Base, str]:
    """An arena with an agent and a box, and its file."""
    env = maax.Base(1, impl="c")
    env.add_module(maax.WallScenarios("empty"))
    env.add_module(maax.Agents(1))
    env.add_module(maax.Boxes(1))
    return env, maax.to_mjcf(env, jax.jit(env.reset)(jax.random.key(0)))


def cases(config: Config) -> Iterator[Case]:
    """Ways to hold, the spring-dampers last."""
    yield from (Case(method, None, None) for method in (CONNECT, WELD, SOFT_WELD))
    yield from (Case(SPRING, stiffness, frames) for frames in config.frames for stiffness in config.stiffness)


def measure(case: Case, config: Config) -> Row:
    """Carries the box about, until it is lost."""
    carrier = Carrier(*world(), case.method)
    model, data = carrier.model, carrier.data
    rows = int(data.ne)
    forces = np.random.default_rng(config.seed).choice([-1.0, 1.0], (-(-config.steps // config.held), 2))
    motors = [model.actuator(f"{AGENT}:{axis}").id for axis in "xy"]
    offsets, spent = [], []
    for i in progress(range(config.steps), desc=case.method, unit="step", leave=False):
        data.ctrl[motors] = forces[i // config.held]
        if case.stiffness is not None and case.frames is not None and i % case.frames == 0:
            carrier.pull(case.stiffness, config.damping)
        begun = time.perf_counter()
        mujoco.mj_step(model, data)
        spent.append(time.perf_counter() - begun)
        mujoco.mj_kinematics(model, data)
        offsets.append(carrier.offset())
        if not offsets[-1][0] < LOST:
            break
    stable = bool(offsets[-1][0] < LOST)
    away, turned = np.array(offsets).T
    return Row(
        **vars(case),
        rows_per_pair=rows,
        median_mm=round(float(np.median(away)) * 1e3, 1) if stable else None,
        p99_mm=round(float(np.quantile(away, 0.99)) * 1e3, 1) if stable else None,
        p99_degrees=round(float(np.degrees(np.quantile(turned, 0.99))), 1) if stable else None,
        stable=stable,
        us_per_step=round(statistics.median(spent) * 1e6, 2),
        steps=len(offsets),
    )


HEADER = "method                     N/m frames  rows  median mm   99 % mm  99 % deg  stable  us/step   steps"


def line(row: Row) -> str:
    """A row of the table."""
    numbers = [f"{x:9.1f}" if x is not None else f"{'-':>9}" for x in (row.median_mm, row.p99_mm, row.p99_degrees)]
    return (
        f"{row.method:24} {row.stiffness or 0:5.0f} {row.frames or 0:6} {row.rows_per_pair:5} {' '.join(numbers)} "
        f"{row.stable!s:>7} {row.us_per_step:8.2f} {row.steps:7}"
    )


COMMAND = benchmark(Config, Row, cases, measure, line, HEADER)

if __name__ == "__main__":
    COMMAND.cli()
