"""Task: everything about an episode but the courses, as numbers that a reader may change.

Paper section 4.1 and the Extreme Parkour code base; docs/differences.md has its values beside
ours.  In: nothing.  Out: :class:`EnvConfig`, which :class:`~agility_ref.env.Go1Env` obeys.
"""

from dataclasses import dataclass, replace

from agility_ref.go1 import PhysicsConfig
from agility_ref.observation import OBS_DIM
from agility_ref.rewards import RewardConfig


@dataclass(frozen=True)
class EnvConfig:
    """Everything about the task but the courses."""

    physics: PhysicsConfig = PhysicsConfig()
    """Simulator and joint controller."""
    rewards: RewardConfig = RewardConfig()
    """Weights of the reward terms."""
    clip_reward_at_zero: bool = False
    """Clip the summed reward at zero as the original does; docs/training.md has the ablation."""
    action_scale: float = 0.3
    """Joint offset per unit of action [rad]; usual 0.25 to 0.5."""
    action_limit: float = 4.0
    """Actions are clipped to +- this; 4 x 0.3 = 1.2 rad, the original's limit."""
    action_repeat: int = 1
    """Control steps for which an action is held, the paper's "action stacking" ablation; 1 to 5."""
    episode_seconds: float = 20.0
    """An episode is truncated after this time [s]."""
    command_low: float = 0.7
    """Lowest commanded speed [m/s]; the original's 0.3 times out before the end of a course."""
    command_high: float = 1.0
    """Highest commanded speed [m/s]; original 0.8."""
    waypoint_radius: float = 0.2
    """A waypoint counts while the trunk's xy is within this distance [m]."""
    waypoint_seconds: float = 0.1
    """... and is reached after staying there for this long [s]."""
    max_tilt: float = 1.4
    """Angle between trunk and vertical beyond which a robot has tipped over [rad]."""
    fall_clearance: float = 0.05
    """A trunk that is less than this above the ground it should walk over has fallen [m]."""
    start_noise: float = 0.1
    """Starts differ by up to +- this in position [m], yaw and joint angles [rad]; usual 0.05 to 0.2."""
    noise: float = 1.0
    """Scale of the observation noise; 0 turns it off."""
    gait_clock: float = 0.0
    """Rate [Hz] of a clock whose sine and cosine the robot also senses, an ablation; 0 for none, usual 2 to 3."""
    scandot_period: int = 2
    """Actions between two looks at the ground, taken in turn by the robots; 2 is 25 Hz, the original has 10 Hz."""
    push_interval: float = 6.0
    """Seconds between pushes; 0 turns them off.  Original: 8 in training, 6 in evaluation."""
    push_velocity: float = 0.5
    """A push sets the horizontal velocity to a draw from +- this [m/s]."""
    friction_low: float = 0.6
    """Lowest ground friction, drawn per course; original 0.6."""
    friction_high: float = 1.2
    """Highest ground friction; original 2.0."""
    payload_high: float = 2.0
    """Highest mass added to the trunk [kg], drawn per course; original 3."""

    turned_start_share: float = 0.0
    """Share of episodes that start facing anywhere instead of along the course; training only, 0 to 0.5."""
    stall_seconds: float = 0.0
    """Terminate after this time without a waypoint [s]; training only, 0 for never."""

    @property
    def dt(self) -> float:
        """Time between two actions [s]."""
        return self.physics.timestep * self.physics.substeps * self.action_repeat

    @property
    def obs_dim(self) -> int:
        """Numbers in an observation: OBS_DIM, and two more with a clock."""
        return OBS_DIM + 2 * bool(self.gait_clock)

    def clean(self) -> "EnvConfig":
        """Return the same task without noise, pushes and payload, at friction 1."""
        return replace(self, noise=0.0, push_interval=0.0, payload_high=0.0, friction_low=1.0, friction_high=1.0)


# Training differs from evaluation in two numbers.  A robot that runs past a waypoint must turn
# back, which it meets too rarely to learn; and one that stands before an obstacle for the rest
# of 20 s fills the batch with nothing.
TRAINING = EnvConfig(turned_start_share=0.1, stall_seconds=5.0)
