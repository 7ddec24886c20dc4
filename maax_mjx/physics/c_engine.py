"""The engine impl="c": MuJoCo's C engine behind the same jitted, vmapped step, through one call to the host."""

from __future__ import annotations

import os

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from maax_mjx.physics.data import Data
from maax_mjx.physics.engine import Engine
from maax_mjx.physics.fields import Fields, Overlay
from maax_mjx.physics.host_call import host_call, shared
from maax_mjx.physics.host_stepper import ADVANCED, INPUTS, HostStepper, number_of

THREADS_PER_DEVICE = 4


class CEngine(Engine):
    """Steps in float64 on all cores; `Data.engine` holds what float32 drops of the fields that a step advances.

    With it a run follows plain MuJoCo, with dense matrices, step after step. It never exceeds half a unit in the last
    place of the public field that it completes, so those may be changed freely.
    """

    impl = "c"

    def __init__(self, model: mujoco.MjModel, overlay: Overlay):
        super().__init__(model, overlay)
        self._number = number_of(model, overlay)
        self._field_names = sorted(overlay)
        self._stepper = shared(self._number, lambda: HostStepper(model, overlay), self)

    @property
    def host_model(self) -> mujoco.MjModel:
        """The model that is stepped."""
        return self._stepper.model

    def check_devices(self, n_devices: int) -> None:
        # Callbacks of several devices at once take XLA's threads from each other, until none is left to go on.
        threads = int(os.environ.get("NPROC") or os.cpu_count() or 1)
        if n_devices > 1 and threads < THREADS_PER_DEVICE * n_devices:
            raise ValueError(
                f"devices: got {n_devices} with impl='c', which needs {THREADS_PER_DEVICE * n_devices} threads for "
                f"them and has {threads}; takes one device, which uses all cores already, or "
                f"NPROC={THREADS_PER_DEVICE * n_devices} in the environment before JAX starts"
            )

    def carry(self, data: Data) -> jax.Array:
        return jnp.zeros(sum(getattr(data, name).size for name in ADVANCED))

    def renew(self, carried: jax.Array, begins: jax.Array) -> jax.Array:
        return jnp.where(begins, 0.0, carried)

    def exact(self, data: Data) -> dict[str, np.ndarray]:
        rest = np.split(
            np.asarray(self._carried(data), float), np.cumsum([np.size(getattr(data, n)) for n in ADVANCED])[:-1]
        )
        out = super().exact(data)
        return out | {name: out[name] + part for name, part in zip(ADVANCED, rest, strict=True)}

    def step(self, fields: Fields, data: Data, n_frames: int) -> tuple[Data, jax.Array]:
        rest = self._carried(data)
        args = [getattr(data, name) for name in INPUTS] + [fields[name] for name in self._field_names] + [rest]
        like = [getattr(data, name) for name in ADVANCED] + [rest]
        results = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in like] + [jax.ShapeDtypeStruct((), bool)]
        *moved, carried, full = host_call(self._number, n_frames, args, results)
        return data.replace(**dict(zip(ADVANCED, moved, strict=True)), engine=carried), full

    def _carried(self, data: Data) -> jax.Array:
        """What the engine carries; nothing yet in a state that another engine made."""
        return jnp.asarray(data.engine) if isinstance(data.engine, jax.Array | np.ndarray) else self.carry(data)
