"""The command line: ``agility-ref train | evaluate | table1 | plot | video | watch | list``.

Every hyper-parameter is a flag, because every configuration is a frozen dataclass that
tyro reads; the help text is the docstring of the field.  A mistake of the user prints one
line and exits with status 2.
"""

import json
import shlex
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from agility_ref.errors import UserError, unknown_name

USAGE = """usage: agility-ref COMMAND [--help]

  train POLICY                       train a policy (and what it needs)
  evaluate POLICY --environment E    the four metrics of Table 1
  table1                             all 43 cells beside the paper's
  plot KIND                          curves, strobe, oracle-map, episode, courses, skills, framework
  video POLICY --environment E       an episode as WebP, GIF or MP4
  watch POLICY --environment E       a live view in the browser
  list                               policies, environments, presets, weights
"""


def train(argv: list[str]) -> None:
    """Train one policy."""
    from agility_ref.runs import TrainConfig, train_policy

    @dataclass(frozen=True)
    class Train:
        """Train a policy, and first whatever it needs: its warm start, its skills."""

        policy: tyro.conf.Positional[str]
        """See `agility-ref list`."""
        config: Annotated[TrainConfig, tyro.conf.arg(name="")] = field(default_factory=TrainConfig)

    args = tyro.cli(Train, args=argv, prog="agility-ref train")
    print(f"done: {train_policy(args.policy, args.config)}")


def evaluate(argv: list[str]) -> None:
    """Evaluate one policy on one environment."""
    from agility_ref.evaluate import METRICS, EvaluationConfig, evaluation_world
    from agility_ref.evaluate import evaluate as run
    from agility_ref.runs import TrainConfig, load_policy

    @dataclass(frozen=True)
    class Evaluate:
        """Play complete episodes with the deterministic policy; noise and pushes on."""

        policy: tyro.conf.Positional[str]
        """See `agility-ref list`."""
        environment: str
        """climb-gap, gap, beam or climb; or a training course: walk, climb-up, climb-down."""
        config: Annotated[EvaluationConfig, tyro.conf.arg(name="")] = field(default_factory=EvaluationConfig)
        train_seed: int = 0
        """Training seed of the weights."""
        out: str = ""
        """Folder of runs to look in before the shipped weights; runs/<preset> by default."""
        json: bool = False
        """Print one JSON object."""

    args = tyro.cli(Evaluate, args=argv, prog="agility-ref evaluate")
    evaluation_world(args.environment, args.config)  # named before the weights are looked for
    training = TrainConfig(preset=args.config.preset, seed=args.train_seed, out=args.out)
    summary = run(load_policy(args.policy, training), args.environment, args.config).summary()
    if args.json:
        print(json.dumps(summary))
        return
    print(f"{args.policy} on {args.environment}: {summary['episodes']} episodes, {summary['environment_steps']} steps")
    for metric in METRICS:
        print(f"  {metric:18} {summary[metric]['mean']:8.3f} ± {summary[metric]['std']:.3f}")
    print(f"  {'falls':18} {summary['falls']:8.3f}")


def table1(argv: list[str]) -> None:
    """Compute Table 1."""
    from agility_ref import table1 as table
    from agility_ref.evaluate import EvaluationConfig
    from agility_ref.runs import TrainConfig

    @dataclass(frozen=True)
    class Table1:
        """Evaluate every policy on every terrain and print the table beside the paper's."""

        config: Annotated[EvaluationConfig, tyro.conf.arg(name="")] = field(default_factory=EvaluationConfig)
        train: bool = False
        """Train every policy first, from scratch; finished runs in --out are kept."""
        train_seed: int = 0
        """Training seed of the weights."""
        out: str = ""
        """Folder of runs; runs/<preset> by default."""
        results: str = "results"
        """Folder for table1.csv, table1.md and table1.png."""

    args = tyro.cli(Table1, args=argv, prog="agility-ref table1")
    training = TrainConfig(preset=args.config.preset, seed=args.train_seed, out=args.out)
    if args.train:
        table.train_all(training)

    def on_cell(environment: str, policy: str) -> None:
        print(f"\revaluating {policy} on {environment}" + " " * 20, end="", file=sys.stderr, flush=True)

    cells, missing = table.compute(args.config, training, on_cell)
    print("\r" + " " * 60 + "\r", end="", file=sys.stderr)
    print(table.text(cells))
    for line in missing:
        print(f"missing: {line}")
    filled = sum(cell["ours"] is not None for cell in cells.values())
    title = (
        f"Table 1, preset {args.config.preset}, {args.config.episodes} episodes a cell, training seed {args.train_seed}"
    )
    paths = table.write_all(cells, Path(args.results), title)
    print(f"{filled} of {len(cells)} cells filled; mean ± std over episodes; wrote {', '.join(map(str, paths))}")


