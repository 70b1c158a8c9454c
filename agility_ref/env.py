"""Go1Env: N robots on one World, stepped together by ``mujoco.batch``.

Paper sections 3.1 and 4.1, and the Extreme Parkour code base; docs/differences.md has its
values beside ours.  :class:`EnvConfig` holds everything about an episode but the courses, as
numbers that a reader may change; the docstring of :class:`Go1Env` is the manual.

In:  a :class:`~agility_ref.world.World` and, each step, N actions.
Out: observation, reward, terminated, truncated, info.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

from agility_ref.errors import UserError, require_at_least
from agility_ref.go1 import BODY_TOUCH, DEFAULT_DOF_POS, FOOT_RADIUS, FOOT_TOUCH, FOOT_VELOCITY, PhysicsConfig
from agility_ref.observation import NOISE, NUM_SCANDOTS, SCANDOTS, rotation, scandots, wrap
from agility_ref.rewards import RewardConfig, StepState, compute_reward
from agility_ref.simulation import Simulation
from agility_ref.terrain import BEAM_DROP, LANE_WIDTH, NUM_WAYPOINTS, SPAWN_X
from agility_ref.world import EDGE_DISTANCE, World

import numpy as np


@dataclass(frozen=True)
class EnvConfig:
    """Everything about the task but the courses."""

    physics: PhysicsConfig = PhysicsConfig()  # simulator and joint controller
    rewards: RewardConfig = RewardConfig()  # weights of the reward terms
    action_scale: float = 0.3  # joint offset per unit of action [rad]; usual 0.25 to 0.5
    action_limit: float = 4.0  # actions are clipped to +- this; 4 x 0.3 = 1.2 rad, the original's limit
    action_repeat: int = 2  # control steps that share an action; the paper found its "action stacking" to hurt; 1 to 5
    episode_seconds: float = 20.0  # an episode is truncated after this time [s]
    command_low: float = 0.7  # lowest commanded speed [m/s]; at the original's 0.3 time is up before the course ends
    command_high: float = 1.0  # highest commanded speed [m/s]; original 0.8
    waypoint_radius: float = 0.2  # a waypoint counts while the trunk's xy is within this distance [m]
    waypoint_seconds: float = 0.1  # ... and is reached after staying there for this long [s], rounded to 2 steps
    max_tilt: float = 1.4  # angle between trunk and vertical beyond which a robot has tipped over [rad]
    fall_clearance: float = 0.05  # a trunk that is less than this above the ground it should walk over has fallen [m]
    start_noise: float = 0.1  # starts differ by this in position [m], yaw and joints [rad]; usual 0.05 to 0.2
    noise: float = 1.0  # scale of the observation noise; 0 turns it off
    scandot_period: int = 1  # actions between two looks at the ground; 1 is 25 Hz, the original has 10 Hz
    push_interval: float = 6.0  # seconds between pushes; 0 turns them off; original: 8 in training, 6 in evaluation
    push_velocity: float = 0.5  # a push sets the horizontal velocity to a draw from +- this [m/s]
    friction_low: float = 0.6  # lowest ground friction, drawn per course; original 0.6
    friction_high: float = 1.2  # highest ground friction; original 2.0
    payload_high: float = 2.0  # highest mass added to the trunk [kg], drawn per course; original 3
    turned_start_share: float = 0.0  # share of episodes that start facing anywhere; training only, 0 to 0.5
    stall_seconds: float = 0.0  # terminate after this time without a waypoint [s]; training only, 0 for never

    def __post_init__(self):
        require_at_least(1, action_repeat=self.action_repeat, scandot_period=self.scandot_period)
        require_at_least(1e-4, episode_seconds=self.episode_seconds, command_low=self.command_low)
        require_at_least(0, 1e6, **{k: v for k, v in vars(self).items() if isinstance(v, int | float)})
        require_at_least(self.command_low, command_high=self.command_high)
        require_at_least(self.friction_low, friction_high=self.friction_high)

    @property
    def dt(self) -> float:
        """Time between two actions [s]."""
        return self.physics.timestep * self.physics.substeps * self.action_repeat

    def clean(self) -> "EnvConfig":
        """Return the same task without noise, pushes and payload, at friction 1."""
        return replace(self, noise=0.0, push_interval=0.0, payload_high=0.0, friction_low=1.0, friction_high=1.0)


# Training differs from evaluation in two numbers.  A robot that runs past a waypoint must turn
# back, which it meets too rarely to learn; and one that stands before an obstacle for the rest
# of 20 s fills the batch with nothing.
TRAINING = EnvConfig(turned_start_share=0.1, stall_seconds=5.0)
ACTION_DIM = 12
NextCourse = Callable[[np.ndarray, np.ndarray | None], np.ndarray]


class Go1Env:
    """N Unitree Go1s on the courses of a World.

    **Action** (N, 12): joint position targets as offsets from the home pose, in units of
    ``action_scale``; legs FR, FL, RR, RL, joints hip, thigh, calf.  MuJoCo position
    actuators apply kp, kd and the torque limits.  Control runs at the paper's
    50 Hz, and ``action_repeat`` steps of it share an action: 25 actions per second.

    **Observation** (N, 184) float32, see OBSERVATION for the order and the noise:

    ===================  ====  ===================================================
    base_lin_vel            3  trunk velocity, trunk frame [m/s] (privileged)
    base_ang_vel            3  trunk angular velocity, trunk frame [rad/s]
    projected_gravity       3  unit gravity vector, trunk frame
    heading_error           2  angle to this and to the next waypoint [rad]
    command                 1  commanded speed [m/s]
    dof_pos                12  joint angles minus the home pose [rad]
    dof_vel                12  joint velocities [rad/s]
    last_action            12  previous action
    foot_contact            4  1 where a foot touches the ground
    scandots              132  clip(trunk z - 0.3 - ground height, +-1) [m] at 12 x 11
                               points 0.15 m apart, x -0.45..1.20, y +-0.75, turned
                               with the yaw, x-major; means over 0.14 m x 0.14 m,
                               taken anew every ``scandot_period`` steps
    ===================  ====  ===================================================

    **Reward**: :mod:`agility_ref.rewards`.
    **Start**: x = 1 m on the level platform, home pose, facing +x (in training, now and then
    anywhere); position, yaw and joints are perturbed a little, and a new command is drawn.
    **Disturbances**: a push every ``push_interval`` seconds; friction and payload per course.
    **Terminated**: tipped over (tilt above ``max_tilt``), left the lane, trunk less than
    ``fall_clearance`` above the surface that should carry it, over a beam's span no foot at the
    beam's height, in training ``stall_seconds`` without a waypoint, or the simulation failed.
    **Truncated**: 20 s, or the last waypoint reached.

    **Info**: ``reward_terms``, each (N,); ``final_obs`` (N, 184), of a robot that is done its true
    last observation, with the scandots last taken, of any other the one returned; ``totals``, for every robot
    the running ``reward``, ``length`` in steps, ``waypoints`` and ``edge`` sums *before* the reset, to be read
    where it is done; ``feet_on_edge`` (N,), feet that violate an edge in this step; ``kind`` (N,),
    number of the kind of course.
    **Autoreset**: Gymnasium's SAME_STEP, or DISABLED with ``autoreset=False``.

    Foot positions and contacts are those at the start of the last physics step, 10 ms
    before the state in the observation, as MuJoCo leaves them after ``mj_step``.
    """

    def __init__(
        self, world: World, num_envs: int, config: EnvConfig = EnvConfig(), next_course: NextCourse | None = None,
        seed: int = 0, num_threads: int = 0, autoreset: bool = True,
    ):  # fmt: skip
        """Compile one model per course and start N = ``num_envs`` simulations.

        Parameters
        ----------
        world, config : the courses and the task
        next_course : called with (robots, waypoint fractions or None), returns their next
            courses; by default courses are drawn uniformly
        seed : of friction and payload per course, and of everything drawn later
        num_threads : simulation threads, 0 for all cores; results do not depend on it
        autoreset : False leaves robots that are done as they are until :meth:`reset`
        """
        self.world, self.num_envs, self.config = world, num_envs, config
        self.next_course = next_course or (lambda ids, fraction: self.rng.integers(0, len(world), len(ids)))
        self.autoreset = autoreset
        self.max_steps = round(config.episode_seconds / config.dt)
        self._reach_steps = max(1, round(config.waypoint_seconds / config.dt))
        self._stall_steps = round(config.stall_seconds / config.dt)
        self._push_steps = round(config.push_interval / config.dt)
        self._kind = np.unique(world.kinds, return_inverse=True)[1]
        self._level_course = world.kinds == "walk"
        last = world.waypoints[:, -1:]
        self._waypoints = np.concatenate([world.waypoints, last, last], axis=1)  # the last one stays the goal

        model_rng = np.random.default_rng([seed, 1])
        conditions = [
            (model_rng.uniform(config.friction_low, config.friction_high), model_rng.uniform(0.0, config.payload_high))
            for _ in world.courses
        ]
        self.simulation = Simulation(world.courses, num_envs, config.physics, conditions, num_threads)
        self._qpos, self._qvel = self.simulation.qpos, self.simulation.qvel
        self._sensors = [self.simulation.columns(names) for names in (FOOT_TOUCH, FOOT_VELOCITY, BODY_TOUCH)]

        n, self._everyone = num_envs, np.arange(num_envs)
        self.course, self.waypoint_index = np.zeros(n, int), np.zeros(n, int)
        self.command = np.ones(n)
        self.base_lin_vel, self.projected_gravity = np.zeros((2, n, 3))  # in the trunk's frame [m/s]
        self.yaw = np.zeros(n)  # [rad]
        self.goal = np.zeros((n, 2))  # from the trunk to the current waypoint [m]
        self.heading_error = np.zeros((n, 2))  # to the current and the next waypoint [rad]
        self.foot_contact, self.foot_on_edge = np.zeros((2, n, 4), bool)
        self._reach_timer, self._step_count = np.zeros((2, n), int)
        self._reach_step = np.zeros(n, int)  # step count at the last waypoint
        self.push_timer = np.zeros(n, int)  # steps until the next push, 1 before the step that it strikes in
        self._last_action = np.zeros((n, ACTION_DIM))
        self._scandots = np.zeros((n, NUM_SCANDOTS), np.float32)
        self._clock = np.array(0)  # actions since the environment was made
        self._episode_reward, self._episode_edge = np.zeros(n), np.zeros(n)
        self.reset(seed)

    def reset(self, seed: int | None = None, mask: np.ndarray | None = None) -> tuple[np.ndarray, dict]:
        """Start new episodes; return the observation and an empty info.

        Parameters
        ----------
        seed : of everything drawn from here on, in the order of the steps
        mask : (N,) bool, the robots whose episodes have ended and that start anew, all by default;
            the others stay where they are
        """
        if seed is not None:
            # Noise and pushes have a stream of their own, drawn for all robots at once: two
            # policies that are evaluated with one seed meet the same starts, noise and pushes.
            self.rng, self._disturbance_rng = (np.random.default_rng([seed, k]) for k in (2, 3))
            self._clock[()] = 0
        ids = self._everyone if mask is None else np.flatnonzero(mask)
        self._reset(ids, None if mask is None else self.waypoint_index[ids] / NUM_WAYPOINTS)
        self._look(ids)
        self.observation = self._observe(slice(None), self._draw_disturbance()[:, 2:])
        return self.observation, {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict]:
        """Advance every robot by one step, which is ``action_repeat`` control steps.

        Raises
        ------
        ValueError : action of the wrong shape
        UserError : action that is not finite
        """
        action = np.asarray(action, np.float64)
        if action.shape != (self.num_envs, ACTION_DIM):
            raise ValueError(f"action has shape {action.shape}, not {(self.num_envs, ACTION_DIM)}")
        if not np.isfinite(action).all():
            raise UserError(f"action has {np.count_nonzero(~np.isfinite(action))} entries that are not finite")
        c = self.config
        action = np.clip(action, -c.action_limit, c.action_limit)
        disturbance = self._draw_disturbance()
        self._push(disturbance[:, :2])
        # q_target = q_home + scale * action
        self.simulation.ctrl[:] = DEFAULT_DOF_POS + c.action_scale * action
        last_dof_vel = self._qvel[:, 6:].copy()
        failed = self.simulation.step(c.physics.substeps * c.action_repeat)

        state = self._step_state(action, last_dof_vel)
        reward, terms = compute_reward(state, c.rewards)
        if failed.any():  # what a diverged simulation was worth is nobody's reward
            reward[failed] = 0.0
            for term in terms.values():
                term[failed] = 0.0
        self._last_action = action
        self._step_count += 1
        self._advance_waypoints()
        finished = self.waypoint_index >= NUM_WAYPOINTS
        terminated = self._fallen() | failed
        if self._stall_steps:
            terminated |= self._step_count - self._reach_step >= self._stall_steps
        terminated &= ~finished
        truncated = ~terminated & (finished | (self._step_count >= self.max_steps))

        self._episode_reward += reward
        feet_on_edge = state.foot_on_edge.sum(axis=1)
        self._episode_edge += feet_on_edge
        totals = {
            "reward": self._episode_reward.copy(), "length": self._step_count.copy(),
            "waypoints": self.waypoint_index.copy(), "edge": self._episode_edge.copy(),
        }  # fmt: skip
        noise, kind = disturbance[:, 2:], self._kind[self.course]
        done = np.flatnonzero(terminated | truncated) if self.autoreset else self._everyone[:0]
        if len(done):
            last_observation = self._observe(done, noise)
            self._reset(done, self.waypoint_index[done] / NUM_WAYPOINTS)
        self._clock += 1
        due = (self._everyone + self._clock) % c.scandot_period == 0
        due[done] = True
        self._look(np.flatnonzero(due))
        self.observation = observation = self._observe(slice(None), noise)
        final_obs = observation.copy()
        if len(done):
            final_obs[done] = last_observation
        info = {"final_obs": final_obs, "totals": totals, "reward_terms": terms, "feet_on_edge": feet_on_edge}
        return observation, reward, terminated, truncated, info | {"kind": kind}

    @property
    def base_pos(self) -> np.ndarray:
        """(N, 3) trunk position [m], a copy."""
        return self._qpos[:, :3].copy()

    def oracle_skill(self) -> np.ndarray:
        """(N,) skill, an index into SKILLS, that the region map names at each robot's x."""
        return self.world.regions[self.course, self.world.column(self._qpos[:, 0])].astype(int)

    def _push(self, direction: np.ndarray) -> None:
        """Overwrite the horizontal velocity of the robots whose push is due; direction (N, 2) in +-1."""
        self.push_timer -= 1
        due = np.flatnonzero(self.push_timer == 0)  # never, where pushes are off: it starts at 0
        if len(due):
            self._qvel[due, :2] = self.config.push_velocity * direction[due]
            self.push_timer[due] = self._push_steps

    def _reset(self, ids: np.ndarray, waypoint_fraction: np.ndarray | None) -> None:
        n, rng, c = len(ids), self.rng, self.config
        self.course[ids] = self.next_course(ids, waypoint_fraction)
        qpos = self._start_pose(n)
        self.simulation.place(ids, self.course[ids], qpos)
        self.command[ids] = rng.uniform(c.command_low, c.command_high, n)
        if self._push_steps:
            self.push_timer[ids] = rng.integers(1, self._push_steps + 1, n)
        for array in (
            self.waypoint_index, self._reach_timer, self._reach_step, self._step_count, self._last_action,
            self._episode_reward, self._episode_edge, self.foot_contact, self.foot_on_edge,
        ):  # fmt: skip
            array[ids] = 0
        self.base_lin_vel[ids], self.projected_gravity[ids] = 0.0, (0.0, 0.0, -1.0)
        self.yaw[ids] = 2.0 * np.arctan2(qpos[:, 6], qpos[:, 3])
        self._update_goal(ids)

    def _start_pose(self, n: int) -> np.ndarray:
        """Draw n starts, qpos (n, 19)."""
        rng, c = self.rng, self.config
        shift = rng.uniform(-c.start_noise, c.start_noise, (n, 3 + ACTION_DIM))  # x, y [m], yaw, joints [rad]
        yaw = np.zeros(n)
        if c.turned_start_share:
            turned = rng.random(n) < c.turned_start_share
            yaw[turned] = rng.uniform(-np.pi, np.pi, np.count_nonzero(turned))
        yaw += shift[:, 2]
        qpos = np.tile(self.simulation.home, (n, 1))
        qpos[:, 0], qpos[:, 1] = SPAWN_X + shift[:, 0], shift[:, 1]
        qpos[:, 2] += 0.02  # they drop onto their feet
        qpos[:, 3], qpos[:, 6] = np.cos(yaw / 2), np.sin(yaw / 2)
        qpos[:, 7:] += shift[:, 3:]
        return qpos

    def _update_kinematics(self) -> None:
        """Refresh what follows from the poses and velocities."""
        r = rotation(self._qpos[:, 3:7])
        self.base_lin_vel = np.einsum("nij,ni->nj", r, self._qvel[:, :3])  # R^T v
        self.projected_gravity = -r[:, 2]  # R^T (0, 0, -1)
        self.yaw = np.arctan2(r[:, 1, 0], r[:, 0, 0])

    def _update_goal(self, ids: np.ndarray | slice) -> None:
        """Refresh what follows from the pose and the waypoint index of robots ``ids``."""
        index = self.waypoint_index[ids, None] + (0, 1)  # this waypoint and the next
        goal = self._waypoints[self.course[ids, None], index] - self._qpos[ids, None, :2]  # (n, 2, 2)
        self.goal[ids] = goal[:, 0]
        self.heading_error[ids] = wrap(np.arctan2(goal[:, :, 1], goal[:, :, 0]) - self.yaw[ids, None])

    def _step_state(self, action: np.ndarray, last_dof_vel: np.ndarray) -> StepState:
        self._update_kinematics()
        self._update_goal(slice(None))
        feet, foot_vel, bodies = (self.simulation.sensors[:, columns] for columns in self._sensors)
        feet, foot_vel = feet.reshape(-1, 4, 4), foot_vel.reshape(-1, 4, 3)  # (N, 4, [found, force xyz]), (N, 4, xyz)
        self.foot_contact = feet[:, :, 0] > 0
        self.foot_on_edge = self._near_edge()
        self._goal_distance = np.hypot(self.goal[:, 0], self.goal[:, 1])
        ground = self.world.ground(self.course[:, None], self.simulation.foot_pos)
        return StepState(
            dt=self.config.dt, base_lin_vel=self.base_lin_vel, base_ang_vel=self._qvel[:, 3:6],
            projected_gravity=self.projected_gravity, speed=np.hypot(self._qvel[:, 0], self._qvel[:, 1]),
            goal_velocity=(self._qvel[:, :2] * self.goal).sum(axis=1) / np.maximum(self._goal_distance, 1e-6),
            heading_error=self.heading_error[:, 0], command=self.command, on_level_course=self._level_course[self.course],
            dof_pos=self._qpos[:, 7:], dof_vel=self._qvel[:, 6:], last_dof_vel=last_dof_vel, torque=self.simulation.torque,
            action=action, last_action=self._last_action,
            foot_force=-feet[:, :, 1:],  # the sensor gives the foot's force on the ground
            foot_contact=self.foot_contact, foot_on_edge=self.foot_on_edge,
            foot_speed=np.hypot(foot_vel[:, :, 0], foot_vel[:, :, 1]),
            foot_clearance=self.simulation.foot_pos[:, :, 2] - FOOT_RADIUS - ground, body_contact=bodies > 0,
        )  # fmt: skip

    def _near_edge(self) -> np.ndarray:
        """(N, 4) feet in contact within 5 cm of an edge, sideways and in height."""
        robot, foot = np.nonzero(self.foot_contact)
        x, y, z = self.simulation.foot_pos[robot, foot].T
        i, j = self.world.cells(x, y)
        on_edge = np.zeros_like(self.foot_contact)
        on_edge[robot, foot] = np.abs(z - FOOT_RADIUS - self.world.edges[self.course[robot], i, j]) < EDGE_DISTANCE
        return on_edge

    def _advance_waypoints(self) -> None:
        """Count the time near the current waypoint; move on when it has been reached.

        The observation and the reward turn to the next waypoint a step later.
        """
        near = self._goal_distance < self.config.waypoint_radius
        self._reach_timer = (self._reach_timer + 1) * near
        reached = self._reach_timer == self._reach_steps
        self.waypoint_index += reached
        self._reach_step[reached] = self._step_count[reached]
        self._reach_timer[reached] = 0

    def _fallen(self) -> np.ndarray:
        """(N,) tipped over, off the lane, too close to the support or below it, or off the beam."""
        x, y, z = self._qpos[:, 0], self._qpos[:, 1], self._qpos[:, 2]
        i = self.world.column(x)
        tipped = self.projected_gravity[:, 2] > -np.cos(self.config.max_tilt)
        outside = (np.abs(y) > LANE_WIDTH / 2) | (x < 0)
        below = z < self.world.support[self.course, i] + self.config.fall_clearance
        # Beam tops stand at height 0 with the ground BEAM_DROP lower: half of that separates the two.
        off_beam = (self.simulation.foot_pos[:, :, 2] < FOOT_RADIUS - BEAM_DROP / 2).all(axis=1)
        return tipped | outside | below | (off_beam & self.world.over_beam[self.course, i])

    def _look(self, ids: np.ndarray | slice) -> None:
        """Refresh the scandots of robots ``ids``."""
        self._scandots[ids] = scandots(self.world, self.course[ids], self._qpos[ids, :3], self.yaw[ids])

    def _draw_disturbance(self) -> np.ndarray:
        """(N, 2 + 53) uniform in +-1: direction of a push, then the observation noise."""
        return 2.0 * self._disturbance_rng.random((self.num_envs, 2 + len(NOISE)), np.float32) - 1.0

    def _observe(self, ids: np.ndarray | slice, noise: np.ndarray) -> np.ndarray:
        """(n, 184) observation of robots ``ids``, a fresh array; noise (N, 53) in +-1."""
        parts = (  # as OBSERVATION lists them
            self.base_lin_vel[ids], self._qvel[ids, 3:6], self.projected_gravity[ids], self.heading_error[ids],
            self.command[ids, None], self._qpos[ids, 7:] - DEFAULT_DOF_POS, self._qvel[ids, 6:], self._last_action[ids],
            self.foot_contact[ids], self._scandots[ids],
        )  # fmt: skip
        observation = np.concatenate(parts, axis=1, dtype=np.float32)
        if self.config.noise:
            noise = noise[ids] * (self.config.noise * NOISE)
            observation[:, : SCANDOTS.start] += noise[:, :-1]
            observation[:, SCANDOTS] += noise[:, -1:]
        return observation
