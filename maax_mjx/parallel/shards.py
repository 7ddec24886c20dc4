"""Distribution of a batch of worlds over devices, and compilation of functions for it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

from maax_mjx.common.annotated import is_number
from maax_mjx.common.checks import check_choice, is_traced

AXIS = "worlds"
METHODS = ("jit", "pmap", "shard_map")
Devices = int | str | Sequence[jax.Device] | None


class Shards:
    """The devices of a batch and their shares.

    Args:
        n_worlds: number of worlds over all devices of all processes.
        devices: None uses one device, JAX's default; a number the first of `jax.devices()`; "all" all of them, also
            those of other processes; or a list of devices.
        method: "jit" for one device, "pmap" or "shard_map" for any number; None is "jit" for one and "shard_map" for
            several.

    Attributes:
        shape: leading axes of the batch's arrays: (n_worlds,), or with pmap (n_devices, n_worlds / n_devices), with
            this process's devices.

    Raises:
        ValueError: too many devices, unequal numbers of devices per process, a number of worlds that is not a multiple
            of that of devices, or several devices with "jit".
    """

    def __init__(self, n_worlds: int, devices: Devices = None, method: str | None = None):
        self.n_worlds = n_worlds
        self._default = devices is None
        self.devices = _select(devices)
        n = len(self.devices)
        self.method = check_choice("method", method or ("jit" if n == 1 else "shard_map"), METHODS)
        if self.method == "jit" and n > 1:
            raise ValueError(f"method: got 'jit' with {n} devices; takes 'shard_map' or 'pmap' there")
        if n_worlds % n:
            raise ValueError(f"n_worlds: got {n_worlds}; takes a multiple of the number of devices, {n}")
        if n > 1:
            _avoid_crash(self.devices)
        self.per_device = n_worlds // n
        self.n_local = sum(d.process_index == jax.process_index() for d in self.devices)
        self.shape = (self.n_local, self.per_device) if self.method == "pmap" else (n_worlds,)
        if self.method == "shard_map":
            self.mesh = Mesh(np.array(self.devices), (AXIS,), axis_types=(AxisType.Auto,))

    def compile(
        self,
        function: Callable,
        in_axes: tuple[int | None, ...],
        out_axes: int | tuple[int | None, ...] = 0,
        donate: tuple[int, ...] = (),
        options: Mapping[str, Any] | None = None,
    ) -> Callable:
        """Compiles a function of one device's worlds into one of all worlds.

        Args:
            function: `(index, *args)`, where `index` (n,) int32 are the indices of the device's worlds.
            in_axes: for each of `args`, 0 if worlds are its leading axis, None if all devices share it.
            out_axes: axis of the worlds in each result; None where all devices have the same.
            donate: indices of `args` that are donated.
            options: compiler options; pmap takes none.
        """
        index = self.put(np.arange(self.n_worlds, dtype=np.int32))
        donate = tuple(i + 1 for i in donate)
        if self.method == "pmap":
            devices = None if self.devices == tuple(jax.devices()) else self.devices
            axes = (0, *in_axes)
            mapped = jax.pmap(function, AXIS, in_axes=axes, out_axes=out_axes, devices=devices, donate_argnums=donate)
        else:
            if self.method == "shard_map":
                specs = tuple(_spec(axis) for axis in (0, *in_axes))
                outs = tuple(_spec(axis) for axis in out_axes) if isinstance(out_axes, tuple) else _spec(out_axes)
                function = jax.shard_map(function, mesh=self.mesh, in_specs=specs, out_specs=outs, check_vma=False)
            mapped = jax.jit(function, **_reusing(donate))
            if options:
                mapped = _with_options(function, mapped, donate, options)
        return partial(mapped, index)

    def put(self, tree: Any) -> Any:
        """Puts host arrays with the leading axis (n_worlds,), the same in every process, onto the batch's devices."""
        if self.method == "jit":
            return jax.tree.map(lambda x: self.share(jnp.array(x)), tree)
        if self.method == "shard_map":
            sharding = NamedSharding(self.mesh, P(AXIS))
            return jax.tree.map(lambda x: jax.make_array_from_callback(x.shape, sharding, x.__getitem__), tree)
        mine = [i for i, d in enumerate(self.devices) if d.process_index == jax.process_index()]
        return jax.tree.map(lambda x: x.reshape(len(self.devices), self.per_device, *x.shape[1:])[mine], tree)

    def replicate(self, tree: Any) -> Any:
        """Puts arrays that all devices share, the same in every process, where a compiled program leaves its own."""
        if self.method != "shard_map":
            return jax.tree.map(lambda x: self.share(jnp.array(x)), tree)
        everywhere = NamedSharding(self.mesh, P())
        return jax.tree.map(
            lambda x: jax.make_array_from_callback(x.shape, everywhere, np.asarray(x).__getitem__), tree
        )

    def share(self, x: Any) -> Any:
        """Puts a host array or key, the same in every process, where all devices can read it."""
        if self.method == "jit":
            return x if self._default else jax.device_put(x, self.devices[0])
        if self.method == "pmap" or jax.process_count() == 1:
            return x
        if jnp.issubdtype(x.dtype, jax.dtypes.prng_key):
            return jax.random.wrap_key_data(self.share(jax.random.key_data(x)), impl=jax.random.key_impl(x))
        host = np.asarray(x)
        return jax.make_array_from_callback(host.shape, NamedSharding(self.mesh, P()), host.__getitem__)

    def on_host(self, tree: Any) -> Any:
        """Copies this process's worlds of a batch's arrays to the host, with the leading axis (n,)."""

        def rows(x: jax.Array) -> np.ndarray:
            parts = [np.asarray(shard.data) for shard in x.addressable_shards]
            return np.concatenate([part.reshape(-1, *x.shape[len(self.shape) :]) for part in parts])

        return jax.tree.map(rows, tree)


