import json
from dataclasses import replace

from agility_ref import evaluate
from agility_ref.cli.main import main
from agility_ref.env import EnvConfig
from agility_ref.observation import NUM_SCANDOTS
from agility_ref.results import diagnosis
from agility_ref.results.diagnosis import (
    OFFSETS,
    abandoned_leap,
    confusion,
    diagnose,
    duration,
    inside,
    mean_interval,
    nearest_obstacle,
    odd_behaviours,
    odd_marks,
    onsets,
    passes,
    profile,
    regret,
    wrong_share,
)
from agility_ref.terrain import SKILLS, Obstacle, make_course

import numpy as np
import pytest
from PIL import Image

# Five steps of two episodes, the second of three: skill chosen, skill the oracle wanted.
CHOSEN = np.array([[0, 3], [0, 3], [3, 0], [3, -1], [1, -1]])
WANTED = np.array([[0, 0], [3, 3], [3, 0], [3, -1], [3, -1]])


@pytest.fixture
def hand_made(make_episode):
    """Return a function that makes episodes from columns; a skill of -1 is after the end."""

    def make(x, chosen=CHOSEN, wanted=WANTED, obstacles=(), reached=(0, 0)):
        return [
            make_episode(np.array(x)[c >= 0, n], c[c >= 0], w[c >= 0], obstacles=obstacles, reached=reached[n])
            for n, (c, w) in enumerate(zip(np.array(chosen).T, np.array(wanted).T, strict=True))
        ]

    return make


ONES = np.ones((5, 2))


# --- choices ---------------------------------------------------------------------------


def test_confusion_by_hand(hand_made):
    counts = confusion(hand_made(ONES))
    # wanted 0: chosen 0, 0 (end of the second), and 3 once; wanted 3: chosen 0, 3, 3, 1, and 3 once
    expected = np.zeros((5, 5), int)
    expected[0, 0], expected[0, 3] = 2, 1
    expected[3, 0], expected[3, 1], expected[3, 3] = 1, 1, 3
    np.testing.assert_array_equal(counts, expected)
    assert counts.sum() == (CHOSEN >= 0).sum()


def test_confusion_of_a_perfect_selector_is_diagonal(hand_made):
    counts = confusion(hand_made(ONES, WANTED, WANTED))
    np.testing.assert_array_equal(counts, np.diag(np.diag(counts)))


def test_regret_is_paired(hand_made):
    # 0.5 - 0.25 and 0.75 - 0.5: always 0.25, so nothing is left to resample
    own, oracle = hand_made(ONES, reached=(2, 4)), hand_made(ONES, reached=(4, 6))
    assert regret(own, oracle) == {"mean": 0.25, "low": 0.25, "high": 0.25}
    assert regret(oracle, own)["mean"] == -0.25
    assert regret(own, own) == {"mean": 0.0, "low": 0.0, "high": 0.0}


def test_mean_interval_holds_the_mean():
    interval = mean_interval(np.arange(20.0))
    assert interval["mean"] == 9.5 and 4 < interval["low"] < 9.5 < interval["high"] < 15


# --- places ----------------------------------------------------------------------------


def test_nearest_obstacle_by_hand(make_episode):
    obstacles = (Obstacle(3.0, 3.0, "climb-up"), Obstacle(5.0, 6.0, "leap"))
    x = [1.0, 4.1, 6.5, 3.5, 5.5, 3.0]
    offset, kind = nearest_obstacle(make_episode(x, [0] * 6, [0] * 6, obstacles=obstacles))
    # to the step: 2, 1.1, 3.5, 0.5, 2.5, 0 m; to the gap: 4, 0.9, 0.5, 1.5, 0 (inside), 2
    np.testing.assert_allclose(offset, [-2.0, -0.9, 1.5, 0.5, 0.5, 0.0])
    np.testing.assert_array_equal(kind, [1, 3, 3, 1, 3, 1])


def test_no_obstacles_no_places(hand_made):
    played = hand_made(ONES)
    assert np.isnan(nearest_obstacle(played[0])[0]).all()
    assert np.isnan(wrong_share(played)).all()


def test_profile_by_hand(make_episode):
    obstacles = (Obstacle(9.0, 9.0, "climb-up"), Obstacle(5.0, 5.0, "leap"))
    episode = make_episode([4.5, 5.5, 5.5, 9.7], [0] * 4, [0] * 4, obstacles=obstacles)
    counts = profile(episode, np.ones(4, bool), np.array([-1.0, 0.0, 1.0]))
    np.testing.assert_array_equal(counts, [[0, 0], [0, 1], [0, 0], [1, 2], [0, 0]])
    assert profile(episode, np.zeros(4, bool)).sum() == 0


