from agility_ref.curriculum import PRESETS, hardest
from agility_ref.errors import UserError
from agility_ref.terrain import COURSE_KINDS
from agility_ref.training.policies import ALIASES, ENVIRONMENTS, POLICIES, TABLE_ROWS, find_policy, requirements

import pytest


def test_eleven_rows_four_environments():
    assert len(TABLE_ROWS) == 11 and len(set(TABLE_ROWS)) == 11
    assert ENVIRONMENTS == ("climb-gap", "gap", "beam", "climb")


@pytest.mark.parametrize("name", [*TABLE_ROWS, *POLICIES, *ALIASES])
def test_every_name_is_found(name):
    assert find_policy(name).name in POLICIES


def test_policies_refer_to_what_exists():
    for spec in POLICIES.values():
        assert set(spec.courses) <= set(COURSE_KINDS)
        assert set(spec.skills) | set(spec.teachers) <= set(POLICIES)
        assert spec.warm_start is None or spec.warm_start in POLICIES
        assert spec.method in ("ppo", "oracle", "supervised", "ppo-selector", "distilled")
        assert spec.reward in ("environment", "oracle")


@pytest.mark.parametrize("preset", PRESETS)
def test_budgets_include_the_warm_start(preset):
    for spec in POLICIES.values():
        assert spec.steps(preset) > 0 or spec.method == "oracle"
        if spec.warm_start:
            assert spec.steps(preset) > POLICIES[spec.warm_start].steps(preset), spec.name


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("generalist, specialists", [
    ("gen-3", ("climb", "leap", "walk")),
    ("gen-5", ("climb-up", "climb-down", "leap", "beam", "walk")),
])  # fmt: skip
def test_generalists_spend_no_more_than_the_specialists_together(generalist, specialists, preset):
    # The common warm start is counted once: it was trained once.
    base = POLICIES["walk"].steps(preset)
    own = sum(POLICIES[s].steps(preset) - (base if POLICIES[s].warm_start else 0) for s in specialists)
    assert POLICIES[generalist].steps(preset) <= own


def test_hierarchies_own_the_skills_of_the_paper():
    assert set(POLICIES["oracle"].skills) == {"walk", "climb-up", "climb-down", "leap", "beam"}
    assert set(POLICIES["ps-sl-5"].skills) == set(POLICIES["oracle"].skills)
    assert set(find_policy("ps-rl-3").skills) == {"walk", "climb", "leap"}


@pytest.mark.parametrize("name", POLICIES)
def test_requirements_come_before_what_needs_them(name):
    ordered = requirements(name)
    assert len(set(ordered)) == len(ordered) and name not in ordered
    for k, other in enumerate(ordered):
        assert set(requirements(other)) <= set(ordered[:k])


def test_requirements_of_a_selector():
    needs = requirements("ps-rl-3")
    assert needs[0] == "walk" and set(needs) == {"walk", "climb", "leap"}


def test_a_post_generalist_needs_its_teachers():
    assert set(requirements("post-gen")) == {*POLICIES["oracle"].skills, "distilled"}


@pytest.mark.parametrize("given, nearest", [("climb-upp", "climb-up"), ("gen3", "gen-3"), ("psrl3", "ps-rl-3")])
def test_unknown_policy_names_the_nearest(given, nearest):
    with pytest.raises(UserError, match=f"unknown policy '{given}': did you mean .*{nearest}"):
        find_policy(given)


def test_a_name_like_nothing_lists_all():
    with pytest.raises(UserError, match="choose from"):
        find_policy("@@@@")


def test_unknown_preset():
    assert hardest("quick") < hardest("full")
    with pytest.raises(UserError, match="unknown preset 'quik': did you mean quick"):
        hardest("quik")
