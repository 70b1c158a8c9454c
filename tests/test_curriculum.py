from dataclasses import replace

from agility_ref.curriculum import Curriculum, CurriculumConfig, level_difficulties, training_world
from agility_ref.errors import UserError
from agility_ref.terrain import beam_width

import numpy as np
import pytest

# One variant, so that a course's number is its level; scores move by half of the way.
PLAIN = CurriculumConfig(num_levels=4, variants=1, score_step=0.5, easy_share=0.0, top_easy_share=0.0)


def play(curriculum, *fractions, robot=0):
    """Let one robot end episodes, one after another, on the frontier of its kind."""
    for fraction in fractions:
        curriculum.next_course(np.array([robot]), np.array([fraction], float))


def one_kind(config=PLAIN, frontier=0, robots=1):
    """Return a curriculum of one kind whose robots play on the frontier."""
    curriculum = Curriculum(1, robots, config, seed=0)
    curriculum.frontier[:] = frontier
    curriculum.level[:] = frontier
    return curriculum


# --- courses ---------------------------------------------------------------------------


def test_world_is_ordered_by_kind_level_variant():
    config = CurriculumConfig(num_levels=3, variants=2)
    world = training_world(("gap", "climb"), config, 0.6, seed=0)
    assert list(world.kinds) == ["gap"] * 6 + ["climb"] * 6
    levels = [level_difficulties(kind, 0.6, 3) for kind in ("gap", "climb")]
    np.testing.assert_allclose(world.difficulties, np.repeat(np.concatenate(levels), 2))
    assert all(np.diff(d).min() > 0 and d[-1] == 0.6 for d in levels)


def test_variants_and_seeds_differ():
    config = CurriculumConfig(num_levels=1, variants=2)
    a, b = (training_world(("gap",), config, 1.0, seed) for seed in (0, 1))
    assert a.courses[0].boxes != a.courses[1].boxes
    assert a.courses[0].boxes != b.courses[0].boxes


def test_beams_start_wider_than_the_robot():
    difficulties = level_difficulties("beam", 1.0, 5)
    assert beam_width(difficulties[0]) > 0.6
    assert difficulties[-1] == 1.0


def test_every_course_is_drawn_anew():
    world = training_world(("gap", "climb-gap"), CurriculumConfig(num_levels=3, variants=2), 1.0, seed=0)
    assert len({c.waypoints[:, 1].tobytes() for c in world.courses}) == len(world)


