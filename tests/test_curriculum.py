from dataclasses import replace

from agility_ref.curriculum import Curriculum, CurriculumConfig, level_difficulties, training_world
from agility_ref.terrain import beam_width

import numpy as np
import pytest

PLAIN = CurriculumConfig(num_levels=4, variants=1, promote=0.75, demote=0.4, easy_share=0.0)


def played(curriculum, ids, fraction):
    return curriculum.next_course(np.array(ids), np.array(fraction, float))


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


def test_robots_keep_their_kind_and_variant():
    # 12 robots in blocks: 3 kinds x 2 variants, two robots each
    curriculum = Curriculum(3, 12, CurriculumConfig(num_levels=4, variants=2), seed=0)
    rng = np.random.default_rng(0)
    for _ in range(50):
        courses = curriculum.next_course(np.arange(12), rng.random(12))
        np.testing.assert_array_equal(courses // (4 * 2), [0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2])
        np.testing.assert_array_equal(courses % 2, [0, 0, 1, 1] * 3)


def test_kinds_get_equal_shares():
    curriculum = Curriculum(5, 256, CurriculumConfig(variants=4), seed=0)
    assert np.ptp(np.bincount(curriculum.kind)) <= 1


def test_level_rises_falls_and_stays():
    curriculum = Curriculum(1, 4, PLAIN, seed=0)
    curriculum.level[:] = curriculum.played[:] = 1
    played(curriculum, [0, 1, 2, 3], [0.75, 0.39, 0.5, 1.0])  # at promote, below demote, between, completed
    np.testing.assert_array_equal(curriculum.level, [2, 0, 1, 3])


def test_levels_stay_in_range():
    curriculum = Curriculum(1, 2, PLAIN, seed=0)
    curriculum.level[:] = curriculum.played[:] = [3, 0]
    played(curriculum, [0, 1], [1.0, 0.0])
    np.testing.assert_array_equal(curriculum.level, [3, 0])


def test_only_the_robots_that_ended_move():
    curriculum = Curriculum(1, 3, PLAIN, seed=0)
    assert len(played(curriculum, [1], [0.8])) == 1
    np.testing.assert_array_equal(curriculum.level, [0, 1, 0])


def test_start_counts_as_no_episode():
    curriculum = Curriculum(1, 3, PLAIN, seed=0)
    courses = curriculum.next_course(np.arange(3), None)
    np.testing.assert_array_equal(courses, [0, 0, 0])
    np.testing.assert_array_equal(curriculum.level, [0, 0, 0])


def test_an_easier_episode_is_not_scored():
    curriculum = Curriculum(1, 1, PLAIN, seed=0)
    curriculum.level[:], curriculum.played[:] = 2, 1
    played(curriculum, [0], [1.0])
    assert curriculum.level[0] == 2


def test_easy_share_replays_easier_levels():
    curriculum = Curriculum(1, 1000, replace(PLAIN, easy_share=0.5), seed=0)
    curriculum.level[:] = 2
    courses = curriculum.next_course(np.arange(1000), None)
    # half of them on levels drawn from {0, 1, 2}: a third of that half is not easier
    assert (courses <= 2).all()
    assert (courses < 2).mean() == pytest.approx(0.5 * 2 / 3, abs=0.06)


def test_the_top_keeps_the_easy_levels_in_the_mix():
    curriculum = Curriculum(1, 1000, PLAIN, seed=0)
    curriculum.level[:] = 3
    courses = curriculum.next_course(np.arange(1000), None)
    assert set(courses) == {0, 1, 2, 3}


def test_disabled_draws_all_levels_alike():
    curriculum = Curriculum(1, 2000, replace(PLAIN, enabled=False), seed=0)
    courses = curriculum.next_course(np.arange(2000), np.zeros(2000))
    np.testing.assert_allclose(np.bincount(courses, minlength=4) / 2000, 0.25, atol=0.05)


def test_mean_levels_are_those_of_each_kind():
    curriculum = Curriculum(3, 6, replace(PLAIN, num_levels=5, variants=1), seed=0)
    assert curriculum.kind.tolist() == [0, 0, 1, 1, 2, 2]
    curriculum.level[:] = [0, 4, 2, 2, 4, 3]
    assert curriculum.mean_levels().tolist() == [0.5, 0.5, 0.875]  # of 4 steps up: 2/4, 2/4, 3.5/4
    assert curriculum.mean_level() == 2.5 / 4


def test_mean_level_is_a_fraction_of_the_top():
    curriculum = Curriculum(1, 2, PLAIN, seed=0)
    curriculum.level[:] = [0, 3]
    assert curriculum.mean_level() == 0.5


def test_state_round_trip():
    a, b = (Curriculum(2, 6, PLAIN, seed) for seed in (0, 1))
    a.level[:] = [0, 1, 2, 3, 2, 1]
    state = a.state()
    a.level[:] = 0
    b.load_state(state)
    np.testing.assert_array_equal(b.level, [0, 1, 2, 3, 2, 1])


@pytest.mark.parametrize("fraction, level", [(0.75, 3), (0.74, 2), (0.4, 2), (0.39, 1), (1.0, 4)])
def test_thresholds_count_as_reached(fraction, level):
    curriculum = Curriculum(1, 1, replace(PLAIN, num_levels=10), seed=0)
    curriculum.level[:] = curriculum.played[:] = 2
    played(curriculum, [0], [fraction])
    assert curriculum.level[0] == level


def test_half_of_the_episodes_at_the_top_are_on_a_level_drawn_from_all():
    curriculum = Curriculum(1, 2000, replace(PLAIN, num_levels=10), seed=0)
    curriculum.level[:] = curriculum.played[:] = 9
    played(curriculum, np.arange(2000), np.full(2000, 0.5))
    assert np.mean(curriculum.played == 9) == pytest.approx(0.55, abs=0.04)  # 1/2, and 1/10 of the rest


def test_every_course_is_drawn_anew():
    world = training_world(("gap", "climb-gap"), CurriculumConfig(num_levels=3, variants=2), 1.0, seed=0)
    assert len({c.waypoints[:, 1].tobytes() for c in world.courses}) == len(world)


@pytest.mark.parametrize("easy, top, share", [(0.0, 0.0, 0.0), (0.0, 0.5, 0.5), (0.5, 0.5, 0.75)])
def test_shares_of_easier_episodes_at_the_top(easy, top, share):
    """1 - (1 - easy) (1 - top), of which a quarter draws the top level of four itself."""
    curriculum = Curriculum(1, 4000, replace(PLAIN, easy_share=easy, top_easy_share=top), seed=0)
    curriculum.level[:] = 3
    courses = curriculum.next_course(np.arange(4000), None)
    assert (courses < 3).mean() == pytest.approx(0.75 * share, abs=0.025)
