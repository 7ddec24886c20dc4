"""Worlds on several devices and in several processes. Copy this and put your own policy and learner in.

python notebooks/multi_device.py                      all devices of this machine (on a CPU, two virtual ones)
python notebooks/multi_device.py --method pmap        the same with jax.pmap
python notebooks/multi_device.py --processes 2        two processes on this machine, as a launcher starts them
python notebooks/multi_device.py --folder run         saves every round; called again, it goes on from the last
srun python notebooks/multi_device.py --distributed   one process per SLURM task; mpirun of Open MPI up to 4 likewise

Anywhere else give every process its rank, the address of the first one and a port that is free there:
python notebooks/multi_device.py --processes 2 --coordinator HOST:PORT --rank 0    and --rank 1 in another shell or host
On a machine with GPUs, --processes 2 --gpus 2 gives every process its own.
"""

import os

# Read when JAX starts. On GPUs the first has no effect; threads are for the callbacks of the CPU's engine.
os.environ.setdefault("XLA_FLAGS", "--xla_force_host_platform_device_count=2")
os.environ.setdefault("NPROC", "8")

import ast
import json
import socket
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from jax.experimental import multihost_utils

import maax_mjx as maax


@dataclass
class Config:
    """Options.

    Attributes:
        env: name of a game.
        overrides: of its config, as NAME=VALUE with a Python literal, such as n_boxes=(0,3).
        impl: physics engine.
        worlds: on all devices together.
        steps: env steps per round.
        rounds: how many rounds.
        method: shard_map or pmap.
        processes: how many to start on this machine.
        gpus: how many GPUs it has, shared equally by the processes; 0 for a CPU.
        distributed: whether a launcher started this process beside others (SLURM, mpirun, a cloud's TPU pod).
        rank: of this process, where no launcher says it.
        coordinator: HOST:PORT of the first process, likewise.
        folder: for checkpoints; none are written without one.
        out: JSON file for what the worlds came to.
    """

    env: str = "hide_and_seek"
    overrides: tuple[str, ...] = ()
    impl: str = "auto"
    worlds: int = 64
    steps: int = 50
    rounds: int = 3
    method: str = "shard_map"
    processes: int = 1
    gpus: int = 0
    distributed: bool = False
    rank: int | None = None
    coordinator: str | None = None
    folder: Path | None = None
    out: Path | None = None


def policy(state: maax.State, key: jax.Array, params: dict[str, jax.Array]) -> dict[str, jax.Array]:
    """One world's action: here, a push that the parameters say, and noise."""
    noise = jax.random.uniform(key, (*state.reward.shape, 3), minval=-1, maxval=1)
    action = {"move": jnp.clip(params["push"] + noise, -1, 1)}
    if "locks" in state.mechanics:
        action["lock"] = jnp.ones((len(state.reward), len(state.mechanics["locks"].locked)), jnp.int8)
    return action


def train(config: Config) -> None:
    """What every process does; all make the same calls in the same order."""
    overrides = {name: ast.literal_eval(value) for name, value in (o.split("=", 1) for o in config.overrides)}
    if config.folder and config.method == "pmap" and jax.process_count() > 1:
        raise ValueError("folder: got one with --method pmap in several processes; takes --method shard_map there")
    env = maax.make(config.env, impl=config.impl, **overrides)
    worlds = maax.Worlds(env, config.worlds, devices="all", method=config.method)
    key, params = jax.random.key(0), {"push": np.zeros(3, np.float32)}
    states, done = worlds.reset(key, stagger=True), 0
    checkpoints = maax.Checkpoints(config.folder) if config.folder else None
    if checkpoints and checkpoints.latest is not None:
        states, others = checkpoints.restore(worlds, params=params)
        done, params = checkpoints.latest, jax.tree.map(np.asarray, others["params"])
    for i in range(done, config.rounds):
        begun = time.perf_counter()
        round_key = jax.random.fold_in(key, i)
        states, kept = worlds.rollout(states, policy, config.steps, params, key=round_key, keep=("reward",))
        # Every process gets the mean over all worlds, wherever they are: here a learner would take its gradients.
        here = np.mean([np.mean(shard.data) for shard in kept["reward"].addressable_shards])
        mean = float(np.mean(multihost_utils.process_allgather(here)))
        params = {"push": params["push"] + np.float32([0.1, 0.0, 0.0])}
        if checkpoints:
            checkpoints.save(i + 1, worlds, states, params=params)
        if jax.process_index() == 0:
            rate = config.worlds * config.steps / (time.perf_counter() - begun)
            print(f"round {i}: {rate:,.0f} env-steps/s, mean reward {mean:+.3f}", flush=True)
    report(config, worlds, states)


def report(config: Config, worlds: maax.Worlds, states: maax.WorldsState) -> None:
    """Says what ran where, and writes where every world's agents ended."""
    qpos = np.asarray(multihost_utils.process_allgather(worlds.flat(states.data.qpos), tiled=True))
    if jax.process_index() == 0:
        print(
            f"{worlds.n_worlds} worlds on {len(worlds.shards.devices)} devices of {jax.process_count()} process(es), "
            f"{worlds.shards.method}, arrays of {worlds.shape}"
        )
        if config.out:
            config.out.write_text(json.dumps({"qpos": qpos.tolist(), "shape": worlds.shape}))


def start_processes(config: Config) -> None:
    """Starts this script `processes` times, with a number each and the address of the first."""
    with socket.socket() as free:
        free.bind(("localhost", 0))
        coordinator = f"localhost:{free.getsockname()[1]}"
    command = [sys.executable, *sys.argv, "--coordinator", coordinator]
    share = config.gpus // config.processes
    children = []
    for rank in range(config.processes):
        gpus = ",".join(str(rank * share + i) for i in range(share))
        env = os.environ | ({"CUDA_VISIBLE_DEVICES": gpus} if gpus else {})
        children.append(subprocess.Popen([*command, "--rank", str(rank)], env=env))
    codes = [child.wait() for child in children]
    if any(codes):
        raise SystemExit(f"processes ended with {codes}")


def main(config: Config) -> None:
    """Runs everything, in the way that the options say."""
    if config.processes > 1 and config.rank is None:
        return start_processes(config)
    if config.rank is not None:
        jax.distributed.initialize(config.coordinator, config.processes, config.rank)
    elif config.distributed:
        jax.distributed.initialize()
    train(config)


if __name__ == "__main__":
    main(tyro.cli(Config))
