"""Wrong answers to assignment 3."""

from mutants import Mutant

FILE = "hw3/ppo.py"

MUTANTS = (
    Mutant(
        "a truncated episode treated as a fall",
        FILE,
        (("np.select([ends == RUNNING, ends == TRUNCATED], [values[:, 1:], final_values], 0.0)", "np.where(ends == RUNNING, values[:, 1:], 0.0)"),),
        "test_gae_truncated_by_hand",
        "cut off in step 1",
    ),
    Mutant(
        "bootstrapped from the next episode",
        FILE,
        (("[values[:, 1:], final_values]", "[values[:, 1:], values[:, 1:]]"),),
        "test_gae_truncated_by_hand",
        "no business there",
    ),
    Mutant(
        "a fall bootstrapped",
        FILE,
        (("[values[:, 1:], final_values], 0.0)", "[values[:, 1:], final_values], values[:, 1:])"),),
        "test_gae_by_hand",
        "nothing follows",
    ),
    Mutant(
        "the advantage crosses the end",
        FILE,
        (("gamma * lam * (ends[:, t] == RUNNING) * ahead", "gamma * lam * (ends[:, t] != TERMINATED) * ahead"),),
        "test_gae_truncated_by_hand",
        "cut off in step 1",
    ),
    Mutant(
        "NaN times 0",
        FILE,
        (
            (
                "np.select([ends == RUNNING, ends == TRUNCATED], [values[:, 1:], final_values], 0.0)",
                "(ends == RUNNING) * values[:, 1:] + (ends == TRUNCATED) * final_values",
            ),
        ),
        "test_gae_of_random_rollouts",
        "NaN times 0",
    ),
    Mutant(
        "a loss for an objective",
        FILE,
        (("    return torch.min(", "    return -torch.min("),),
        "test_surrogate_by_hand",
        "maximised",
    ),
    Mutant(
        "clipped without the minimum",
        FILE,
        (("torch.min(ratio * advantage, ratio.clamp(1 - clip, 1 + clip) * advantage).mean()", "(ratio.clamp(1 - clip, 1 + clip) * advantage).mean()"),),
        "test_surrogate_by_hand",
        "not 0.4|1.2 - 1.5",
    ),
    Mutant(
        "step size the wrong way round",
        FILE,
        (("    if kl > 2 * config.target_kl:", "    if kl < config.target_kl / 2:"), ("    elif kl < config.target_kl / 2:", "    elif kl > 2 * config.target_kl:")),
        "test_rate_by_hand",
        "KL 0.05",
    ),
    Mutant(
        "variances averaged",
        FILE,
        ((" + delta**2 * self.count * n / total", ""),),
        "test_normaliser_of_batches",
        "means of batches differ",
    ),
    Mutant(
        "difference of large squares",
        FILE,
        (
            (
                "m2 = self.variance * self.count + variance * n + delta**2 * self.count * n / total",
                "m2 = ((self.variance + self.mean**2) * self.count + (batch.astype(np.float32) ** 2).mean(axis=0) * n).astype(np.float32)"
                " - total * (self.mean + delta * n / total) ** 2",
            ),
        ),
        "test_normaliser_of_large_numbers",
        "large squares",
    ),
    Mutant(
        "normalising counts",
        FILE,
        (("        return np.clip((obs - self.mean)", "        self.update(obs)\n        return np.clip((obs - self.mean)"),),
        "test_normaliser_by_hand",
        "within|takes note of nothing",
    ),
    Mutant(
        "shuffled once",
        FILE,
        (
            ("    for _ in range(config.epochs):\n", "    order = torch.randperm(len(advantage), generator=generator)\n    for _ in range(config.epochs):\n"),
            ("torch.randperm(len(advantage), generator=generator).chunk", "order.chunk"),
        ),
        "test_update_uses_every_sample",
        "shuffle anew",
    ),
    Mutant(
        "advantages as they are",
        FILE,
        (("advantage = (batch.advantage - batch.advantage.mean()) / (batch.advantage.std() + 1e-8)", "advantage = batch.advantage"),),
        "test_update_normalises_advantages",
        "over the batch",
    ),
    Mutant(
        "gradients not cut",
        FILE,
        (("            torch.nn.utils.clip_grad_norm_(policy.parameters(), config.max_grad_norm)\n", ""),),
        "test_update_clips_gradients",
        "moves by 0.01",
    ),
    Mutant(
        "value moved away from its target",
        FILE,
        (("loss = -gain - config.entropy * policy.entropy() + (", "loss = -gain - config.entropy * policy.entropy() - ("),),
        "test_update_improves",
        "the error of the value",
    ),
    Mutant(
        "agility_ref's own functions",
        FILE,
        (("    following = np.select(", "    from agility_ref import ppo\n\n    return ppo.gae(rewards, values, final_values, ends == TERMINATED, ends == TRUNCATED, gamma, lam)\n    following = np.select("),),
        "test_gae_by_hand",
        "agility_ref's own are others",
    ),
)  # fmt: skip
