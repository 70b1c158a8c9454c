import pytest

from agility_ref import window
from agility_ref.errors import UserError
from agility_ref.evaluate import EvaluationConfig
from agility_ref.selector import Single, oracle_hierarchy
from agility_ref.viewer import Session
from agility_ref.window import DOWN, LEFT, SPACE, UP, press


@pytest.fixture
def session(five_skills):
    return Session(oracle_hierarchy("oracle", five_skills), "gap", EvaluationConfig(preset="quick", clean=True))


def test_keys_pause_and_choose(session):
    press(session, SPACE)
    assert session.paused
    press(session, ord("4"))
    session.step()
    assert (session.by_hand, session.skill) == (3, 3)
    press(session, ord("9"))  # no such skill
    assert session.by_hand == 3
    press(session, ord("0"))
    assert session.by_hand is None


def test_keys_change_the_course(session):
    number, difficulty = session.number, session.difficulty
    press(session, UP)
    assert session.number == number + 1
    assert session.difficulty == pytest.approx(difficulty + 0.04)  # a tenth of the preset's 0.4
    for _ in range(20):
        press(session, DOWN)
    assert session.difficulty == 0.0


def test_a_push_changes_the_velocity(session):
    before = session._qvel[0, 1]
    press(session, LEFT)
    assert session._qvel[0, 1] > before + 0.5


def test_no_display_is_one_line(monkeypatch, make_policy):
    monkeypatch.setattr(window, "has_display", lambda: False)
    with pytest.raises(UserError, match="browser"):
        window.show(Single("walk", make_policy(0, "walk")), "gap", EvaluationConfig())


@pytest.mark.skipif(not window.has_display(), reason="no display")
def test_the_window_opens_and_plays(make_policy):
    window.show(Single("walk", make_policy(0, "walk")), "gap", EvaluationConfig(preset="quick"), steps=5)
