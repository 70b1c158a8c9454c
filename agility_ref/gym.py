"""The Gymnasium adapter: ``pip install "agility-ref[gym]"``.

    gymnasium.make("agility_ref.gym:Go1Climb-v0", difficulty=0.5, render_mode="rgb_array")
    gymnasium.make_vec("agility_ref.gym:Go1Walk-v0", num_envs=256, autoreset_mode="SameStep")

Go1Walk, Go1ClimbUp, Go1ClimbDown, Go1Climb, Go1Gap, Go1Beam and Go1ClimbGap are the ids.  ``make_vec``
steps its robots together in one simulator.  The manual is :class:`~agility_ref.env.Go1Env`; here, an
action of 1 is its ``action_limit``, 1.2 rad, and observations are clipped to finite bounds.
"""

from contextlib import suppress

from agility_ref.errors import UserError
from agility_ref.pictures.video import choose_gl

import numpy as np

try:
    import gymnasium
    from gymnasium.vector import AutoresetMode, VectorEnv
except ImportError:
    raise UserError('agility_ref.gym needs one more package: pip install "agility-ref[gym]"') from None
with suppress(UserError):  # without OpenGL only rendering fails
    choose_gl()  # before the next line imports MuJoCo
from agility_ref.env import ACTION_DIM, EnvConfig, Go1Env
from agility_ref.observation import OBS_BOUND
from agility_ref.pictures.camera import Camera
from agility_ref.terrain import COURSE_KINDS, NUM_WAYPOINTS, make_course
from agility_ref.world import World


def masked(info: dict, rows: np.ndarray) -> dict:
    """Keep the rows (N,) bool of an info, with Gymnasium's ``_name`` that says which these are."""
    kept = {k: masked(v, rows) if isinstance(v, dict) else v * rows for k, v in info.items() if rows.any()}
    return kept | {f"_{name}": rows.copy() for name in kept}


def row(info: dict, robot: int) -> dict:
    """Return the info of one robot as plain numbers, without the masks."""
    own = {name: value for name, value in info.items() if not name.startswith("_")}
    return {name: row(v, robot) if isinstance(v, dict) else v[robot].item() for name, v in own.items()}


