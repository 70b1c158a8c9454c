import contextlib

from agility_ref.errors import MANY, MAX_SEED, UserError, require_at_least, require_pairs, unknown_name

import pytest


def test_numbers_of_at_least_the_least_pass():
    assert require_at_least(1, robots=1, steps=2, rate=1.5) is None
    assert require_at_least(0.0, noise=0.0, most=1e308) is None


@pytest.mark.parametrize("value, shown", [
    (0, "0"), (-3, "-3"), (0.999, "0.999"), (float("nan"), "nan"), (float("inf"), "inf"), (float("-inf"), "-inf"),
])  # fmt: skip
def test_others_are_refused_by_the_name_of_their_flag(value, shown):
    with pytest.raises(UserError) as refusal:
        require_at_least(1, num_envs=2, num_steps=value, update_epochs=-5)  # the first that is wrong
    assert str(refusal.value) == f"num-steps must be a number of at least 1, not {shown}"


def test_there_may_be_a_greatest_too():
    assert require_at_least(0, MAX_SEED, seed=2**63 - 1) is None
    with pytest.raises(UserError, match=r"^seed must be at most 9\.22337e\+18, not 9223372036854775808$"):
        require_at_least(0, MAX_SEED, seed=2**63)


@pytest.mark.parametrize(
    "hidden, right",
    [((), False), ((2,), True), ((64, 8), True), ((0,), False), ((64, 7), False), ((MANY + 2,), False), ((-2,), False)],
)
def test_units_come_in_pairs(hidden, right):
    with contextlib.nullcontext() if right else pytest.raises(UserError, match="come in pairs"):
        require_pairs(hidden)


def test_the_nearest_names_come_first():
    names = ("walk", "climb", "climb-up", "beam")
    assert str(unknown_name("policy", "climbup", names)).startswith("unknown policy 'climbup': did you mean climb-up")
    assert str(unknown_name("policy", "zzz", names)) == (
        "unknown policy 'zzz': choose from walk, climb, climb-up, beam"
    )
