from agility_ref.errors import UserError, require_at_least, unknown_name

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


def test_the_nearest_names_come_first():
    names = ("walk", "climb", "climb-up", "beam")
    assert str(unknown_name("policy", "climbup", names)).startswith("unknown policy 'climbup': did you mean climb-up")
    assert str(unknown_name("policy", "zzz", names)) == (
        "unknown policy 'zzz': choose from walk, climb, climb-up, beam"
    )
