"""The live page in a real headless browser, its controls used as a visitor uses them.

Needs the extra ``viewer``, ``pip install playwright``, and a Chromium: that of ``playwright install chromium``, or
the system's.  ``pytest -s`` prints what was measured.
"""

import io
import os
import re
import resource
import shutil
import subprocess
import sys
import time

from agility_ref.evaluate import EvaluationConfig
from agility_ref.pictures import viewer
from agility_ref.training.bank import WeightsConfig, load_policy

import numpy as np
import pytest
from PIL import Image
from test_viewer import free_port, served

pytestmark = pytest.mark.slow

PATIENCE = 120_000  # [ms] without a graphics card, and on a machine that does other things, a page takes its time
COUNT_FRAMES = """seconds => new Promise(done => {
    let frames = 0
    const begin = performance.now()
    const tick = now => now - begin < 1000 * seconds ? (frames++, requestAnimationFrame(tick)) : done(frames / seconds)
    requestAnimationFrame(tick)
})"""


@pytest.fixture(scope="module")
def browser():
    pytest.importorskip("viser", reason="viser is not installed")
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with sync_api.sync_playwright() as playwright:
        own = playwright.chromium.executable_path
        path = own if os.path.exists(own) else shutil.which("chromium") or shutil.which("google-chrome")
        if path is None:
            pytest.skip("no Chromium: playwright install chromium, or on Debian apt install chromium")
        options = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
        started = playwright.chromium.launch(executable_path=path, args=options)
        yield started
        started.close()


@pytest.fixture
def tab(browser):
    """A blank page; ``tab.errors`` collects what it writes to the console as an error."""
    page = browser.new_page(viewport={"width": 800, "height": 600})
    page.set_default_timeout(PATIENCE)
    page.errors = []
    page.on("console", lambda message: page.errors.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: page.errors.append(str(error)))
    yield page
    page.close()


@pytest.fixture
def session(monkeypatch):
    """Serve the shipped ``climb`` of the preset quick; return its session, with the page's port and the pushes so far."""
    made = []

    class Noted(viewer.Session):
        def __init__(self, *args):
            super().__init__(*args)
            self.pushes = []
            made.append(self)

        def push(self, direction):
            before = self._qvel[0, :2].copy()
            super().push(direction)
            self.pushes.append((direction, np.linalg.norm(self._qvel[0, :2] - before)))

    monkeypatch.setattr(viewer, "Session", Noted)
    policy = load_policy("climb", WeightsConfig(preset="quick"))
    with served(policy, "climb", EvaluationConfig(preset="quick", difficulty=0.3)) as port:
        made[0].port = port
        yield made[0]


def wait(true, seconds=PATIENCE / 1000):
    """Wait until a function returns something true."""
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "it never came"
        time.sleep(0.1)


def view(tab):
    """Return the pixels of the scene, left of the controls."""
    picture = Image.open(io.BytesIO(tab.screenshot())).convert("RGB")
    return np.asarray(picture, int)[100:, :400]


def test_the_page_shows_a_robot_that_moves_and_its_controls_act(session, tab):
    tab.goto(f"http://127.0.0.1:{session.port}/", wait_until="domcontentloaded")
    tab.get_by_text("waypoint").first.wait_for()
    wait(lambda: view(tab).std() > 10)  # the canvas is no longer blank
    first, x = view(tab), session.qpos[0]
    wait(lambda: session.qpos[0] != x and np.abs(view(tab) - first).max() > 40)

    tab.get_by_text("left", exact=True).click()
    wait(lambda: session.pushes)
    direction, change = session.pushes[0]
    assert direction == "left" and change == pytest.approx(viewer.PUSH)  # [m/s] added to the trunk's velocity

    tab.get_by_role("slider").first.press("ArrowRight")  # one step of the slider: 0.30 + 0.05
    wait(lambda: session.difficulty == pytest.approx(0.35))
    tab.get_by_text("d = 0.35").first.wait_for()  # the page says so too
    assert session.number >= 1 and session.course.difficulty == pytest.approx(0.35)

    steps = tab.get_by_text("steps/s; real time").first.text_content()
    frames = tab.evaluate(COUNT_FRAMES, 5.0)
    print(f"\n{frames:.1f} frames/s in the browser, {re.search(r'[0-9]+ steps/s', steps)[0]}")
    assert frames > 0 and tab.errors == []


def test_the_first_command_of_the_readme_shows_a_robot_within_ten_seconds(tab):
    """10 s of processor time: wall time says nothing on a machine that does other things, and is printed."""
    port, begin, used = free_port(), time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "agility_ref", "watch", "climb", "--port", str(port), "--no-browser"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert f":{port}" in server.stdout.readline()
        served = time.monotonic() - begin
        tab.goto(f"http://127.0.0.1:{port}/", wait_until="domcontentloaded")
        wait(lambda: view(tab).std() > 10)
        seen = time.monotonic() - begin
        tab.get_by_text("waypoint").first.wait_for()
    finally:
        server.terminate()
        server.wait(60)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    processor = after.ru_utime + after.ru_stime - used.ru_utime - used.ru_stime
    print(f"\nserved after {served:.1f} s, seen after {seen:.1f} s; {processor:.1f} s of the server's processor time")
    assert processor < 10.0 and tab.errors == []
