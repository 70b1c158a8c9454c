"""Sight: the ground that a policy has learned to read, and beyond which it is not asked to.

In:  the courses that a policy is trained on.  Out: bounds of its observation.
"""

from agility_ref.observation import OBS_DIM, SCANDOT_MIRROR, SCANDOT_ZERO, SCANDOTS, scandots
from agility_ref.terrain import SPAWN_X
from agility_ref.world import World

import numpy as np

SIGHT_MARGIN = 0.1  # [m] by which a walking trunk bobs, and what noise adds
SIGHT_DEPTH = 0.35  # [m] below the feet; chosen on other courses than the table's (benchmarks/climb_gap.py)


def sight(world: World) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest observation that a robot can make which walks these courses as it should.

    It stands upright anywhere on the line through the waypoints, on the lower or the upper of two
    levels where they meet, and over pits on the level of their banks.  Only the scandots are
    bounded, and by SIGHT_MARGIN more than was seen.

    Ours: the paper does not say what a specialist makes of ground that its own courses do not have.  A
    network is of no use on inputs far from those it was trained on, so a trained policy clips them
    to these bounds: to one that climbs up, a pit looks as the level ground before a step.  Where no
    course has a pit, ground more than SIGHT_DEPTH below the feet looks SIGHT_DEPTH deep: a policy that
    could tell a pit from a step down would balk at a step up with a pit behind it, though it takes one with a step down behind it.

    Parameters
    ----------
    world : the courses that a policy is trained on

    Returns
    -------
    (184,) lowest and (184,) highest, infinite but for the scandots
    """
    low, high = np.full(OBS_DIM, -np.inf, np.float32), np.full(OBS_DIM, np.inf, np.float32)
    views = []
    for course, waypoints in enumerate(world.waypoints):
        x = np.arange(SPAWN_X, waypoints[-1, 0] + 0.5, 0.05)
        on = np.full(len(x), course)
        line = np.column_stack([x, np.interp(x, *waypoints.T)])
        lower = world.support[course, world.column(x)]
        for level in (lower, np.maximum(lower, world.ground(course, line))):
            views.append(scandots(world, on, np.column_stack([line, level + SCANDOT_ZERO]), np.zeros(len(x))))
    seen = np.concatenate(views)
    seen = np.concatenate([seen, SCANDOT_MIRROR(seen)])  # else a policy and its mirror image see differently
    low[SCANDOTS], high[SCANDOTS] = seen.min(axis=0) - SIGHT_MARGIN, seen.max(axis=0) + SIGHT_MARGIN
    if not any(obstacle.skill == "leap" for course in world.courses for obstacle in course.obstacles):
        high[SCANDOTS] = np.minimum(high[SCANDOTS], SIGHT_DEPTH)
    return low, high