def test_a_robot_that_stands_counts_once(hand_made):
    # Both come to x = 5.05: one stands there wrong for three steps, the other passes and is right.
    # The first was right before, at x = 4.95, where it was alone.
    x = np.array([[4.95, 5.05], [5.05, 9.0], [5.05, 9.0], [5.05, 9.0]])
    chosen, wanted = np.array([[3, 3], [0, -1], [0, -1], [0, -1]]), np.array([[3, 3], [3, -1], [3, -1], [3, -1]])
    share = wrong_share(hand_made(x, chosen, wanted, [Obstacle(5.0, 5.5, "leap")]))
    here = np.searchsorted(OFFSETS, [-0.05, 0.05]) - 1
    np.testing.assert_allclose(share[3, here], [0.0, 0.5])  # (3 / 3 + 0 / 1) / 2
    assert np.isfinite(share).sum() == 2


# --- everything ------------------------------------------------------------------------


@pytest.fixture
def played(make_episode):
    """Two environments of real courses, three episodes each, with paths drawn by hand."""
    rng = np.random.default_rng(0)
    found = []
    for kind in ("climb-gap", "beam"):
        found.append([])
        for n, steps, end in ((0, 40, 8), (1, 30, 6), (2, 40, 9)):
            skill, oracle = rng.integers(0, 5, (2, steps))
            course = make_course(kind, 0.5, n)
            found[-1].append(make_episode(np.linspace(1, end, steps), skill, oracle, course=course, reached=n))
            found[-1][-1].qpos[:, 1] = rng.normal(0, 0.1, steps)
    return found


def test_diagnosis_is_json_ready_and_adds_up(played):
    episodes = played[0]
    report = diagnose(episodes, episodes, episodes)
    assert json.loads(json.dumps(report, allow_nan=False)) == report
    counts = np.array(report["confusion"])
    assert counts.sum() == report["environment_steps"] == 30 + 40 + 40
    wrong, steps = np.array(report["places"]["wrong"]), np.array(report["places"]["steps"])
    assert (wrong <= steps).all() and 0 < wrong.sum() <= counts.sum() - np.trace(counts)
    assert report["regret"]["mean"] == 0.0
    assert report["commonest"]["share"] == pytest.approx(counts.sum(axis=0).max() / 110)


@pytest.mark.parametrize("draw", ["confusion_figure", "timeline_figure", "mistakes_figure"])
def test_figures_are_drawn(played, draw, tmp_path):
    from agility_ref.pictures.plots import save_figure

    for some in (played, played[:1]):
        png, svg = save_figure(getattr(diagnosis, draw)(some), tmp_path / f"{draw}.png", "test")
        assert Image.open(png).size[0] > 400 and svg.stat().st_size > 1000


def test_the_course_drawn_is_the_one_with_the_widest_mistakes(played):
    episodes = played[0]
    for e in episodes:
        e.skill[:], e.wanted[:] = 0, 0
    episodes[0].skill[:20] = 1  # over half of the path
    episodes[2].skill[:] = 1
    episodes[2].qpos[:, 0] = 3.0  # it stands
    assert diagnosis.widest_mistakes(episodes) == 0


# --- the command -----------------------------------------------------------------------