def test_robots_keep_their_variant():
    # 12 robots in blocks: 2 variants, six robots each
    curriculum = Curriculum(3, 12, CurriculumConfig(num_levels=4, variants=2), seed=0)
    rng, kinds = np.random.default_rng(0), set()
    for _ in range(50):
        courses = curriculum.next_course(np.arange(12), rng.random(12))
        np.testing.assert_array_equal(courses % 2, [0] * 6 + [1] * 6)
        np.testing.assert_array_equal(courses // 2 % 4, curriculum.level)
        np.testing.assert_array_equal(courses // (4 * 2), curriculum.kind)
        kinds |= set(curriculum.kind)
    assert kinds == {0, 1, 2}


@pytest.mark.parametrize("field", ["num_levels", "variants"])
def test_a_curriculum_without_courses_is_refused(field):
    with pytest.raises(UserError, match=f"^{field.replace('_', '-')} must be a number of at least 1, not 0$"):
        CurriculumConfig(**{field: 0})


# --- the score, by hand ----------------------------------------------------------------


def test_the_score_goes_part_of_the_way_to_each_episode():
    curriculum = one_kind(replace(PLAIN, score_step=0.25, first_score=0.4))
    # 0.4 + (0.8 - 0.4) / 4 = 0.5;  0.5 + (0.3 - 0.5) / 4 = 0.45
    play(curriculum, 0.8)
    assert curriculum.score[0] == pytest.approx(0.5)
    play(curriculum, 0.3)
    assert curriculum.score[0] == pytest.approx(0.45)
    assert curriculum.frontier[0] == 0


def test_robots_that_end_together_count_one_after_another():
    curriculum = one_kind(replace(PLAIN, score_step=0.25), robots=2)
    curriculum.next_course(np.arange(2), np.array([0.8, 0.3]))
    assert curriculum.score[0] == pytest.approx(0.45)  # as above


def test_a_frontier_rises_at_three_quarters_and_starts_over():
    curriculum = one_kind(frontier=1)
    play(curriculum, 1.0)  # 0.4 + 0.6 / 2 = 0.7
    assert curriculum.frontier[0] == 1 and curriculum.score[0] == pytest.approx(0.7)
    play(curriculum, 1.0)  # 0.7 + 0.3 / 2 = 0.85
    assert curriculum.frontier[0] == 2 and curriculum.score[0] == PLAIN.first_score
    assert curriculum.level[0] == 2  # and the next episode is played there


def test_a_frontier_falls_below_a_quarter_and_starts_over():
    curriculum = one_kind(frontier=2)
    play(curriculum, 0.25)  # 0.325
    assert curriculum.frontier[0] == 2 and curriculum.score[0] == pytest.approx(0.325)
    play(curriculum, 0.0)  # 0.1625
    assert curriculum.frontier[0] == 1 and curriculum.score[0] == PLAIN.first_score


@pytest.mark.parametrize("fraction, frontier", [(0.75, 2), (0.7499, 1), (0.25, 1), (0.2499, 0)])
def test_promote_counts_as_reached_and_demote_does_not(fraction, frontier):
    # A step of 1 makes the score the episode's fraction.
    curriculum = one_kind(replace(PLAIN, score_step=1.0), frontier=1)
    play(curriculum, fraction)
    assert curriculum.frontier[0] == frontier


@pytest.mark.parametrize("frontier, fraction", [(3, 1.0), (0, 0.0)])
def test_frontiers_stay_in_range(frontier, fraction):
    curriculum = one_kind(frontier=frontier)
    play(curriculum, *[fraction] * 10)
    assert curriculum.frontier[0] == frontier
    assert curriculum.score[0] == pytest.approx(fraction, abs=1e-3)  # which goes on


@pytest.mark.parametrize("level", [0, 1])
def test_an_easier_episode_is_not_scored(level):
    curriculum = one_kind(frontier=2)
    curriculum.level[:] = level
    play(curriculum, 1.0)
    assert curriculum.score[0] == PLAIN.first_score and curriculum.frontier[0] == 2


def test_an_episode_from_before_the_frontier_moved_is_not_scored():
    curriculum = one_kind(replace(PLAIN, score_step=1.0), frontier=1, robots=2)
    curriculum.next_course(np.arange(2), np.array([1.0, 0.0]))  # the first moves it up, the second was below
    assert curriculum.frontier[0] == 2 and curriculum.score[0] == PLAIN.first_score


def test_kinds_have_scores_of_their_own():
    curriculum = Curriculum(2, 2, PLAIN, seed=0)
    curriculum.kind[:] = 0, 1
    curriculum.next_course(np.arange(2), np.array([0.6, 0.2]))
    np.testing.assert_allclose(curriculum.score, [0.5, 0.3])


def test_start_counts_as_no_episode():
    curriculum = one_kind(robots=3)
    courses = curriculum.next_course(np.arange(3), None)
    np.testing.assert_array_equal(courses, [0, 0, 0])
    assert curriculum.score[0] == PLAIN.first_score and curriculum.frontier[0] == 0


def test_only_the_robots_that_ended_start_anew():
    curriculum = one_kind(frontier=2, robots=3)
    curriculum.level[:] = 0
    assert len(curriculum.next_course(np.array([1]), np.array([0.5]))) == 1
    np.testing.assert_array_equal(curriculum.level, [0, 2, 0])


def test_good_robots_reach_the_top_and_bad_ones_fall_back():
    curriculum = Curriculum(2, 64, CurriculumConfig(), seed=0)
    everyone = np.arange(64)
    curriculum.next_course(everyone, None)
    for _ in range(60):
        curriculum.next_course(everyone, np.full(64, 0.9))
    np.testing.assert_array_equal(curriculum.frontier, [9, 9])
    for _ in range(60):
        curriculum.next_course(everyone, np.full(64, 0.1))
    np.testing.assert_array_equal(curriculum.frontier, [0, 0])


# --- which level -----------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5])
def test_easy_share_replays_easier_levels(share):
    curriculum = one_kind(replace(PLAIN, easy_share=share), frontier=2, robots=4000)
    courses = curriculum.next_course(np.arange(4000), None)
    # that share of them on levels drawn from {0, 1, 2}: a third of it is not easier
    assert (courses <= 2).all()
    assert (courses < 2).mean() == pytest.approx(share * 2 / 3, abs=0.03)
    if share:
        low = np.bincount(courses, minlength=3)[:2] / 4000
        np.testing.assert_allclose(low, share / 3, atol=0.03)


@pytest.mark.parametrize("easy, top", [(0.0, 0.5), (0.5, 0.0), (0.3, 0.625)])
def test_the_top_has_a_share_of_its_own(easy, top):
    config = replace(PLAIN, easy_share=easy, top_easy_share=top)
    courses = one_kind(config, frontier=3, robots=4000).next_course(np.arange(4000), None)
    assert (courses < 3).mean() == pytest.approx(top * 3 / 4, abs=0.03)
    below = one_kind(config, frontier=2, robots=4000).next_course(np.arange(4000), None)
    assert (below < 2).mean() == pytest.approx(easy * 2 / 3, abs=0.03)


def test_disabled_draws_all_levels_alike():
    curriculum = one_kind(replace(PLAIN, enabled=False), robots=4000)
    courses = curriculum.next_course(np.arange(4000), np.full(4000, 0.5))
    np.testing.assert_allclose(np.bincount(courses, minlength=4) / 4000, 0.25, atol=0.03)


# --- which kind ------------------------------------------------------------------------


def shares(config, score, frontier=0):
    """Shares of the kinds among the episodes of many robots."""
    curriculum = Curriculum(len(score), 20_000, config, seed=0)
    curriculum.score[:], curriculum.frontier[:] = score, frontier
    curriculum.next_course(np.arange(20_000), None)
    return np.bincount(curriculum.kind, minlength=len(score)) / 20_000


def test_kinds_with_a_low_score_are_drawn_more_often():
    # w = 0.1 + 1 - score: 1.1, 0.7, 0.1, of 1.9 together
    np.testing.assert_allclose(shares(PLAIN, [0.0, 0.4, 1.0]), np.array([1.1, 0.7, 0.1]) / 1.9, atol=0.01)


def test_the_level_makes_no_difference_to_how_often_a_kind_is_drawn():
    np.testing.assert_array_equal(shares(PLAIN, [0.4, 0.6, 0.9], [0, 1, 3]), shares(PLAIN, [0.4, 0.6, 0.9], [3, 3, 0]))


def test_kinds_with_one_score_get_equal_shares():
    for score in (0.0, 0.4, 1.0):
        np.testing.assert_allclose(shares(PLAIN, [score] * 4, [0, 1, 2, 3]), 0.25, atol=0.015)


def test_an_infinite_floor_draws_kinds_evenly():
    np.testing.assert_allclose(shares(replace(PLAIN, kind_floor=np.inf), [0.0, 0.4, 1.0]), 1 / 3, atol=0.015)


# --- reports and state -----------------------------------------------------------------


def test_levels_are_fractions_of_the_top():
    curriculum = Curriculum(3, 6, replace(PLAIN, num_levels=5), seed=0)
    curriculum.frontier[:] = [0, 3, 4]
    assert curriculum.levels().tolist() == [0.0, 0.75, 1.0]


def test_a_single_level_is_the_bottom():
    curriculum = Curriculum(2, 4, replace(PLAIN, num_levels=1), seed=0)
    np.testing.assert_array_equal(curriculum.next_course(np.arange(4), np.ones(4)), curriculum.kind)
    assert curriculum.levels().tolist() == [0.0, 0.0]
