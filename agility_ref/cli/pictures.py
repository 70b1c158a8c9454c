"""The commands that draw: ``plot``, ``video`` and ``watch``.

In:  the rest of the command line.  Out: files, or a page in the browser.
"""

import shlex
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from agility_ref.errors import UserError

import tyro


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
    """Which course of that seed, counted from 0; its friction, payload and start are drawn anew."""
    train_seed: int = 0
    """Training seed of the weights."""
    runs: str = ""
    """Folder of runs to look in before the shipped weights; runs/<preset> by default."""

    def path(self, what: str, suffix: str) -> Path:
        """Return the file to write."""
        return Path(self.out or f"{what}-{self.policy}-{self.environment}{suffix}")

    @property
    def training(self):
        """What names the weights."""
        from agility_ref.training.bank import WeightsConfig, existing

        return WeightsConfig(preset=self.preset, seed=self.train_seed, out=existing(self.runs))

    def load(self):
        """Return the policy and the evaluation's configuration."""
        from agility_ref.evaluate import EvaluationConfig
        from agility_ref.training.bank import load_policy

        config = EvaluationConfig(seed=self.seed, preset=self.preset, difficulty=self.difficulty, clean=self.clean)
        return load_policy(self.policy, self.training), config

    def name_weights(self) -> None:
        """Say which weights act: own runs, or those shipped."""
        from agility_ref.results.cells import acting_policies
        from agility_ref.training.bank import weights_path

        for name in acting_policies(self.policy):
            print(f"weights {weights_path(name, self.training)}", file=sys.stderr)

    def record(self, courses: int = 1, robots: int = 1) -> list:
        """Play and return the episodes."""
        from agility_ref.pictures.record import record

        policy, config = self.load()
        numbers = tuple(range(self.course, self.course + courses))
        return record(policy, self.environment, config, numbers, robots)


def _save(draw: Callable, out: Path, argv: list[str]) -> None:
    """Draw and write a figure, if there is a place to write it to."""
    from agility_ref.pictures.plots import save_figure

    if out.suffix not in ("", ".png", ".svg") or not out.name or out.is_dir():
        raise UserError(f"a figure is written as .png and .svg, not to {str(out)!r}")
    print(", ".join(map(str, save_figure(draw(), out, shlex.join(["agility-ref", *argv])))))


def plot_runs(argv: list[str]) -> None:
    """Draw learning_curve.png in each run folder, as training does."""
    from agility_ref.pictures.plots import learning_curve

    for run in map(Path, argv):
        if not (run / "progress.csv").is_file():
            raise UserError(f"{run} is no picture ({', '.join(PLOTS)}) and holds no progress.csv")
        if learning_curve(run / "progress.csv", run / "learning_curve.png", run.parent.name):
            print(run / "learning_curve.png")


def plot_curves(argv: list[str]) -> None:
    """Draw learning curves."""
    from agility_ref.pictures.plots import learning_curves
    from agility_ref.training.progress import read_progress
    from agility_ref.training.weights import shipped_curve

    @dataclass(frozen=True)
    class Curves:
        """Compare runs: one thin line per seed, a bold IQM, a 95 % band, wall time above."""

        runs: tyro.conf.Positional[tuple[str, ...]]
        """Run folders, such as runs/full/leap/seed0, or shipped weights, such as
        agility_ref/weights/leap-full-seed0.npz; seeds of one policy are drawn together."""
        out: str = "curves.png"
        """File to write."""
        evaluate: str = ""
        """Also evaluate each finished run on this environment, without exploration: diamonds."""
        episodes: int = 32
        """Episodes of each of these evaluations; usual 16 to 64."""

    args = tyro.cli(Curves, args=argv[2:], prog="agility-ref plot curves")
    if not args.runs:
        raise UserError("name at least one run folder")
    # <folder>/<policy>/seed<k>, or <folder>/<policy>-<preset>-seed<k>.npz
    homes = {
        run: run.with_name(run.name.rsplit("-", 2)[0]) if run.is_file() else run.parent for run in map(Path, args.runs)
    }
    policies = set(homes.values())
    alone = len({policy.name for policy in policies}) == len(policies)
    found: dict[str, list[dict]] = {}
    finished: dict[str, list[Path]] = {}
    for run, home in homes.items():
        if not (run.is_file() or (run / "progress.csv").is_file()):
            raise UserError(f"{run} holds no progress.csv")
        curve = shipped_curve(run) if run.is_file() else read_progress(run / "progress.csv")
        if "waypoint_fraction" not in curve:
            raise UserError(f"{run} has no returns to draw: not shipped weights, or trained by supervision")
        label = home.name if alone else str(home)
        found.setdefault(label, []).append(curve)
        if args.evaluate and (run.is_file() or (run / "DONE").exists()):
            finished.setdefault(label, []).append(run)

    def draw():
        return learning_curves(found, {
            label: [_evaluation_point(run, args.evaluate, args.episodes) for run in runs]
            for label, runs in finished.items()
        })  # fmt: skip

    _save(draw, Path(args.out), argv)


