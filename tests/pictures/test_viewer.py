import contextlib
import os
import socket
import subprocess
import sys
import threading
import time
import urllib.request

from agility_ref.cli.main import main
from agility_ref.errors import UserError
from agility_ref.evaluate import EvaluationConfig
from agility_ref.pictures import video, viewer
from agility_ref.pictures.record import record
from agility_ref.pictures.viewer import DOWN, LEFT, SPACE, UP, Session, press
from agility_ref.policy import Policy
from agility_ref.selector import Single, oracle_hierarchy

import numpy as np
import pytest
from made import random_arrays
from PIL import Image

CONFIG = EvaluationConfig(difficulty=0.3)
SKILLS = ("walk", "climb-up", "climb-down", "leap", "beam")


@pytest.fixture(scope="module")
def oracle():
    meta = {"act_dim": 12}
    bank = {n: Policy.from_arrays(random_arrays(k, gain=100.0), {"policy": n, **meta}) for k, n in enumerate(SKILLS)}
    return oracle_hierarchy("oracle", bank)


@pytest.fixture(scope="module")
def episode(oracle):
    return record(oracle, "gap", CONFIG)[0]


# --- which OpenGL -------------------------------------------------------------------------


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems have their own OpenGL")
def test_egl_before_osmesa_and_never_over_the_users_choice(monkeypatch):
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setenv("PYOPENGL_PLATFORM", "x")
    monkeypatch.setattr(video, "_loads", lambda library: True)
    assert video.choose_gl() == os.environ["MUJOCO_GL"] == "egl"
    monkeypatch.setenv("MUJOCO_GL", "glfw")
    assert video.choose_gl() == "glfw"
    monkeypatch.delenv("MUJOCO_GL")
    monkeypatch.setattr(video, "_loads", lambda library: "OSMesa" in library)
    assert video.choose_gl() == "osmesa"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems have their own OpenGL")
def test_no_gl_is_one_line_with_the_packages(monkeypatch, capsys):
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(video, "_loads", lambda library: False)
    assert main(["video", "walk", "--environment", "gap"]) == 2
    out, err = capsys.readouterr()
    assert err.count("\n") == 1 and out == ""
    assert all(text in err for text in ("libegl1", "libosmesa6", "plot strobe"))


# --- video --------------------------------------------------------------------------------

FILM = """
from agility_ref.cli.main import main
import sys
sys.exit(main(sys.argv[1:]))
"""


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    """Return a function that films in a process of its own, as MuJoCo's choice of OpenGL is for life."""
    from agility_ref.files import write_npz

    root = tmp_path_factory.mktemp("film")
    for k, name in enumerate(SKILLS):
        folder = root / "runs" / "full" / name / "seed0"
        write_npz(folder / "policy.npz", random_arrays(k, gain=100.0), {"policy": name, "act_dim": 12})
        (folder / "DONE").write_text("")

    def run(command: str, **environment: str):
        clean = {k: v for k, v in os.environ.items() if k not in ("MUJOCO_GL", "PYOPENGL_PLATFORM")}
        done = subprocess.run(
            [sys.executable, "-c", FILM, "video", *command.split()], env=clean | environment, cwd=root,
            capture_output=True, text=True, timeout=300,
        )  # fmt: skip
        if done.returncode == 2 and "no OpenGL" in done.stderr:
            pytest.skip(done.stderr.strip())
        return root, done

    return run


@pytest.mark.parametrize("name", ["x.webp", "x.gif"])
def test_video_moves_and_carries_its_command(film, name):
    command = f"oracle --environment gap --seconds 0.4 --fps 10 --width 160 --height 120 --out {name}"
    root, done = film(command)
    assert done.returncode == 0, done.stderr
    with Image.open(root / name) as image:
        assert image.size == (160, 120) and image.n_frames >= 2
        first = np.asarray(image.convert("RGB")).astype(int)
        assert first.std() > 20  # not blank
        image.seek(image.n_frames - 1)
        assert np.abs(np.asarray(image.convert("RGB")).astype(int) - first).max() > 50
        text = image.info["comment"].decode() if name.endswith("gif") else image.getexif()[0x010E]
        assert f"agility-ref video {command}" in text


