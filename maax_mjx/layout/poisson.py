"""Poisson-disc sampling on the host: many points on a floor, none of them close to another (thesis 4.2.1, Algorithm 2).

On the device, where every world draws its own layout, `separation_placement` keeps objects apart; this is for what is
scattered once, when a model is built.
"""

from __future__ import annotations

import numpy as np

from maax_mjx.common.checks import check_count, check_positive

CANDIDATES = 30
MAX_ACROSS = 1000
ROUNDING = 1e-6


def poisson_disc(
    n: int | None,
    radius: float,
    floor_size: float,
    seed: int,
    margin: float = 0.0,
    candidates: int = CANDIDATES,
) -> np.ndarray:
    """Scatters points over a square floor by Bridson's algorithm, as `scipy.stats.qmc.PoissonDisk` has it.

    The floor is always filled, in time linear in the points that it holds, and the points are drawn from those: the
    algorithm grows outwards from its first point, so that stopping it early would leave one dense patch.

    Args:
        n: how many points; None is as many as the filled floor has.
        radius: least distance between any two in metres.
        floor_size: edge of the floor in metres; at most 1,000 radii, margins left out.
        seed: the same one gives the same points.
        margin: how far from the floor's edges they keep, in metres; an object's half extent keeps it on the floor.
        candidates: neighbours tried around a point before it is given up, Bridson's k.

    Returns:
        (k, 2) x, y in [margin, floor_size - margin] metres, in random order; k < n where the filled floor has no more.

    Raises:
        ValueError: an argument out of its range; the message names it.

    References:
        R. Bridson, "Fast Poisson Disk Sampling in Arbitrary Dimensions", SIGGRAPH sketches, 2007.
    """
    if n is not None:
        check_count("n", n)
    radius = check_positive("radius", radius)
    floor_size = check_positive("floor_size", floor_size)
    if not isinstance(margin, int | float | np.number) or isinstance(margin, bool) or not 0 <= margin < floor_size / 2:
        raise ValueError(f"margin: got {margin!r}; takes a number of at least 0, below {floor_size / 2:g}")
    seed = check_count("seed", seed)
    candidates = check_count("candidates", candidates, minimum=1)
    span = floor_size - 2 * float(margin)
    if span > MAX_ACROSS * radius:
        raise ValueError(f"radius: got {radius}; takes at least {span / MAX_ACROSS:g} on this floor")
    # Imported here: it takes most of a second, which `import maax_mjx` is spared.
    from scipy.stats.qmc import PoissonDisk

    rng = np.random.default_rng(seed)
    # In the unit square: before SciPy 1.15 there is no other, and the first that had others broke the distance in them
    # (scipy/scipy#22819). SciPy keeps neighbours in float32, for whose rounding the radius makes room.
    disk = PoissonDisk(2, radius=radius / span + ROUNDING, ncandidates=candidates, seed=rng)
    points = rng.permutation(disk.fill_space())[:n]
    return np.clip(margin + span * points, margin, floor_size - margin)