def _evaluation_point(run: Path, environment: str, episodes: int) -> dict:
    """Evaluate the policy in a run folder or file; return its steps and its mean metrics."""
    from agility_ref.env import EnvConfig
    from agility_ref.evaluate import METRICS, EvaluationConfig, evaluate
    from agility_ref.selector import Single
    from agility_ref.training.bank import load_skill

    policy = load_skill(run if run.is_file() else run / "policy.npz", EnvConfig())
    config = EvaluationConfig(episodes=episodes, preset=policy.meta.get("preset", "full"))
    result = evaluate(Single(policy.name, policy), environment, config)
    return {"steps": policy.meta["steps"], **{m: float(getattr(result, m).mean()) for m in METRICS}}


def plot_strobe(argv: list[str]) -> None:
    """Draw a strobe picture."""
    from agility_ref.pictures.pictures import strobe

    @dataclass(frozen=True)
    class Strobe(Play):
        """Side view to scale: the robot at regular instants, contacts, violated edges, skills."""

        period: float = 0.7
        """Time between two drawings of the robot [s]; usual 0.3 to 1."""

    args = tyro.cli(Strobe, args=argv[2:], prog="agility-ref plot strobe")
    _save(lambda: strobe(args.record()[0], args.period), args.path("strobe", ".png"), argv)
    args.name_weights()


def plot_oracle_map(argv: list[str]) -> None:
    """Draw the oracle policy map."""
    from agility_ref.pictures.pictures import oracle_map

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
    _save(lambda: oracle_map(args.record(args.courses, args.robots)), args.path("oracle-map", ".png"), argv)
    args.name_weights()


def plot_episode(argv: list[str]) -> None:
    """Draw the episode panel."""
    from agility_ref.pictures.gait import episode_panel

    @dataclass(frozen=True)
    class Panel(Play):
        """Foot contacts, waypoints, heading error, reward terms, joint angles and torques."""

        start: float | None = None
        """Where the window of the joint panels begins [s]; the middle of the episode by default."""
        seconds: float = 3.0
        """Its length [s]."""

    args = tyro.cli(Panel, args=argv[2:], prog="agility-ref plot episode")
    _save(lambda: episode_panel(args.record()[0], args.seconds, args.start), args.path("episode", ".png"), argv)
    args.name_weights()


def plot_courses(argv: list[str]) -> None:
    """Draw the course gallery."""
    from agility_ref.pictures.gallery import course_gallery

    @dataclass(frozen=True)
    class Courses:
        """Draw the seven kinds of course at d = 0, 0.3, 0.6 and 1, dimensions in metres."""

        out: str = "courses.png"
        """File to write."""
        seed: int = 3
        """Seed of the courses."""

    args = tyro.cli(Courses, args=argv[2:], prog="agility-ref plot courses")
    if args.seed < 0:
        raise UserError(f"seed must be at least 0, not {args.seed}")
    _save(lambda: course_gallery(seed=args.seed), Path(args.out), argv)


def plot_skills(argv: list[str]) -> None:
    """Draw the paper's Fig. 1."""
    from agility_ref.pictures.gallery import skills_figure

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

    def draw():
        return skills_figure({skill: Play(skill, course, **common).record()[0] for skill, course in courses.items()})

    _save(draw, Path(args.out), argv)


def plot_framework(argv: list[str]) -> None:
    """Draw the paper's Fig. 2."""
    from agility_ref.pictures.gallery import framework_figure

    @dataclass(frozen=True)
    class Framework:
        """Draw the selector framework, the paper's Fig. 2."""

        out: str = "framework.png"
        """File to write."""

    args = tyro.cli(Framework, args=argv[2:], prog="agility-ref plot framework")
    _save(framework_figure, Path(args.out), argv)


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
    from agility_ref.pictures.video import choose_gl

    if not {"-h", "--help"} & set(argv):
        choose_gl()  # before mujoco is imported
    from agility_ref.pictures.video import VideoConfig, check_video, frames, write_video

    @dataclass(frozen=True)
    class Video(Play):
        """Film one episode, by default as video-POLICY-ENVIRONMENT.webp."""

        film: Annotated[VideoConfig, tyro.conf.arg(name="")] = field(default_factory=VideoConfig)

    args = tyro.cli(Video, args=argv, prog="agility-ref video")
    out = args.path("video", ".webp")
    check_video(args.film, out)
    episode = args.record()[0]
    count = write_video(frames(episode, args.film), out, args.film, shlex.join(["agility-ref", "video", *argv]))
    print(f"{out}: {count} frames; {episode.summary()}")
    args.name_weights()


def watch(argv: list[str]) -> None:
    """Watch a policy in the browser."""
    from agility_ref.pictures.viewer import clip, serve

    @dataclass(frozen=True)
    class Watch(Play):
        """Play a policy in real time in the browser; it listens on this machine alone.

        A live view draws courses of its own, of half the preset's difficulty unless another is given.
        --course and --seconds choose what --html writes.
        """

        out: tyro.conf.Suppress[str] = ""
        port: int = 8080
        """Port to listen on; the next free one if it is taken."""
        window: bool = False
        """Open a native window instead, where there is a display."""
        html: str = ""
        """Write one episode as a standalone page to this file instead."""
        seconds: float = 10.0
        """Length of that page's clip [s]."""

    args = tyro.cli(Watch, args=argv, prog="agility-ref watch")
    if args.html:
        episode = args.record()[0]
        print(f"{clip(episode, Path(args.html), args.seconds)}: {episode.summary()}")
        args.name_weights()
        return
    policy, config = args.load()
    args.name_weights()
    if args.window:
        from agility_ref.pictures.viewer import show

        show(policy, args.environment, config)
    else:
        serve(policy, args.environment, config, args.port)