@dataclass(frozen=True)
class Play:
    """What is played: the options that every picture of an episode shares."""

    policy: tyro.conf.Positional[str]
    """See `agility-ref list`."""
    environment: str
    """climb-gap, gap, beam or climb; or a training course: walk, climb-up, climb-down."""
    out: str = ""
    """File to write; by default a name made of the command, the policy and the environment."""
    preset: str = "full"
    """quick draws d ~ U(0, 0.4), full U(0, 1); also names the weights."""
    difficulty: float | None = None
    """Fixes the difficulty of all courses, 0 to 1."""
    seed: int = 0
    """Seed of courses, starts, commands, noise and pushes."""
    clean: bool = False
    """Turn noise, pushes, payload and friction differences off."""
    course: int = 0
    """Which course of that seed, counted from 0."""
    train_seed: int = 0
    """Training seed of the weights."""
    runs: str = ""
    """Folder of runs to look in before the shipped weights; runs/<preset> by default."""

    def path(self, what: str, suffix: str) -> Path:
        """Return the file to write."""
        return Path(self.out or f"{what}-{self.policy}-{self.environment}{suffix}")

    def load(self):
        """Return the policy and the evaluation's configuration."""
        from agility_ref.evaluate import EvaluationConfig
        from agility_ref.runs import TrainConfig, load_policy

        config = EvaluationConfig(seed=self.seed, preset=self.preset, difficulty=self.difficulty, clean=self.clean)
        return load_policy(self.policy, TrainConfig(preset=self.preset, seed=self.train_seed, out=self.runs)), config

    def record(self, courses: int = 1, robots: int = 1) -> list:
        """Play and return the episodes."""
        from agility_ref.record import record

        policy, config = self.load()
        numbers = tuple(range(self.course, self.course + courses))
        return record(policy, self.environment, config, numbers, robots)


def _save(figure, out: Path, argv: list[str]) -> None:
    from agility_ref.plots import save_figure

    print(", ".join(map(str, save_figure(figure, out, shlex.join(["agility-ref", *argv])))))


def plot_runs(argv: list[str]) -> None:
    """Draw learning_curve.png in each run folder, as training does."""
    from agility_ref.plots import learning_curve

    for run in map(Path, argv):
        if not (run / "progress.csv").is_file():
            raise UserError(f"{run} is no picture ({', '.join(PLOTS)}) and holds no progress.csv")
        if learning_curve(run / "progress.csv", run / "learning_curve.png", run.parent.name):
            print(run / "learning_curve.png")


def plot_curves(argv: list[str]) -> None:
    """Draw learning curves."""
    from agility_ref.plots import learning_curves, read_progress

    @dataclass(frozen=True)
    class Curves:
        """Compare runs: a thin line a seed, a bold IQM, a 95 % band, wall time above."""

        runs: tyro.conf.Positional[tuple[str, ...]]
        """Run folders, such as runs/full/leap/seed0; seeds of one policy are drawn together."""
        out: str = "curves.png"
        """File to write."""
        evaluate: str = ""
        """Also evaluate each finished run on this environment, without exploration: diamonds."""
        episodes: int = 32
        """Episodes of each of these evaluations; usual 16 to 64."""

    args = tyro.cli(Curves, args=argv[2:], prog="agility-ref plot curves")
    if not args.runs:
        raise UserError("name at least one run folder")
    found: dict[str, list[Path]] = {}
    points: dict[str, list[dict]] = {}
    for run in map(Path, args.runs):
        if not (run / "progress.csv").is_file():
            raise UserError(f"{run} holds no progress.csv")
        if "waypoint_fraction" not in read_progress(run / "progress.csv"):
            raise UserError(f"{run} was trained by supervision: it has no returns to draw")
        found.setdefault(run.parent.name, []).append(run / "progress.csv")
        if args.evaluate:
            points.setdefault(run.parent.name, []).append(_evaluation_point(run, args.evaluate, args.episodes))
    _save(learning_curves(found, points), Path(args.out), argv)