class Go1VectorEnv(VectorEnv):
    """N robots on courses of one kind.

    Parameters
    ----------
    kind : one of COURSE_KINDS, given by the id
    num_envs : N
    difficulty : of every course, or (low, high) between which they are spread evenly
    courses, course_seed : how many, for episodes to draw from; seed of their boxes, friction and payload
    config : the task
    autoreset_mode : Gymnasium's; NEXT_STEP is its default, SAME_STEP wastes no step
    render_mode : "rgb_array" for an image of each robot, "human" for MuJoCo's viewer on the first
    num_threads : simulation threads, 0 for all cores; results do not depend on it
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 25}  # noqa: RUF012

    def __init__(
        self, kind: str, num_envs: int = 1, difficulty: float | tuple[float, float] = (0.0, 1.0), courses: int = 8,
        course_seed: int = 0, config: EnvConfig = EnvConfig(), autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None, num_threads: int = 0,
    ):  # fmt: skip
        spread = np.linspace(*np.broadcast_to(difficulty, 2), courses)
        world = World([make_course(kind, d, [course_seed, k]) for k, d in enumerate(spread)])
        self.go1 = Go1Env(world, num_envs, config, seed=course_seed, num_threads=num_threads, autoreset=False)
        self.num_envs, self.render_mode, self.autoreset_mode = num_envs, render_mode, AutoresetMode(autoreset_mode)
        self.metadata = self.metadata | {"render_fps": round(1 / config.dt), "autoreset_mode": self.autoreset_mode}
        spaces = gymnasium.spaces.Box(-OBS_BOUND, OBS_BOUND), gymnasium.spaces.Box(-1.0, 1.0, (ACTION_DIM,))
        self.single_observation_space, self.single_action_space = spaces
        self.observation_space, self.action_space = (gymnasium.vector.utils.batch_space(s, num_envs) for s in spaces)
        self._obs, self._done = np.zeros((num_envs, len(OBS_BOUND)), np.float32), np.zeros(num_envs, bool)
        self.camera = Camera(self.go1, render_mode)

    def _restart(self, rows: np.ndarray, seed: int | None = None) -> None:
        obs = np.clip(self.go1.reset(seed, rows)[0], -OBS_BOUND, OBS_BOUND)
        self._obs, self._done = np.where(rows[:, None], obs, self._obs), self._done & ~rows

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[np.ndarray, dict]:
        """Start new episodes, of the robots in ``options["reset_mask"]`` (N,) bool if it is there."""
        super().reset(seed=seed)
        rows = (options or {}).get("reset_mask", np.ones(self.num_envs, bool))
        if not (isinstance(rows, np.ndarray) and rows.dtype == bool and rows.shape == (self.num_envs,) and rows.any()):
            raise ValueError(f"reset_mask must be a boolean array of shape ({self.num_envs},) with a True in it")
        self._restart(rows, int(self.np_random.integers(2**31)) if self._np_random is None else seed)
        self.camera.refresh()
        return self._obs.copy(), {}

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict]:
        """Advance every robot; raises ValueError for actions of the wrong shape, UserError for those that are not finite."""
        waiting, same_step, info = self._done, self.autoreset_mode is AutoresetMode.SAME_STEP, {}
        if self.autoreset_mode is AutoresetMode.DISABLED and waiting.any():
            raise ValueError(f"robots {np.flatnonzero(waiting).tolist()} are done: reset them before the next step")
        obs, reward, terminated, truncated, own = self.go1.step(np.multiply(actions, self.go1.config.action_limit))
        reward[waiting], terminated[waiting], truncated[waiting] = 0.0, False, False  # NEXT_STEP: this is their reset
        self._obs, self._done = np.clip(obs, -OBS_BOUND, OBS_BOUND), terminated | truncated
        del own["final_obs"]
        own["is_success"] = own["totals"]["waypoints"] >= NUM_WAYPOINTS
        restart = self._done if same_step else waiting
        for i in np.flatnonzero(restart) if same_step else ():
            info = self._add_info(info, {"final_obs": self._obs[i], "final_info": row(own, i)}, i)
        if restart.any():
            self._restart(restart)
        self.camera.refresh()
        return self._obs.copy(), reward, terminated, truncated, info | masked(own, ~restart)

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Return an image (480, 640, 3) for each robot."""
        return self.camera.frames()

    def close_extras(self, **kwargs) -> None:
        """Close the window and free the graphics memory."""
        if hasattr(self, "camera"):  # not where __init__ raised
            self.camera.close()


class Go1GymEnv(gymnasium.Env):
    """One robot; the parameters of :class:`Go1VectorEnv` but ``num_envs`` and ``autoreset_mode``."""

    metadata = Go1VectorEnv.metadata

    def __init__(self, kind: str, **options):
        self._one = Go1VectorEnv(kind, 1, autoreset_mode=AutoresetMode.DISABLED, **{"num_threads": 1} | options)
        self.render_mode, self.metadata = self._one.render_mode, self._one.metadata
        self.observation_space, self.action_space = self._one.single_observation_space, self._one.single_action_space

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[np.ndarray, dict]:
        """Start a new episode."""
        super().reset(seed=seed)
        return self._one.reset(seed=seed)[0][0], {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Advance the robot; raises ValueError for an action of the wrong shape, UserError for one that is not finite."""
        obs, *numbers, info = self._one.step(np.asarray(action)[None])
        return obs[0], *(x[0].item() for x in numbers), row(info, 0)

    def render(self) -> np.ndarray | None:
        """Return an image (480, 640, 3)."""
        return (self._one.render() or (None,))[0]

    def close(self) -> None:
        """Close the window and free the graphics memory."""
        self._one.close()


for _kind in COURSE_KINDS:
    _id = f"Go1{_kind.title().replace('-', '')}-v0"
    gymnasium.register(_id, Go1GymEnv, vector_entry_point=Go1VectorEnv, kwargs={"kind": _kind})
