import errno
import json
import os
import re
import subprocess
import sys
from dataclasses import fields

from agility_ref import __version__
from agility_ref.cli.main import COMMANDS, PLOTS, Command, main, options_of
from agility_ref.evaluate import METRICS
from agility_ref.files import read_npz, write_npz
from agility_ref.training.policies import POLICIES

import numpy as np
import pytest


@pytest.fixture(autouse=True)
def empty_folder(monkeypatch, tmp_path):
    """Work in an empty folder without shipped weights."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("agility_ref.training.weights.shipped", lambda *key: None)


@pytest.fixture
def refuses(capsys):
    """Return a function that runs a command and checks for one line and exit status 2."""

    def check(command, *expected):
        assert main(command.split()) == 2
        out, err = capsys.readouterr()
        assert err.startswith("agility-ref: ") and err.count("\n") == 1, err
        assert "Traceback" not in err and out == ""
        for text in expected:
            assert text in err
        return err

    return check


# --- bad input -------------------------------------------------------------------------


@pytest.mark.parametrize("command, expected", [
    ("trian walk", ["unknown command 'trian'", "did you mean train"]),
    ("train climb-upp", ["unknown policy 'climb-upp'", "climb-up"]),
    ("evaluate gen3 --environment gap", ["unknown policy 'gen3'", "gen-3"]),
    ("train walk --preset quik", ["unknown preset 'quik'", "quick"]),
    ("evaluate walk --environment gap --preset quik", ["unknown preset 'quik'", "quick"]),
    ("table1 --preset quik", ["unknown preset 'quik'", "quick"]),
    ("train walk --steps -5", ["steps", "-5"]),
    ("train oracle", ["oracle needs no training"]),
    ("evaluate walk --environment gap", ["no weights for walk", "agility-ref train walk"]),
    ("plot nowhere", ["nowhere", "progress.csv"]),
    ("table1 --seeds 0 x", ["seeds", "'0 x'", "all"]),
    ("table1 --protocol published", ["unknown protocol 'published'", "as-published"]),
    ("table1 --train --seeds all", ["--train", "numbers"]),
    ("table1 --findings --protocol as-published", ["--protocol complete"]),
])  # fmt: skip
def test_bad_input_is_one_line(refuses, command, expected):
    refuses(command, *expected)


@pytest.mark.parametrize("command, expected", [
    ("--environment gaps", ["unknown environment 'gaps'", "gap"]),
    ("--environment gap --episodes 0", ["episodes", "0"]),
    ("--environment gap --difficulty 1.5", ["difficulty", "1.5"]),
])  # fmt: skip
def test_bad_evaluations_are_one_line(refuses, tmp_path, finished_run, command, expected):
    finished_run(tmp_path, "walk")
    refuses(f"evaluate walk --runs {tmp_path} {command}", *expected)


def test_unknown_environment_is_named_without_weights(refuses):
    refuses("evaluate walk --environment gaps", "unknown environment 'gaps'")


def test_finished_run_in_the_way(refuses, tmp_path, finished_run):
    finished_run(tmp_path, "walk")
    refuses(f"train walk --out {tmp_path}", "finished run", "--overwrite")


def damage_missing(path):
    path.unlink()


def damage_truncated(path):
    path.write_bytes(path.read_bytes()[:200])


def damage_flipped(path):
    content = bytearray(path.read_bytes())
    for start in range(300, len(content) - 300, 500):
        content[start] ^= 0xFF
    path.write_bytes(content)


def damage_foreign(path):
    np.savez(path, weights=np.zeros(3))


def damage_text(path):
    path.write_text("hello\n")


@pytest.mark.parametrize(
    "damage", [damage_missing, damage_truncated, damage_flipped, damage_foreign, damage_text], ids=lambda f: f.__name__
)
def test_damaged_checkpoints_are_one_line(refuses, tmp_path, finished_run, damage):
    path = finished_run(tmp_path, "walk") / "policy.npz"
    damage(path)
    refuses(f"evaluate walk --environment gap --runs {tmp_path}", str(path))


def test_a_damaged_checkpoint_cannot_be_resumed(refuses, tmp_path, finished_run):
    folder = finished_run(tmp_path, "walk")
    (folder / "DONE").unlink()
    damage_truncated(folder / "policy.npz")
    refuses(f"train walk --out {tmp_path} --ppo.num-envs 2 --curriculum.num-levels 1", "policy.npz")


def test_a_checkpoint_of_another_shape(refuses, tmp_path, finished_run):
    finished_run(tmp_path, "walk", obs_dim=48)
    refuses(f"evaluate walk --environment gap --runs {tmp_path}", "48 -> 12")


def test_resuming_what_was_never_trained_here(refuses, tmp_path, finished_run):
    (finished_run(tmp_path, "walk") / "DONE").unlink()  # one hidden layer of 16 units
    (tmp_path / "walk" / "seed0" / "progress.csv").write_text("steps,wall_seconds\n")
    command = f"train walk --out {tmp_path} --ppo.hidden 16 --ppo.num-envs 2 --curriculum.num-levels 1 --steps 5000"
    refuses(command, "lacks the state")


def test_resuming_under_another_preset(refuses, tmp_path, finished_run):
    (finished_run(tmp_path, "walk", preset="quick") / "DONE").unlink()
    refuses(f"train walk --out {tmp_path} --ppo.num-envs 2 --curriculum.num-levels 1", "quick", "full")


# --- what works ------------------------------------------------------------------------


def test_no_command_prints_the_usage(capsys):
    assert main([]) == 2
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    assert all(command in out for command in COMMANDS)


def every_command():
    for name, entry in COMMANDS.items():
        yield from [f"{name} {kind}" for kind in entry] if entry is PLOTS else [name]


@pytest.mark.parametrize("name", list(every_command()))
def test_help_has_at_most_a_dozen_flags_and_two_examples(capsys, name):
    assert main([*name.split(), "--help"]) == 0
    out = capsys.readouterr().out
    flags = re.findall(r"^[│ ] --[a-z]", out, re.M)  # a terminal that knows ASCII alone gets no frames
    assert 1 <= len(flags) <= 12 or name in ("list", "plot run")
    assert not re.search(r"\bSTR\b", out)
    assert len(re.findall(r"^ +agility-ref \w", out, re.M)) == 2 or name == "list"


@pytest.mark.parametrize("name", ["train", "table1", "evaluate", "diagnose", "video"])
def test_help_all_has_every_flag(capsys, name):
    assert main([name, "--help-all"]) == 0
    out = capsys.readouterr().out
    for f in fields(COMMANDS[name].more()):
        assert f"--{f.name.replace('_', '-')}" in out


@pytest.mark.parametrize("name", ["evaluate", "diagnose", "video", "watch"])
def test_help_all_keeps_the_meaning_that_is_written_behind_a_flag(capsys, name):
    assert main([name, "--help-all"]) == 0
    assert "Training seed of the weights" in " ".join(capsys.readouterr().out.replace("│", " ").split())


@pytest.mark.parametrize("name", ["train", "table1", "evaluate", "diagnose", "video"])
def test_the_first_flags_have_the_defaults_of_the_configuration(name):
    command = COMMANDS[name]
    first, more = ({f.name: f.default for f in fields(kind)} for kind in (command.options, command.more()))
    if name == "table1":
        assert first.pop("seed") == 1  # the recipe was chosen on the courses of seed 0
    common = first.keys() & more.keys()
    assert common and all(first[key] == more[key] for key in common)
    assert issubclass(options_of(command, True), command.options)


def test_help_waits_for_no_library():
    for words in ("--help", "train --help", "plot strobe --help"):
        script = f"import sys; from agility_ref.cli.main import main; main({words.split()!r}); print(*sys.modules)"
        out = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
        assert not {"numpy", "torch", "mujoco", "matplotlib"} & set(out.split())


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"agility-ref {__version__}\n"


def test_completion_names_the_commands(capsys):
    assert main(["--tyro-print-completion", "bash"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in (*COMMANDS, *PLOTS))


def test_list_names_every_policy(capsys):
    assert main(["list"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in POLICIES)


@pytest.fixture
def short_episodes(monkeypatch):
    """Evaluate episodes of half a second, so that a test takes less."""
    from agility_ref import evaluate
    from agility_ref.env import EnvConfig

    original = evaluate.evaluation_env
    monkeypatch.setattr(
        evaluate,
        "evaluation_env",
        lambda environment, config, _: original(environment, config, EnvConfig(episode_seconds=0.5)),
    )


def test_evaluate_prints_one_json_object(capsys, tmp_path, finished_run, short_episodes):
    finished_run(tmp_path, "walk")
    assert main(f"evaluate walk --environment gap --episodes 2 --runs {tmp_path} --json".split()) == 0
    out = capsys.readouterr().out
    assert out.count("\n") == 1
    summary = json.loads(out)
    assert summary["policy"] == "walk" and summary["environment"] == "gap" and summary["episodes"] == 2
    for metric in METRICS:
        assert set(summary[metric]) == {"mean", "std"}


def test_evaluate_prints_the_four_metrics(capsys, tmp_path, finished_run, short_episodes):
    finished_run(tmp_path, "walk")
    assert main(f"evaluate walk --environment gap --episodes 2 --runs {tmp_path}".split()) == 0
    out = capsys.readouterr().out
    assert all(metric in out for metric in METRICS)


def test_train_prints_its_folder(capsys, tmp_path):
    command = (
        f"train walk --out {tmp_path} --steps 32 --ppo.num-envs 4 --ppo.num-steps 8 --ppo.hidden 8 "
        "--curriculum.num-levels 2 --curriculum.variants 1"
    )
    assert main(command.split()) == 0
    assert str(tmp_path / "walk" / "seed0") in capsys.readouterr().out
    assert main(f"plot {tmp_path / 'walk' / 'seed0'}".split()) == 0


def test_table1_with_nothing_trained_leaves_the_table_that_is_there(capsys, tmp_path):
    results = tmp_path / "results"
    results.mkdir()
    (results / "table1.csv").write_text("a table")
    (runs := tmp_path / "runs").mkdir()
    assert main(f"table1 --runs {runs} --results {results} --episodes 1".split()) == 2
    assert f"no runs in {runs}" in capsys.readouterr().err
    (runs / "walk" / "seed5").mkdir(parents=True)
    assert main(f"table1 --runs {runs} --results {results} --episodes 1".split()) == 2
    assert "not one cell to fill" in (err := capsys.readouterr().err) and "no weights for" in err
    assert (results / "table1.csv").read_text() == "a table" and len(list(results.iterdir())) == 1


def test_table1_of_several_seeds(capsys, tmp_path, finished_run, short_episodes):
    for seed in (0, 3):
        finished_run(tmp_path / "runs" / "full", "walk", seed)
    assert main("table1 --seeds all --findings --episodes 2".split()) == 0
    out = capsys.readouterr().out
    assert "4 of 43 cells filled" in out and "0, 3" in out and "NOT MEASURED: Curriculum is crucial." in out
    assert sorted(p.name for p in (tmp_path / "results").iterdir()) == [
        "cells", "findings.md", "table1.csv", "table1.md", "table1.png", "table1.svg", "table1.tex",
    ]  # fmt: skip
    assert len(list((tmp_path / "results" / "cells").glob("walk-*-seed[03].npz"))) == 8
    played = {path: path.stat().st_mtime_ns for path in (tmp_path / "results" / "cells").iterdir()}
    assert main("table1 --seeds 0,3 --episodes 2".split()) == 0
    assert {path: path.stat().st_mtime_ns for path in played} == played  # all found in results/cells


def test_table1_compares(capsys, tmp_path, finished_run, short_episodes):
    for name in ("walk", "leap"):
        finished_run(tmp_path / "runs" / "full", name)
    assert main("table1 --episodes 2 --compare walk leap".split()) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("walk - leap on")]
    assert [line.split()[4] for line in lines] == ["climb-gap", "gap", "beam", "climb"]
    assert all(line.endswith("seeds: 1") for line in lines)


@pytest.mark.parametrize("words, message", [
    ("--compare walk", "--compare needs two policies or more, not walk alone"),
    ("--compare walk lep", "unknown policy 'lep': did you mean leap"),
    ("--compare walk leap --protocol as-published", "episode by episode: --protocol complete, not as-published"),
])  # fmt: skip
def test_table1_refuses_what_it_cannot_compare(capsys, words, message):
    assert main(["table1", *words.split()]) == 2
    err = capsys.readouterr().err
    assert message in err and err.count("\n") == 1


def test_table1_as_published(capsys, tmp_path, finished_run, short_episodes):
    finished_run(tmp_path / "runs" / "full", "walk")
    assert main("table1 --episodes 2 --protocol as-published".split()) == 0
    out = capsys.readouterr().out
    assert "4 of 43 cells filled" in out and "interquartile" not in out
    assert "counted as-published" in (tmp_path / "results" / "table1.md").read_text()


def test_an_interrupted_table1_says_how_to_go_on(capsys, monkeypatch, tmp_path):
    def interrupted(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr("agility_ref.results.table1.compute", interrupted)
    assert main(["table1"]) == 130
    assert "the same command goes on from results/cells" in capsys.readouterr().err


def test_interrupting_exits_with_130(capsys, monkeypatch):
    def interrupted(options):
        raise KeyboardInterrupt("stopped at 5 of 10 steps")

    monkeypatch.setitem(COMMANDS, "train", Command(interrupted, COMMANDS["list"].options))
    assert main(["train"]) == 130
    assert capsys.readouterr().err == "agility-ref: stopped at 5 of 10 steps\n"


def test_our_own_mistakes_keep_their_traceback(monkeypatch):
    def broken(options):
        raise ValueError("a bug")

    monkeypatch.setitem(COMMANDS, "train", Command(broken, COMMANDS["list"].options))
    with pytest.raises(ValueError, match="a bug"):
        main(["train"])


def test_plot_says_of_what_there_is_nothing_to_draw(refuses, tmp_path):
    # The supervised selector's progress has other columns, of which nothing is drawn.
    (tmp_path / "progress.csv").write_text("round,states,epoch,cross_entropy\n0,100,0,0.5\n0,100,1,0.4\n")
    refuses(f"plot {tmp_path}", f"no returns to draw in {tmp_path}: learned by imitation")
    assert [path.name for path in tmp_path.iterdir()] == ["progress.csv"]
    refuses("plot run", "name at least one run folder")


def test_python_dash_m():
    """An unknown command, for which no library is imported."""
    done = subprocess.run([sys.executable, "-m", "agility_ref", "trian"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert done.stderr.startswith("agility-ref: unknown command 'trian': did you mean train")
    assert done.stderr.count("\n") == 1


def test_a_reader_that_has_seen_enough_gets_no_traceback():
    """As `agility-ref list | head -1` does it."""
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, "-m", "agility_ref", "list"], stdout=write, stderr=subprocess.PIPE, timeout=60
    )
    os.close(write)
    assert done.returncode == 1 and done.stderr == b""


def test_list_takes_no_more_words(capsys):
    assert main(["list", "walk"]) == 2
    assert "walk" in capsys.readouterr().err


def test_a_full_disk_is_one_line(monkeypatch, capsys):
    def full(options):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setitem(COMMANDS, "list", Command(full, COMMANDS["list"].options))
    assert main(["list"]) == 2
    assert capsys.readouterr().err == "agility-ref: No space left on device\n"


def test_a_table_is_refused_before_it_is_trained(monkeypatch, capsys):
    monkeypatch.setattr("agility_ref.results.table1.train_all", lambda *args: pytest.fail("trained"))
    assert main("table1 --train --episodes 0".split()) == 2
    assert "episodes must be a number of at least 1, not 0" in capsys.readouterr().err


@pytest.mark.parametrize("flags, message", [
    ("--ppo.num-envs 0", "num-envs must be a number of at least 1, not 0"),
    ("--ppo.num-envs 2 --ppo.num-steps 3 --ppo.num-minibatches 7", "num-minibatches must be at most 6 steps, not 7"),
    ("--ppo.hidden 64 7", "hidden must be one or more even numbers of units, for they come in pairs, not (64, 7)"),
    ("--supervised.hidden 64 7", "hidden must be one or more even numbers of units, for they come in pairs, not (64, 7)"),
    ("--ppo.hidden", "hidden must be one or more even numbers of units, for they come in pairs, not ()"),
    ("--distill.dagger-rounds -1", "dagger-rounds must be a number of at least 0, not -1"),
    ("--distill.batch-size 9223372036854775808", "batch-size must be at most 1.67772e+07, not 9223372036854775808"),
    ("--supervised.learning-rate -1", "learning-rate must be a number of at least 1e-09, not -1.0"),
    ("--fine-tune.std 0", "std must be a number of at least 1e-09, not 0.0"),
    ("--supervised.epochs 0", "epochs must be a number of at least 1, not 0"),
    ("--distill.batch-size 0", "batch-size must be a number of at least 1, not 0"),
    ("--seed 9223372036854775808", "seed must be at most 9.22337e+18, not 9223372036854775808"),
    ("--ppo.init-std nan", "init-std must be a number of at least 1e-09, not nan"),
    ("--ppo.learning-rate -1", "learning-rate must be a number of at least 1e-09, not -1.0"),
    ("--ppo.num-envs 9223372036854775807", "num-envs must be at most 1.67772e+07, not 9223372036854775807"),
    ("--env.push-interval 1e308", "push-interval must be at most 1e+06, not 1e+308"),
    ("--env.start-noise -1", "start-noise must be a number of at least 0, not -1.0"),
    ("--env.physics.kp nan", "kp must be a number of at least 0, not nan"),
    ("--curriculum.kind-floor 0", "kind-floor must be a number of at least 0.001, not 0.0"),
    ("--env.noise -1", "noise must be a number of at least 0, not -1.0"),
    ("--env.command-low 0.9 --env.command-high 0.8", "command-high must be a number of at least 0.9, not 0.8"),
    ("--env.physics.substeps 0", "substeps must be a number of at least 1, not 0"),
    ("--env.physics.timestep 0", "timestep must be a number of at least 1e-05, not 0.0"),
    ("--curriculum.variants 0", "variants must be a number of at least 1, not 0"),
    ("--seed -1", "seed must be a number of at least 0, not -1"),
    ("--steps -5", "steps must be a number of at least 0, not -5"),
    ("--warm-std nan", "warm-std must be a number of at least 1e-09, not nan"),
])  # fmt: skip
def test_settings_that_no_run_can_be_made_with_are_one_line(refuses, tmp_path, flags, message):
    assert refuses(f"train walk {flags}") == f"agility-ref: {message}\n"
    assert not list(tmp_path.iterdir())


def test_a_start_from_a_network_without_symmetry_is_one_line(refuses, tmp_path, finished_run):
    path = finished_run(tmp_path, "walk") / "policy.npz"
    arrays, meta = read_npz(path)
    dense = {name: array for name, array in arrays.items() if not name.startswith(("net.", "optimizer."))}
    write_npz(path, dense, {key: meta[key] for key in meta if key != "schema"})
    command = f"train climb --out {tmp_path} --ppo.hidden 16 --ppo.num-envs 2 --curriculum.num-levels 1"
    refuses(command, f"{path} holds a network of an older form; train walk anew, with --out")
