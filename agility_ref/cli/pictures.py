"""The commands that draw: ``plot KIND``, ``video`` and ``watch``.

In:  a command's options.  Out: files, or a page in the browser.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from agility_ref.cli.commands import Environment, Evaluated, File, Folder, Policy, Preset, command_line, take
from agility_ref.errors import MANY, MAX_SEED, UserError, require_at_least

import tyro


@dataclass(frozen=True, kw_only=True)
class Play(Evaluated):
    """What every picture of an episode is told."""

    policy: tyro.conf.Positional[Policy]  # See `agility-ref list`.
    environment: Environment = ""
    """walk, climb-up, climb-down, climb, gap, beam or climb-gap; by default what the policy was trained for."""
    difficulty: float | None = None  # Difficulty of the course, 0 to 1; by default as it was drawn.
    course: int = 0  # Which course of that seed, counted from 0; its friction, payload and start are drawn anew.
    clean: bool = False  # Turn noise, pushes, payload and friction differences off.
    out: File = ""  # File to write; by default a name made of the command, the policy and the environment.

    @property
    def kind(self) -> str:
        """The environment that was named, else the first that the policy was trained for."""
        from agility_ref.training.policies import find_policy

        spec = find_policy(self.policy)
        return self.environment or ("climb-gap" if spec.skills or spec.teachers else spec.courses[0])

    def path(self, what: str, suffix: str) -> Path:
        """Return the file to write."""
        return Path(self.out or f"{what}-{self.policy}-{self.kind}{suffix}")

    def load(self):
        """Return the policy."""
        from agility_ref.training.bank import load_policy

        return load_policy(self.policy, self.weights())

    def name_weights(self) -> None:
        """Say which weights act: own runs, or those shipped."""
        from agility_ref.results.cells import acting_policies
        from agility_ref.training.bank import weights_path

        for name in acting_policies(self.policy):
            print(f"weights {weights_path(name, self.weights())}", file=sys.stderr)

    def record(self, courses: int = 1, robots: int = 1) -> list:
        """Play and return the episodes."""
        from agility_ref.pictures.record import record

        numbers = tuple(range(self.course, self.course + courses))
        return record(self.load(), self.kind, self.evaluation(), numbers, robots)


def _save(draw: Callable, out: Path) -> None:
    """Draw and write a figure, if there is a place to write it to."""
    from agility_ref.pictures.plots import save_figure

    if out.suffix not in ("", ".png", ".svg") or not out.name or out.is_dir():
        raise UserError(f"a figure is written as .png and .svg, not to {str(out)!r}")
    print(", ".join(map(str, save_figure(draw(), out, command_line()))))


def _save_played(options: Play, what: str, draw: Callable[[list], object], courses: int = 1, robots: int = 1) -> None:
    """Play, draw and write a figure; ``what`` names its file by default."""
    _save(lambda: draw(options.record(courses, robots)), options.path(what, ".png"))
    options.name_weights()


# ---------------------------------------------------------------------------- plot


@dataclass(frozen=True)
class Run:
    """Learning curve of one run, as training draws it; `plot FOLDER` is short for it.

    For example:
        agility-ref plot runs/full/leap/seed0
        agility-ref plot run runs/full/leap/seed0 runs/full/leap/seed1
    """

    runs: tyro.conf.Positional[Annotated[tuple[str, ...], tyro.conf.arg(metavar="RUN ...")]]
    """Run folders; each gets its learning_curve.png."""


def plot_run(options: Run) -> None:
    """Draw learning_curve.png in each run folder."""
    from agility_ref.pictures.plots import learning_curve

    if not options.runs:
        raise UserError("name at least one run folder")
    empty = []
    for run in map(Path, options.runs):
        if not (run / "progress.csv").is_file():
            raise UserError(f"{run} holds no progress.csv")
        if learning_curve(run / "progress.csv", run / "learning_curve.png", run.parent.name):
            print(run / "learning_curve.png")
        else:
            empty.append(str(run))
    if empty:
        raise UserError(f"no returns to draw in {', '.join(empty)}: learned by imitation, or without an iteration yet")


@dataclass(frozen=True)
class Curves:
    """Learning curves of several runs: a thin line per seed, a bold IQM, a 95 % band, wall time above.

    For example:
        agility-ref plot curves runs/full/leap/seed0 runs/full/gen-3/seed0
        agility-ref plot curves agility_ref/weights/leap-full-seed*.npz --evaluate gap
    """

    runs: tyro.conf.Positional[Annotated[tuple[str, ...], tyro.conf.arg(metavar="RUN ...")]]
    """Run folders, such as runs/full/leap/seed0, or shipped weights, such as
    agility_ref/weights/leap-full-seed0.npz; seeds of one policy are drawn together."""
    out: File = "curves.png"  # File to write.
    evaluate: Environment = ""  # Also evaluate each finished run on this environment, without exploration: diamonds.
    episodes: int = 32  # Episodes of each of these evaluations; usual 16 to 64.


def plot_curves(options: Curves) -> None:
    """Draw learning curves."""
    from agility_ref.pictures.plots import learning_curves
    from agility_ref.training.progress import read_progress
    from agility_ref.training.weights import shipped_curve

    if not options.runs:
        raise UserError("name at least one run folder")
    # <folder>/<policy>/seed<k>, or <folder>/<policy>-<preset>-seed<k>.npz
    runs = [Path(run) for run in options.runs]
    homes = {run: run.with_name(run.name.rsplit("-", 2)[0]) if run.is_file() else run.parent for run in runs}
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
        if options.evaluate and (run.is_file() or (run / "DONE").exists()):
            finished.setdefault(label, []).append(run)

    def draw():
        return learning_curves(found, {
            label: [_evaluation_point(run, options.evaluate, options.episodes) for run in runs]
            for label, runs in finished.items()
        })  # fmt: skip

    _save(draw, Path(options.out))


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


@dataclass(frozen=True, kw_only=True)
class Strobe(Play):
    """An episode from the side, to scale: the robot at regular instants, contacts, violated edges, skills.

    For example:
        agility-ref plot strobe climb
        agility-ref plot strobe oracle --environment climb-gap --difficulty 0.5 --out strobe.png
    """

    period: float = 0.7  # Time between two drawings of the robot [s]; usual 0.3 to 1.


def plot_strobe(options: Strobe) -> None:
    """Draw a strobe picture."""
    from agility_ref.pictures.pictures import strobe

    _save_played(options, "strobe", lambda played: strobe(played[0], options.period))


@dataclass(frozen=True, kw_only=True)
class OracleMap(Play):
    """Courses from above: height, skill regions, waypoints, robots with trails (the paper's Fig. 3).

    For example:
        agility-ref plot oracle-map oracle
        agility-ref plot oracle-map ps-rl-3 --environment climb-gap --courses 2 --robots 4
    """

    courses: int = 3  # How many courses; usual 1 to 5.
    robots: int = 8  # Robots on each; usual 1 to 20.


def plot_oracle_map(options: OracleMap) -> None:
    """Draw the oracle policy map."""
    from agility_ref.pictures.pictures import oracle_map

    require_at_least(1, MANY, courses=options.courses, robots=options.robots)
    _save_played(options, "oracle-map", oracle_map, options.courses, options.robots)


@dataclass(frozen=True, kw_only=True)
class Panel(Play):
    """One episode in numbers: foot contacts, waypoints, heading error, reward terms, joint angles and torques.

    For example:
        agility-ref plot episode walk
        agility-ref plot episode leap --difficulty 0.5 --start 4 --seconds 2
    """

    start: float | None = None  # Where the window of the joint panels begins [s]; the middle of the episode by default.
    seconds: float = 3.0  # Its length [s].


def plot_episode(options: Panel) -> None:
    """Draw the episode panel."""
    from agility_ref.pictures.gait import episode_panel

    _save_played(options, "episode", lambda played: episode_panel(played[0], options.seconds, options.start))


@dataclass(frozen=True)
class Courses:
    """The seven kinds of course at d = 0, 0.3, 0.6 and 1, dimensions in metres.

    For example:
        agility-ref plot courses
        agility-ref plot courses --seed 5 --out courses.png
    """

    out: File = "courses.png"  # File to write.
    seed: int = 3  # Seed of the courses.


def plot_courses(options: Courses) -> None:
    """Draw the course gallery."""
    from agility_ref.pictures.pictures import course_gallery

    require_at_least(0, MAX_SEED, seed=options.seed)
    _save(lambda: course_gallery(seed=options.seed), Path(options.out))


@dataclass(frozen=True)
class Skills:
    """The five specialists at work, the paper's Fig. 1.

    For example:
        agility-ref plot skills
        agility-ref plot skills --preset quick --difficulty 0.2
    """

    out: File = "skills.png"  # File to write.
    preset: Preset = "full"  # Names the weights.
    difficulty: float = 0.3  # Of the courses, 0 to 1.
    runs: Folder = ""  # Folder of runs to look in before the shipped weights; runs/<preset> by default.


def plot_skills(options: Skills) -> None:
    """Draw the paper's Fig. 1."""
    from agility_ref.pictures.pictures import skills_figure

    skills = ("climb-down", "climb-up", "walk", "leap", "beam")
    common = {"preset": options.preset, "difficulty": options.difficulty, "runs": options.runs, "clean": True}
    _save(lambda: skills_figure({s: Play(policy=s, **common).record()[0] for s in skills}), Path(options.out))


# ---------------------------------------------------------------------------- video and watch


@dataclass(frozen=True, kw_only=True)
class Video(Play):
    """Film one episode, by default as video-POLICY-ENVIRONMENT.webp; .gif and .mp4 work too.

    For example:
        agility-ref video climb
        agility-ref video oracle --environment climb-gap --difficulty 0.3 --seconds 8 --out oracle.mp4
    """

    seconds: float = 20.0  # How much of the episode is filmed [s].


def video_flags() -> type:
    """Return the other flags of a film."""
    from agility_ref.pictures.video import VideoConfig

    return VideoConfig


def video(options: Video) -> None:
    """Film an episode."""
    from agility_ref.pictures.video import VideoConfig, check_video, choose_gl, frames, write_video

    choose_gl()  # before mujoco is imported
    config, out = take(VideoConfig, options), options.path("video", ".webp")
    check_video(config, out)
    episode = options.record()[0]
    count = write_video(frames(episode, config), out, config, command_line())
    print(f"{out}: {count} frames; {episode.summary()}")
    options.name_weights()


@dataclass(frozen=True, kw_only=True)
class Watch(Play):
    """Play a policy in real time in the browser; it listens on this machine alone.

    For example:
        agility-ref watch climb
        agility-ref watch oracle --environment climb-gap --html oracle.html
    """

    difficulty: float | None = 0.3  # Of the courses, 0 to 1; a slider on the page changes it.
    course: int = 0  # Which course of that seed --html shows, counted from 0.
    out: tyro.conf.Suppress[str] = ""
    port: int = 8080  # Port to listen on; the next free one if it is taken.
    browser: bool = True  # Open the page where this machine has a display.
    window: bool = False  # Open a native window instead, where there is a display.
    html: File = ""  # Write one episode as a standalone page to this file instead.


@dataclass(frozen=True)
class Page:
    """The other flags of a standalone page."""

    seconds: float = 10.0  # Length of the clip that --html writes [s].


def watch(options: Watch) -> None:
    """Watch a policy in the browser, in a window, or as a page that needs no server."""
    from agility_ref.pictures.viewer import clip, serve, show

    if options.html:
        episode = options.record()[0]
        print(f"{clip(episode, Path(options.html), options.seconds)}: {episode.summary()}")
        options.name_weights()
        return
    policy = options.load()
    options.name_weights()
    if options.window:
        show(policy, options.kind, options.evaluation())
    else:
        serve(policy, options.kind, options.evaluation(), options.port, browser=options.browser)