def _avoid_crash(devices: Sequence[jax.Device]) -> None:
    """Chooses the older partitioner where jaxlib 0.11's crashes, on several devices of a CPU (`docs/upstream`)."""
    if jax.__version_info__[:2] == (0, 11) and devices[0].platform == "cpu":
        jax.config.update("jax_use_shardy_partitioner", False)


def _reusing(donate: tuple[int, ...]) -> dict[str, Any]:
    """Arguments of `jax.jit` for a program that reuses the memory of some arguments.

    Arrays that it does not read are kept among them: JAX gives an output the memory of the next argument of its shape,
    which is the array that it replaces only where none is missing. Else most of a batch's state was copied every step.
    """
    return {"donate_argnums": donate, "keep_unused": bool(donate)}


def _with_options(function: Callable, plain: Callable, donate: tuple[int, ...], options: Mapping[str, Any]) -> Callable:
    """Returns the function compiled with options; inside other compiled code, where JAX allows none, the plain one."""
    quick = jax.jit(function, **_reusing(donate), compiler_options=dict(options))
    return lambda *args: (plain if is_traced(args) else quick)(*args)


def _spec(axis: int | None) -> P:
    return P() if axis is None else P(*[None] * axis, AXIS)


def _select(devices: Any) -> tuple[jax.Device, ...]:
    """Returns the devices that the argument names."""
    if devices is None:
        # Not simply the first of `jax.devices()`: users can set another with `jax.default_device`.
        return tuple(jnp.zeros(()).devices())
    present = jax.devices()
    if isinstance(devices, str) and devices == "all":
        return tuple(present)
    several = isinstance(devices, Iterable)
    if not several and (not is_number(devices, int) or not 1 <= devices <= len(present)):
        raise ValueError(
            f"devices: got {devices!r}; takes None, 'all', or a number from 1 to {len(present)}, as JAX has "
            f"{len(present)} ({present[0].device_kind})"
        )
    chosen = tuple(devices if several else present[: int(devices)])
    if not chosen or not all(isinstance(d, jax.Device) for d in chosen) or len(set(chosen)) < len(chosen):
        raise ValueError(f"devices: got {devices!r}; takes None, 'all', a number, or a list of different jax.Device")
    shares = np.bincount([d.process_index for d in chosen], minlength=jax.process_count())
    if len(chosen) > 1 and (shares != shares[0]).any():
        raise ValueError(
            f"devices: got {[int(n) for n in shares]} devices of the {len(shares)} processes; takes as many of each, "
            "such as 'all'"
        )
    return chosen
