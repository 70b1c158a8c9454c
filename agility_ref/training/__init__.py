"""Training: the policies of Table 1 as data, and runs in folders that train them, resumably.

The bank of specialists, distillation, progress and the shipped weights; imports from the core alone.
In: the name of a policy, a preset, a seed.  Out: a folder with policy.npz, or the policy, ready to act.
"""