def test_mp4_plays_and_carries_its_command(film):
    """Decode the film again; 161 x 121 pixels, as H.264 wants even numbers."""
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed")
    command = "oracle --environment gap --seconds 0.5 --fps 10 --width 161 --height 121 --out new/x.mp4"
    root, done = film(command)
    assert done.returncode == 0 and all(line.startswith("weights ") for line in done.stderr.splitlines()), done.stderr
    reader = ffmpeg.read_frames(str(root / "new" / "x.mp4"))
    about = next(reader)
    pictures = [np.frombuffer(frame, np.uint8).reshape(120, 160, 3).astype(int) for frame in reader]
    assert about["size"] == (160, 120) and about["fps"] == 10 and about["codec"] == "h264"
    assert len(pictures) == 5 and done.stdout.startswith("new/x.mp4: 5 frames")
    assert pictures[0].std() > 20  # not blank
    assert np.abs(pictures[-1] - pictures[0]).max() > 50
    assert f"agility-ref video {command}".encode() in (root / "new" / "x.mp4").read_bytes()


@pytest.mark.slow
def test_a_film_of_a_whole_episode_is_at_most_2_mb(film):
    """With the shipped weights, and every flag at its default: 640 x 480 pixels, about 12 s."""
    root, done = film("climb --out whole.webp")
    assert done.returncode == 0, done.stderr
    with Image.open(root / "whole.webp") as image:
        assert image.size == (640, 480) and image.n_frames > 100
    assert (root / "whole.webp").stat().st_size <= 2e6


def test_without_ffmpeg_one_line_says_what_to_install(monkeypatch, tmp_path):
    from agility_ref.pictures.video import VideoConfig, write_video

    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(UserError, match="pip install imageio-ffmpeg"):
        write_video(iter([np.zeros((4, 4, 3), np.uint8)]), tmp_path / "x.mp4", VideoConfig(), "c")


@pytest.mark.parametrize("backend", ["egl", "osmesa"])
def test_both_backends(film, backend):
    if not all(map(video._loads, video.LIBRARIES[backend])):
        pytest.skip(f"{backend} is not installed")
    _, done = film("walk --environment gap --seconds 0.1 --width 64 --height 48 --out b.webp", MUJOCO_GL=backend)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("options, expected", [
    ("--out x.avi", [".webp", ".gif", ".mp4", ".avi"]),
    ("--start 1000", ["--start"]),
    ("--start 1000 --out x.mp4", ["--start"]),
    ("--start 1e400", ["start must be at least 0 and finite, got inf"]),
    ("--fps 1" + "0" * 30, ["fps / speed must be at most 1000", "1e+30"]),
    ("--width 2147483648", ["width must be at most 16384, not 2147483648"]),
    ("--speed 1e-300", ["fps / speed must be at most 1000"]),
])  # fmt: skip
def test_bad_films_are_one_line(film, options, expected):
    _, done = film(f"walk --environment gap --width 64 --height 48 {options}")
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert all(text in done.stderr for text in expected)


def test_overlay_names_skill_and_oracle(episode):
    from agility_ref.pictures.video import overlay

    blank = np.full((240, 320, 3), 255, np.uint8)
    hierarchy, single = overlay(blank, episode, 0), overlay(blank, record_single(episode), 0)
    assert (hierarchy != 255).sum() > (single != 255).sum() > 0


def record_single(episode):
    from dataclasses import replace

    return replace(episode, skill=None, wanted=None, skills=())


# --- the session behind the page ----------------------------------------------------------


@pytest.fixture
def session(oracle):
    from agility_ref.pictures.viewer import Session

    return Session(oracle, "gap", CONFIG)


def test_session_plays_and_starts_again(session):
    for _ in range(400):
        session.step()
    assert session.last_ending and session.env.course[0] == 0
    assert np.isfinite(session.qpos).all()


def test_status_compares_skills_of_the_same_step(session):
    for _ in range(150):
        session.step()
        assert session.skill == session.wanted  # the oracle agrees with itself, at its borders too


def test_skill_by_hand(session):
    session.step()
    assert session.skill == 0  # the oracle walks on the start platform
    session.by_hand = 4
    session.step()
    assert session.skill == 4 and "beam" in session.status() and "by hand" in session.status()
    session.by_hand = None
    session.step()
    assert session.skill == 0 and "by the policy" in session.status()


def test_next_course_and_difficulty(session):
    first = session.course
    session.next_course()
    assert session.course is not first and session.difficulty == 0.3
    session.next_course(0.8)
    assert session.course.difficulty == 0.8


def test_push_moves_the_trunk(session):
    before = session.env.simulation.qvel[0, :2].copy()
    session.push("left")
    change = session.env.simulation.qvel[0, :2] - before
    assert np.hypot(*change) == pytest.approx(1.0) and change[1] > 0.9  # the robot faces +x, left is +y
    session.push("right")
    assert np.allclose(session.env.simulation.qvel[0, :2], before)