def _evaluation_point(run: Path, environment: str, episodes: int) -> dict:
    """Evaluate the policy in a run folder; return its steps and its mean metrics."""
    from agility_ref.checkpoint import Policy
    from agility_ref.evaluate import METRICS, EvaluationConfig, evaluate
    from agility_ref.selector import Single

    policy = Policy.load(run / "policy.npz")
    config = EvaluationConfig(episodes=episodes, preset=policy.meta.get("preset", "full"))
    result = evaluate(Single(policy.name, policy), environment, config)
    return {"steps": policy.meta["steps"], **{m: float(getattr(result, m).mean()) for m in METRICS}}


def plot_strobe(argv: list[str]) -> None:
    """Draw a strobe picture."""
    from agility_ref.pictures import strobe

    @dataclass(frozen=True)
    class Strobe(Play):
        """Side view to scale: the robot at regular instants, contacts, violated edges, skills."""

        period: float = 0.7
        """Time between two drawings of the robot [s]; usual 0.3 to 1."""

    args = tyro.cli(Strobe, args=argv[2:], prog="agility-ref plot strobe")
    _save(strobe(args.record()[0], args.period), args.path("strobe", ".png"), argv)


def plot_oracle_map(argv: list[str]) -> None:
    """Draw the oracle policy map."""
    from agility_ref.pictures import oracle_map

    @dataclass(frozen=True)
    class OracleMap(Play):
        """Courses from above: height, skill regions, waypoints, robots with trails (the paper's Fig. 3)."""

        courses: int = 3
        """How many courses; usual 1 to 5."""
        robots: int = 8
        """Robots on each; usual 1 to 20."""

    args = tyro.cli(OracleMap, args=argv[2:], prog="agility-ref plot oracle-map")
    if args.courses < 1 or args.robots < 1:
        raise UserError("--courses and --robots must be at least 1")
    _save(oracle_map(args.record(args.courses, args.robots)), args.path("oracle-map", ".png"), argv)


def plot_episode(argv: list[str]) -> None:
    """Draw the episode panel."""
    from agility_ref.panels import episode_panel

    @dataclass(frozen=True)
    class Panel(Play):
        """Foot contacts, waypoints, heading error, reward terms, joint angles and torques."""

        start: float | None = None
        """Where the window of the joint panels begins [s]; the middle of the episode by default."""
        seconds: float = 3.0
        """Its length [s]."""

    args = tyro.cli(Panel, args=argv[2:], prog="agility-ref plot episode")
    _save(episode_panel(args.record()[0], args.seconds, args.start), args.path("episode", ".png"), argv)


def plot_courses(argv: list[str]) -> None:
    """Draw the course gallery."""
    from agility_ref.gallery import course_gallery

    @dataclass(frozen=True)
    class Courses:
        """Draw the seven kinds of course at d = 0, 0.3, 0.6 and 1, dimensions in metres."""

        out: str = "courses.png"
        """File to write."""
        seed: int = 3
        """Seed of the courses."""

    args = tyro.cli(Courses, args=argv[2:], prog="agility-ref plot courses")
    _save(course_gallery(seed=args.seed), Path(args.out), argv)


def plot_skills(argv: list[str]) -> None:
    """Draw the paper's Fig. 1."""
    from agility_ref.gallery import skills_figure

    @dataclass(frozen=True)
    class Skills:
        """Draw the five specialists at work, the paper's Fig. 1."""

        out: str = "skills.png"
        """File to write."""
        preset: str = "full"
        """Names the weights."""
        difficulty: float = 0.3
        """Of the courses, 0 to 1."""
        runs: str = ""
        """Folder of runs to look in before the shipped weights; runs/<preset> by default."""

    args = tyro.cli(Skills, args=argv[2:], prog="agility-ref plot skills")
    courses = {"climb-down": "climb-down", "climb-up": "climb-up", "walk": "walk", "leap": "gap", "beam": "beam"}
    common = {"preset": args.preset, "difficulty": args.difficulty, "runs": args.runs, "clean": True}
    episodes = {skill: Play(skill, course, **common).record()[0] for skill, course in courses.items()}
    _save(skills_figure(episodes), Path(args.out), argv)