@pytest.fixture
def weights(monkeypatch, tmp_path, finished_run):
    """Random skills and selectors, and episodes of half a second."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("agility_ref.training.weights.shipped", lambda *key: None)
    for skill in (*SKILLS, "climb"):
        finished_run(tmp_path / "runs", skill)
    finished_run(tmp_path / "runs", "ps-sl-5", obs_dim=NUM_SCANDOTS, act_dim=5)
    finished_run(tmp_path / "runs", "ps-rl-3-oracle", act_dim=3)
    original = evaluate.evaluation_env
    short = EnvConfig(episode_seconds=0.6)
    monkeypatch.setattr(diagnosis, "evaluation_env", lambda environment, config: original(environment, config, short))


@pytest.mark.parametrize("policy, skills", [("oracle", 5), ("ps-sl-5", 5), ("ps-rl-3", 3)])
def test_diagnose_prints_one_json_object(weights, capsys, policy, skills, tmp_path):
    assert main(f"diagnose {policy} --environment gap beam --episodes 2 --runs runs --json".split()) == 0
    out = capsys.readouterr().out
    assert out.count("\n") == 1
    report = json.loads(out)
    assert [e["environment"] for e in report["environments"]] == ["gap", "beam"]
    for one in report["environments"]:
        assert len(one["skills"]) == skills and one["episodes"] == 2 and one["environment_steps"] == 2 * 15
        assert one["accuracy"]["mean"] == 1.0 if policy == "oracle" else one["accuracy"]["mean"] <= 1.0
    assert len(report["figures"]) == 6 and all((tmp_path / name).is_file() for name in report["figures"])


def test_diagnose_prints_a_report(weights, capsys):
    assert main("diagnose ps-sl-5 --environment climb --episodes 2 --runs runs".split()) == 0
    out = capsys.readouterr().out
    for text in ("accuracy", "switches", "commonest skill", "regret", "abandoned leap", "kicked back", "results/"):
        assert text in out


@pytest.mark.parametrize("command, expected", [
    ("walk", ["walk chooses between no skills", "oracle", "ps-sl-5"]),
    ("gen-3", ["gen-3 chooses between no skills"]),
    ("ps-sl-6", ["unknown policy 'ps-sl-6'", "ps-sl-5"]),
    ("oracle --environment gaps", ["unknown environment 'gaps'"]),
    ("oracle --episodes 0", ["episodes", "0"]),
    ("oracle --protocol as-published", ["as-published"]),
    ("ps-rl-3-env --environment gap --episodes 1 --runs nowhere", ["no folder of runs at nowhere"]),
])  # fmt: skip
def test_bad_input_is_one_line(weights, capsys, command, expected):
    assert main(["diagnose", *command.split()]) == 2
    out, err = capsys.readouterr()
    assert err.startswith("agility-ref: ") and err.count("\n") == 1 and out == ""
    for text in expected:
        assert text in err


def test_diagnosis_by_hand(hand_made):
    report = diagnose(hand_made(ONES, reached=(2, 4)), hand_made(ONES, reached=(8, 8)), hand_made(ONES, reached=(4, 4)))
    # right in steps 0, 2, 3 of 5, and in steps 1, 2 of 3
    assert report["accuracy"]["mean"] == pytest.approx((3 / 5 + 2 / 3) / 2)
    # 0 0 3 3 1 and 3 3 0: two changes in 0.1 s, one in 0.06 s;  wanted 0 3 3 3 3 and 0 3 0: one and two
    assert report["switches_per_second"]["mean"] == pytest.approx((2 / 0.1 + 1 / 0.06) / 2)
    assert report["wanted_switches_per_second"]["mean"] == pytest.approx((1 / 0.1 + 2 / 0.06) / 2)
    # leap acts in 4 of 8 steps and is wanted in 5
    assert report["commonest"] == {"skill": "leap", "share": 0.5, "wanted_share": 0.625}
    assert report["regret"]["mean"] == 0.625 and report["regret_same_skills"]["mean"] == 0.125


def test_a_long_obstacle_is_near_along_its_whole_span(make_episode):
    obstacles = (Obstacle(5.0, 6.0, "leap"), Obstacle(6.5, 6.5, "climb-up"))
    offset, kind = nearest_obstacle(make_episode([5.9, 6.4], [0, 0], [0, 0], obstacles=obstacles))
    np.testing.assert_allclose(offset, [0.9, -0.1])  # in the gap, though the step is nearer than the gap's beginning
    np.testing.assert_array_equal(kind, [3, 1])


W, U, D, L, B = range(5)  # walk, climb-up, climb-down, leap, beam

# --- odd behaviours: detectors by hand, steps of 0.02 s ----------------------------


def test_onsets_and_duration_of_runs():
    mask = np.array([1, 1, 0, 0, 1, 0, 1, 1, 1], bool)
    np.testing.assert_array_equal(onsets(mask), [1, 0, 0, 0, 1, 0, 1, 0, 0])
    np.testing.assert_array_equal(duration(mask), [1, 2, 0, 0, 1, 0, 1, 2, 3])


def test_inside_takes_any_of_the_spans():
    spans = np.array([[1.0, 2.0], [4.0, 5.0]])
    np.testing.assert_array_equal(inside(np.array([0.9, 1.0, 3.2, 4.5]), spans), [0, 1, 0, 1])
    assert not inside(np.array([0.9]), np.zeros((0, 2))).any()


@pytest.mark.parametrize("skills, pit, expected", [
    ([W, L, L, U, U, W], None, 3),  # leapt for 2 steps, then climbs: abandoned
    ([W, L, U, U, U, W], None, None),  # one step of leap is a flicker
    ([L, L, L, L, U, U], None, None),  # after 4 steps the leap may be over ...
    ([L, L, L, L, U, U], 4, 4),  # ... but not above a pit
    ([L, L, L, L, U, U], 5, None),  # the pit comes too late: climb-up acts already
    ([W, L, L, W, U, U], None, None),  # walk came between
    ([W, L, L, D, D, D], None, None),  # climbing down is no fake
    ([W, L, L], None, None),  # the episode ended
])  # fmt: skip
def test_abandoned_leap(skills, pit, expected):
    over_pit = np.zeros(len(skills), bool)
    if pit is not None:
        over_pit[pit:] = True
    found = abandoned_leap(np.array(skills), over_pit, L, U, begun=2, over=3)
    np.testing.assert_array_equal(np.flatnonzero(found), [] if expected is None else [expected])


def test_passing_an_edge_is_forwards():
    x = np.array([0.8, 0.95, 1.05, 0.9, 1.0, 0.5])
    # 0.95 -> 1.05 and 0.9 -> 1.0; back is no passing
    np.testing.assert_array_equal(np.flatnonzero(passes(x, np.array([1.0]))), [1, 3])


@pytest.mark.parametrize("skill, expected", [
    ([L, L, W, W, W, W], [1]),  # leaps off, comes back, walks off
    ([W, W, L, L, L, L], [3]), ([D, D, L, W, D, D], []),
])  # fmt: skip
def test_leapt_down(make_episode, skill, expected):
    x = [0.8, 0.95, 1.05, 0.9, 1.1, 1.2]
    marks = odd_marks(make_episode(x, skill, skill, obstacles=[Obstacle(1.0, 1.0, "climb-down")]))
    np.testing.assert_array_equal(np.flatnonzero(marks["leapt_down"][0]), expected)


def test_kicked_back_needs_to_be_near_and_faster_than_a_push(make_episode):
    x, vx = [1.5, 1.5, 1.0, 1.5, 1.5], [-0.6, -0.4, -0.6, 0.9, -2.0]  # 1.0 is not within 0.6 m of the step at 2.0
    marks = odd_marks(make_episode(x, [B] * 5, [B] * 5, vx=vx, obstacles=[Obstacle(2.0, 2.0, "climb-up")]))
    np.testing.assert_array_equal(marks["kicked_back"][0], [1, 0, 0, 0, 1])


@pytest.fixture
def one_of_each(make_episode):
    """One episode: a leap given up for climb-up, a kick before the up-step at 2 m, a leap off the one at 3 m."""
    obstacles = (Obstacle(2.0, 2.0, "climb-up"), Obstacle(3.0, 3.0, "climb-down"))
    chosen = [L] * 6 + [U] * 2 + [B] * 3 + [W] + [L] * 2
    x = [1.0] * 6 + [1.1] * 2 + [1.5, 1.5, 1.4] + [1.45] + [2.95, 3.1]
    vx = [0.5] * 8 + [0.3, -0.9, -0.8] + [0.5] + [2.0, 2.0]
    return lambda skills=SKILLS: make_episode(x, chosen, chosen, vx=vx, obstacles=obstacles, skills=skills)


def test_a_hand_made_episode_has_one_of_each(one_of_each):
    assert odd_behaviours([one_of_each()]) == {
        # six steps of leap are 0.12 s: begun, and not yet over
        "abandoned_leap": {"events": 1, "episodes": 1, "chances": 1},
        # the robot is between 2.95 and 3.1 m under leap
        "leapt_down": {"events": 1, "episodes": 1, "chances": 1},
        # x = 1.5, 1.5, 1.4, 1.45 lie in the 0.6 m before 2 m: one approach, on the beam policy
        "beam_before_up_step": {"events": 1, "episodes": 1, "chances": 1},
        # -0.9 and -0.8 m/s are one kick
        "kicked_back": {"events": 1, "episodes": 1, "chances": 1},
    }


def test_what_a_policy_lacks_is_none(one_of_each):
    found = odd_behaviours([one_of_each(("walk", "climb", "stand", "leap", "sit"))])
    assert found["beam_before_up_step"] is None and found["kicked_back"] is None
    assert found["abandoned_leap"]["events"] == 1  # its one skill for climbing counts as climb-up


def test_two_events_of_one_episode(one_of_each):
    """The hand-made episode twice over within one, and a down-step that is walked."""
    one = one_of_each()
    twice = {name: np.concatenate([getattr(one, name)] * 2) for name in ("skill", "wanted", "qpos", "qvel")}
    twice["skill"][26:28] = W  # the second time it walks off
    found = odd_behaviours([replace(one, **twice), one])
    assert found["abandoned_leap"] == {"events": 3, "episodes": 2, "chances": 3}
    assert found["leapt_down"] == {"events": 2, "episodes": 2, "chances": 3}
    assert found["beam_before_up_step"] == {"events": 3, "episodes": 2, "chances": 3}