def test_single_policy_has_no_skills(oracle):
    from agility_ref.pictures.viewer import Session

    session = Session(Single("walk", oracle.skills[0]), "walk", CONFIG)
    session.step()
    assert session.skill is None and session.skill_names == () and "skill" not in session.status()


def test_an_unknown_environment_is_the_users_error(oracle):
    from agility_ref.pictures.viewer import Session

    with pytest.raises(UserError, match="unknown environment 'gaps'"):
        Session(oracle, "gaps", CONFIG)


def test_without_viser_one_line_says_what_to_install(monkeypatch, capsys, tmp_path, finished_run):
    monkeypatch.setitem(sys.modules, "viser", None)
    monkeypatch.setattr("agility_ref.training.weights.shipped", lambda *key: None)
    finished_run(tmp_path, "walk")
    assert main(f"watch walk --environment gap --runs {tmp_path}".split()) == 2
    weights, error = capsys.readouterr().err.splitlines()
    assert weights.startswith("weights ") and "pip install viser" in error


# --- the page itself: needs viser ---------------------------------------------------------


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextlib.contextmanager
def served(policy, environment, config):
    """Serve the live page within a block; give its port.  The thread ends first: one that simulates while Python ends crashes it."""
    from agility_ref.pictures import viewer

    port, over, step = free_port(), threading.Event(), viewer.Session.step
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(viewer.Session, "step", lambda self: sys.exit() if over.is_set() else step(self))
        thread = threading.Thread(target=viewer.serve, args=(policy, environment, config, port), daemon=True)
        thread.start()
        try:
            for _ in range(100):
                try:
                    socket.create_connection(("127.0.0.1", port), 1).close()
                    break
                except OSError:
                    time.sleep(0.1)
            else:
                raise AssertionError("the page never came up")
            yield port
        finally:
            over.set()
            thread.join(30)
        assert not thread.is_alive()


@pytest.fixture
def page(oracle):
    """Serve the live page during a test; return its port."""
    pytest.importorskip("viser", reason="viser is not installed")
    with served(oracle, "gap", CONFIG) as port:
        yield port


def other_addresses() -> list[str]:
    """Addresses of this machine that are not 127.0.0.1, a second loopback one among them."""
    found = {"127.0.0.2"} if sys.platform.startswith("linux") else set()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # sends nothing: it only asks which address would be used
            found.add(probe.getsockname()[0])
        except OSError:
            pass
    return sorted(found - {"127.0.0.1"})


def test_only_loopback_answers(page):
    begin = time.monotonic()
    with urllib.request.urlopen(f"http://127.0.0.1:{page}/", timeout=5) as answer:
        assert answer.status == 200
    assert time.monotonic() - begin < 5.0
    addresses = other_addresses()
    assert addresses, "this machine has no other address to try"
    for address in addresses:
        with pytest.raises(OSError):
            socket.create_connection((address, page), 2).close()


def ask(port: int, path: str = "/", *headers: str) -> tuple[int, str]:
    """Ask the page for a path with headers of our own, a Host among them; return status and body."""
    with socket.create_connection(("127.0.0.1", port), 5) as link:
        link.sendall("\r\n".join([f"GET {path} HTTP/1.1", *headers, "Connection: close", "", ""]).encode())
        answer = b"".join(iter(lambda: link.recv(65536), b"")).decode(errors="replace")
    return int(answer.split()[1]), answer.partition("\r\n\r\n")[2]


WEBSOCKET = (
    "Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13", "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==",
)  # fmt: skip


def test_pages_of_strangers_are_refused(page):
    """A name that was made to point at loopback (DNS rebinding), and a stranger's page that opens our websocket."""
    here = f"Host: localhost:{page}"
    assert ask(page, "/", here)[0] == ask(page, "/", f"Host: 127.0.0.1:{page}")[0] == 200
    assert ask(page, "/", here, f"Origin: http://localhost:{page}")[0] == 200
    for host in ("rebound.example", f"rebound.example:{page}", "localhost.example", "127.0.0.1.example", "0.0.0.0", ""):
        status, body = ask(page, "/", f"Host: {host}")
        assert status == 403 and "127.0.0.1 alone" in body, host
    assert ask(page, "/", here, "Host: rebound.example")[0] == 403
    for upgrade in ((), WEBSOCKET):
        for origin in ("http://rebound.example", "https://localhost.example", "null"):
            assert ask(page, "/", here, f"Origin: {origin}", *upgrade)[0] == 403, origin


