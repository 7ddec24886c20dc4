"""A NumPy oracle of the transfer tasks, written from a description of the published code, without looking at ours."""

import math

import numpy as np

KINDS = ("all", "order", "all-return", "order-return")


def _distance(a, b):
    """The Euclidean distance between two points of equal dimension, by explicit summation."""
    total = 0.0
    for x, y in zip(a, b, strict=True):
        total += (float(x) - float(y)) ** 2
    return math.sqrt(total)


def _target(kind, agent, boxes, locked):
    """The target (None if every box is locked) and its distance (0 for none): item 2."""
    unlocked = []
    for box in range(len(boxes)):
        if not locked[box]:
            unlocked.append(box)
    if not unlocked:
        return None, 0.0
    chosen = unlocked[0]
    if kind in ("all", "all-return"):
        for box in unlocked:
            # Ambiguous: ties of distance. Taken: the first in the order (strict comparison).
            if _distance(agent, boxes[box]) < _distance(agent, boxes[chosen]):
                chosen = box
    return chosen, _distance(agent, boxes[chosen])


def lock_rewards(kind, agent, boxes, locked, lock=5.0, unlock=5.0, shaped=0.5, success=1.0, threshold=0.1):
    """Rewards (T,) of the lock family; arrays of T + 1 rows, row 0 is the reset, reward t is of t to t + 1."""
    if kind not in KINDS:
        raise ValueError(f"unknown kind {kind!r}")
    agent = np.asarray(agent, dtype=np.float64)
    boxes = np.asarray(boxes, dtype=np.float64)
    locked = np.asarray(locked, dtype=bool)
    returns = kind in ("all-return", "order-return")
    steps = len(agent) - 1
    count = boxes.shape[1]

    spawn = agent[0]
    # The description says that nothing is locked at reset. If row 0 has locked boxes all the same, they are taken as
    # they are: they cannot be the first target, and staying locked pays nothing in item 1.
    old, old_distance = _target(kind, agent[0], boxes[0], locked[0])
    old_spawn_distance = 0.0

    rewards = np.zeros(steps)
    for t in range(steps):
        now = t + 1
        reward = 0.0

        # Item 1: boxes that became locked or unlocked.
        for box in range(count):
            if locked[now, box] and not locked[t, box]:
                reward += lock
            if locked[t, box] and not locked[now, box]:
                reward -= unlock

        # Item 2: the new target, and the new distance to the spawn.
        new, new_distance = _target(kind, agent[now], boxes[now], locked[now])
        new_spawn_distance = _distance(agent[now], spawn)

        # Item 3: shaped.
        if old is not None and new is not None and old == new:
            reward += shaped * (old_distance - new_distance)
        elif old is not None:
            if locked[now, old]:
                # Literal: only s d_p, also if another target follows (no - s d_q) or if none does (no return term).
                reward += shaped * old_distance
            else:
                # The description explains this case by "an earlier one came open". In the "all" kinds it is also
                # reached when another unlocked box has become the nearest. Literal: - s d_q there too.
                reward -= shaped * new_distance
        elif new is not None:
            # Literal: no return term here, although the agent moved relative to the spawn.
            reward -= shaped * new_distance
        elif returns:
            reward += shaped * (old_spawn_distance - new_spawn_distance)

        # Item 4: success, in every step, the threshold included.
        if new is None and (not returns or new_spawn_distance <= threshold):
            reward += success

        # Item 5: remember; there is no early end. d_spawn is remembered also while boxes are unlocked.
        old, old_distance, old_spawn_distance = new, new_distance, new_spawn_distance
        rewards[t] = reward
    return rewards


def order_rule(locked, lock_action):
    """The lock action (B,) after the "order" edit; `locked` (B,) is that before the step."""
    edited = np.array(lock_action, copy=True)
    unlocked = []
    for box in range(len(edited)):
        if not locked[box]:
            unlocked.append(box)
    if len(unlocked) > 1:
        for box in unlocked[1:]:
            edited[box] = 0
    # Locked boxes keep their action: the description edits unlocked ones only.
    return edited


def blueprint_dense(box_corners, site_corners, alpha=-1.5, scale=0.05):
    """The dense reward: minus scale times the mean over site corners of smooth minima over box corners."""
    boxes = np.asarray(box_corners, dtype=np.float64).reshape(-1, 3)
    sites = np.asarray(site_corners, dtype=np.float64).reshape(-1, 3)
    total = 0.0
    for site in sites:
        numerator = 0.0
        denominator = 0.0
        for box in boxes:
            distance = _distance(box, site)
            weight = math.exp(alpha * distance)
            numerator += distance * weight
            denominator += weight
        total += numerator / denominator
    # The mean is over the corners of sites that exist, not over the padded 16.
    return -scale * total / len(sites)


def blueprint_done(box_centres, box_corners, site_centres, site_corners, radius=0.1):
    """Whether every site's centre and every site corner has a box centre or box corner nearer than radius (3-D)."""
    pairs = (
        (np.reshape(site_centres, (-1, 3)), np.reshape(box_centres, (-1, 3))),
        (np.reshape(site_corners, (-1, 3)), np.reshape(box_corners, (-1, 3))),
    )
    # Literal: the corners of a site may be met by different boxes, and a box may serve several sites or corners.
    for sites, boxes in pairs:
        for site in sites:
            met = False
            for box in boxes:
                # "nearer than": strict.
                if _distance(box, site) < radius:
                    met = True
            if not met:
                return False
    return True


def blueprint_completed(n_sites, scale=3.0):
    """The reward of completion, for the number of sites of this episode."""
    return float(scale * n_sites)


def shelter_starts(n=25, floor=6.0, cells=30):
    """The (4 n, 3) start points of the rays: for i = 0 to n - 1, the four points of the text, in its order."""
    inset = 1.01 * floor / cells
    lo = inset
    hi = floor - inset
    points = []
    # Ambiguous: the order of the points (i outside, sides inside, here); it does not matter to the reward.
    for i in range(n):
        offset = i / n * (hi - lo)
        points.append((lo + offset, lo, 0.0))
        points.append((hi, lo + offset, 0.0))
        points.append((hi - offset, hi, 0.0))
        points.append((lo, hi - offset, 0.0))
    return np.array(points)


def shelter_reward(first_hit_is_cylinder):
    """The reward: -0.001 per ray whose first hit is the cylinder (not scaled by the number of rays)."""
    count = 0
    for hit in np.asarray(first_hit_is_cylinder, dtype=bool).ravel():
        if hit:
            count += 1
    return -0.001 * count


def middle_cells(f, s, grid=30):
    """The lowest and highest lowest cell that uniform_placement_middle(f) can draw for s cells, both included."""
    # "drawn from A to B - 1" is read with both ends included, as the examples of the text ("2 to 23") are.
    # The int() truncates floats: f = 0.7, s = 8 lies on integers (4.0 and 18.0), so the order of operations counts.
    # Taken: that of the text, from left to right.
    lowest = int((grid - s) * (1 - f) / 2 + f)
    highest = int((grid - s) * (1 + f) / 2 - f) - 1
    return lowest, highest