def plot_framework(argv: list[str]) -> None:
    """Draw the paper's Fig. 2."""
    from agility_ref.gallery import framework_figure

    @dataclass(frozen=True)
    class Framework:
        """Draw the selector framework, the paper's Fig. 2."""

        out: str = "framework.png"
        """File to write."""

    args = tyro.cli(Framework, args=argv[2:], prog="agility-ref plot framework")
    _save(framework_figure(), Path(args.out), argv)


PLOTS = {
    "curves": plot_curves, "strobe": plot_strobe, "oracle-map": plot_oracle_map, "episode": plot_episode,
    "courses": plot_courses, "skills": plot_skills, "framework": plot_framework,
}  # fmt: skip


def plot(argv: list[str]) -> None:
    """Draw one kind of picture."""
    if not argv or argv[0] in ("-h", "--help"):
        print(f"usage: agility-ref plot KIND [--help]\n       agility-ref plot RUN...\n\nKIND is {', '.join(PLOTS)}")
        return
    if argv[0] in PLOTS:
        PLOTS[argv[0]](["plot", *argv])
    else:
        plot_runs(argv)


def video(argv: list[str]) -> None:
    """Film an episode."""
    from agility_ref.graphics import choose_gl

    if not {"-h", "--help"} & set(argv):
        choose_gl()  # before mujoco is imported
    from agility_ref.video import VideoConfig, frames, write_video

    @dataclass(frozen=True)
    class Video(Play):
        """Film one episode, by default as video-POLICY-ENVIRONMENT.webp."""

        film: Annotated[VideoConfig, tyro.conf.arg(name="")] = field(default_factory=VideoConfig)

    args = tyro.cli(Video, args=argv, prog="agility-ref video")
    out = args.path("video", ".webp")
    episode = args.record()[0]
    count = write_video(frames(episode, args.film), out, args.film, shlex.join(["agility-ref", "video", *argv]))
    print(f"{out}: {count} frames; {episode.summary()}")


def watch(argv: list[str]) -> None:
    """Watch a policy in the browser."""
    from agility_ref.viewer import clip, serve

    @dataclass(frozen=True)
    class Watch(Play):
        """Play a policy in real time in the browser; it listens on this machine alone."""

        port: int = 8080
        """Port to listen on; the next free one if it is taken."""
        html: str = ""
        """Write one episode as a standalone page to this file instead."""
        seconds: float = 10.0
        """Length of that page's clip [s]."""

    args = tyro.cli(Watch, args=argv, prog="agility-ref watch")
    if args.html:
        episode = args.record()[0]
        print(f"{clip(episode, Path(args.html), args.seconds)}: {episode.summary()}")
        return
    policy, config = args.load()
    serve(policy, args.environment, config, args.port)


def list_names(argv: list[str]) -> None:
    """Print what there is."""
    from agility_ref.policies import ALIASES, ENVIRONMENTS, POLICIES, PRESETS
    from agility_ref.weights import FOLDER, file_name

    print(f"environments: {' '.join(ENVIRONMENTS)}\npresets: {' '.join(PRESETS)}\n")
    print(f"{'policy':16}{'trains on':58}{'quick':>8}{'full':>8}  weights shipped (preset: seeds)")
    for spec in POLICIES.values():
        shipped = [
            f"{preset}: {' '.join(seeds)}"
            for preset in PRESETS
            if (seeds := [str(k) for k in range(10) if (FOLDER / file_name(preset, spec.name, k)).exists()])
        ]
        budgets = "".join(f"{b / 1e6:7.1f}M" if b else f"{'-':>8}" for b in spec.budget)
        print(f"{spec.name:16}{' '.join(spec.courses) or '-':58}{budgets}  {', '.join(shipped) or '-'}")
    print("\n" + ", ".join(f"{alias} is {name}" for alias, name in ALIASES.items()))


COMMANDS = {
    "train": train, "evaluate": evaluate, "table1": table1, "plot": plot,
    "video": video, "watch": watch, "list": list_names,
}  # fmt: skip


def main(argv: list[str] | None = None) -> int:
    """Run one command; return the exit status."""
    argv = sys.argv[1:] if argv is None else argv
    if not argv or argv[0] in ("-h", "--help"):
        print(USAGE)
        return 0 if argv else 2
    try:
        if argv[0] not in COMMANDS:
            raise unknown_name("command", argv[0], COMMANDS)
        COMMANDS[argv[0]](argv[1:])
    except UserError as error:
        print(f"agility-ref: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as stopped:
        print(f"agility-ref: {stopped or 'interrupted'}", file=sys.stderr)
        return 130
    return 0