def test_no_file_outside_the_page_is_served(page):
    here, target = f"Host: localhost:{page}", "etc/passwd"
    for up in ("../", "%2e%2e/", "..%2f", "%2e%2e%2f", "..%5c", "/", "%2f", "....//", "file:///"):
        status, body = ask(page, f"/{up * 12}{target}", here)
        assert status in (400, 404) and "root:" not in body, up


def test_clip_stands_alone(episode, tmp_path):
    pytest.importorskip("viser", reason="viser is not installed")
    from agility_ref.pictures.viewer import clip

    out = clip(episode, tmp_path / "a" / "x.html", 1.0)
    text = out.read_text()
    assert text.lstrip().lower().startswith("<!doctype html") and 100_000 < len(text) < 3_000_000
    assert 'src="http' not in text and "src='http" not in text  # nothing is fetched from elsewhere
    with pytest.raises(UserError):
        clip(episode, tmp_path / "y.html", 0.0)


def test_every_geom_has_a_mesh(episode):
    pytest.importorskip("trimesh", reason="trimesh comes with viser, which is not installed")
    from agility_ref.pictures.scene import make_scene
    from agility_ref.pictures.viewer import geom_mesh

    model = make_scene(episode.course)
    for geom in np.flatnonzero(model.geom_bodyid > 0):
        mesh = geom_mesh(model, geom)
        assert np.allclose(mesh.bounds.mean(axis=0), model.geom_pos[geom], atol=1e-3)


@pytest.mark.parametrize("quality", [0, 101, -5])
def test_a_bad_quality_leaves_the_film_that_is_there(tmp_path, quality):
    from agility_ref.pictures.video import VideoConfig, write_video

    (tmp_path / "x.webp").write_bytes(b"a film")
    with pytest.raises(UserError, match="quality must be between 1 and 100"):
        write_video(iter([np.zeros((4, 4, 3), np.uint8)]), tmp_path / "x.webp", VideoConfig(quality=quality), "c")
    assert (tmp_path / "x.webp").read_bytes() == b"a film"


def test_a_film_that_fails_half_way_leaves_the_one_that_is_there(tmp_path):
    from agility_ref.pictures.video import VideoConfig, write_video

    def images():
        yield np.zeros((4, 4, 3), np.uint8)
        raise ZeroDivisionError

    (tmp_path / "x.webp").write_bytes(b"a film")
    with pytest.raises(ZeroDivisionError):
        write_video(images(), tmp_path / "x.webp", VideoConfig(), "c")
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("x.webp", b"a film")]


@pytest.mark.parametrize("port", [0, -1, 99999])
def test_no_such_port(port):
    from agility_ref.pictures import viewer

    with pytest.raises(UserError, match="port must be between 1 and 65535"):
        viewer.serve(None, "gap", None, port)


# --- the native window --------------------------------------------------------------------


@pytest.fixture
def shown(five_skills):
    return Session(oracle_hierarchy("oracle", five_skills), "gap", EvaluationConfig(preset="quick", clean=True))


def test_keys_pause_and_choose(shown):
    press(shown, SPACE)
    assert shown.paused
    press(shown, ord("4"))
    shown.step()
    assert (shown.by_hand, shown.skill) == (3, 3)
    press(shown, ord("9"))  # no such skill
    assert shown.by_hand == 3
    press(shown, ord("0"))
    assert shown.by_hand is None


def test_keys_change_the_course(shown):
    number, difficulty = shown.number, shown.difficulty
    press(shown, UP)
    assert shown.number == number + 1
    assert shown.difficulty == pytest.approx(difficulty + 0.04)  # a tenth of the preset's 0.4
    for _ in range(20):
        press(shown, DOWN)
    assert shown.difficulty == 0.0


def test_a_push_changes_the_velocity(shown):
    before = shown._qvel[0, 1]
    press(shown, LEFT)
    assert shown._qvel[0, 1] > before + 0.5


def test_no_display_is_one_line(monkeypatch, make_policy):
    monkeypatch.setattr(viewer, "has_display", lambda: False)
    with pytest.raises(UserError, match="browser"):
        viewer.show(Single("walk", make_policy(0, "walk")), "gap", EvaluationConfig())


@pytest.mark.skipif(not viewer.has_display(), reason="no display")
def test_the_window_opens_and_plays(make_policy):
    viewer.show(Single("walk", make_policy(0, "walk")), "gap", EvaluationConfig(preset="quick"), steps=5)
