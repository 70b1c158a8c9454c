"""What PPO costs on top of the physics, and what its settings change.

    python benchmarks/train_throughput.py [--json]

Every variant learns on the same robots in turn.  One iteration is ``collect`` and
``update``; the physics inside ``collect`` is replayed bare, right afterwards.
"""

import time
from dataclasses import asdict, dataclass, replace

from agility_ref.env import Go1Env
from agility_ref.networks import sample
from agility_ref.observation import ACTION_MIRROR, OBS_MIRROR, SCANDOTS
from agility_ref.policy import Policy
from agility_ref.ppo import Learner, PPOConfig, collect, train, update
from agility_ref.training.state import policy_arrays

import numpy as np
import torch
from common import Taped, alternate, available_cores, machine, ratio, report, show, start, walk_training


@dataclass(frozen=True)
class Config:
    """PPO throughput."""

    rounds: int = 10
    """Rounds of the alternation; the median counts."""
    only_default: bool = False
    """Measure the default settings alone."""
    json: bool = False
    """Print one JSON object."""


@dataclass
class Variant:
    """One setting, and the seconds that its iterations took."""

    name: str
    ppo: PPOConfig
    collect_threads: int
    """Torch threads during collect ..."""
    update_threads: int
    """... and during update."""

    def __post_init__(self):
        self.learner = Learner.create(OBS_MIRROR, ACTION_MIRROR, self.ppo, seed=0, fixed=SCANDOTS)
        self.collect_seconds, self.update_seconds, self.bare_seconds = [], [], []

    def iterate(self, env: Taped, observation: np.ndarray) -> np.ndarray:
        """Run one iteration and the replay of its physics; return the next observation."""
        torch.set_num_threads(self.collect_threads)
        env.rewind()
        start = time.perf_counter()
        rollout, observation = collect(env, self.learner, observation)
        collected = time.perf_counter()
        torch.set_num_threads(self.update_threads)
        update(self.learner, rollout)
        self.update_seconds.append(time.perf_counter() - collected)
        self.collect_seconds.append(collected - start - env.tape_seconds)
        self.bare_seconds.append(env.replay())
        return observation

    def figures(self) -> dict:
        """Return speeds in environment steps per second; the first iteration is not counted."""
        collect_s, update_s, bare_s = (
            np.array(s[1:]) for s in (self.collect_seconds, self.update_seconds, self.bare_seconds)
        )
        steps = self.ppo.batch_size
        return {
            "steps_per_second": float(steps / np.median(collect_s + update_s)),
            "collect_steps_per_second": float(steps / np.median(collect_s)),
            "update_steps_per_second": float(steps / np.median(update_s)),
            "bare_steps_per_second": float(steps / np.median(bare_s)),
            "end_to_end_over_bare": ratio(bare_s, collect_s + update_s),
            "collect_over_bare": ratio(bare_s, collect_s),
        }


def default_torch_threads() -> tuple[int, int]:
    """Return how many threads :func:`agility_ref.ppo.train` gives to torch, in collect and in update."""
    env, _ = walk_training(0, 2)
    ppo = PPOConfig(num_envs=2, num_steps=2, num_minibatches=1)
    seen = []

    def step(action: np.ndarray) -> tuple:
        seen.append(torch.get_num_threads())
        return Go1Env.step(env, action)

    env.step = step
    iterations = train(env, Learner.create(OBS_MIRROR, ACTION_MIRROR, ppo, 0), 10)
    next(iterations)
    return seen[-1], torch.get_num_threads()


def variants(only_default: bool) -> list[Variant]:
    """The settings compared, the default first."""
    base, threads = PPOConfig(), default_torch_threads()
    default = Variant("default", base, *threads)
    if only_default:
        return [default]
    cores, changes = available_cores(), {}
    for hidden in ((64, 64), (128, 128), (512, 256, 128)):
        changes[f"hidden {hidden}"] = {"hidden": hidden}
    for steps, minibatches, epochs in ((16, 2, 4), (16, 8, 4), (16, 4, 2), (16, 4, 5), (24, 4, 5), (32, 4, 4)):
        name = f"{steps} steps, {minibatches} minibatches, {epochs} epochs"
        changes[name] = {"num_steps": steps, "num_minibatches": minibatches, "update_epochs": epochs}
    return [
        default,
        *(
            Variant(f"torch threads: {c} in collect, {u} in update", base, c, u)
            for c, u in ((1, 1), (1, cores), (cores, cores))
            if (c, u) != threads
        ),
        *(Variant(name, replace(base, **change), *threads) for name, change in changes.items()),
    ]


def inference(learner: Learner, observation: np.ndarray, rounds: int) -> dict:
    """Compare torch with plain numpy for the policy step of a rollout."""
    policy = Policy.from_arrays(policy_arrays(learner), {})

    @torch.inference_mode()
    def in_torch() -> None:
        for _ in range(20):
            mean = learner.net.actor(learner.observe(observation))
            sample(learner.net.distribution(mean, learner.net.std()), learner.generator)

    std, rng = learner.net.std().detach().numpy(), np.random.default_rng(0)

    def in_numpy() -> None:
        for _ in range(20):
            mean = policy(observation)
            mean + std * rng.standard_normal(mean.shape, np.float32)

    seconds = alternate({"torch": in_torch, "numpy": in_numpy}, 3 * rounds)
    return {
        "torch_inference_microseconds": float(np.median(seconds["torch"]) / 20 * 1e6),
        "numpy_inference_microseconds": float(np.median(seconds["numpy"]) / 20 * 1e6),
        "numpy_over_torch_inference": ratio(seconds["numpy"], seconds["torch"]),
    }


def main(config: Config) -> None:
    started = machine()
    settings = variants(config.only_default)
    env = Taped(walk_training(0, PPOConfig().num_envs)[0])
    observation, _ = env.reset(0)
    for _ in range(config.rounds + 1):
        for variant in settings:
            observation = variant.iterate(env, observation)
    torch.set_num_threads(settings[0].collect_threads)
    figures = {variant.name: variant.figures() for variant in settings}
    infer = inference(settings[0].learner, observation, config.rounds)
    rows = [
        {
            "variant": name,
            "steps/s": f"{f['steps_per_second']:.0f}",
            "collect": f"{f['collect_steps_per_second']:.0f}",
            "update": f"{f['update_steps_per_second']:.0f}",
            "bare physics": f"{f['bare_steps_per_second']:.0f}",
            "end to end / bare": show(f["end_to_end_over_bare"]),
        }
        for name, f in figures.items()
    ]
    micro = [
        {
            "policy step, one torch call or numpy": name,
            "microseconds": f"{infer[f'{name}_inference_microseconds']:.0f}",
        }
        for name in ("torch", "numpy")
    ]
    report(
        config.json,
        started,
        {
            "config": asdict(config),
            "default_torch_threads": [settings[0].collect_threads, settings[0].update_threads],
            "variants": figures,
            **infer,
        },
        rows,
        micro,
    )


if __name__ == "__main__":
    start(main, Config)
