"""Frames and a window of robots that are being stepped: what the Gymnasium adapter renders with.

In:  a running :class:`~agility_ref.env.Go1Env`.  Out: images, or MuJoCo's own viewer.
"""

import os
import sys
import time

from agility_ref.env import Go1Env
from agility_ref.errors import UserError, unknown_name
from agility_ref.pictures.scene import GAZE, make_scene, pose
from agility_ref.pictures.video import VideoConfig, open_renderer

import mujoco
import numpy as np

MODES = ("human", "rgb_array")


class Camera:
    """Follows the robots of an environment; each course is dressed once, when it is first seen.

    Parameters
    ----------
    env : the robots
    mode : Gymnasium's render mode: "human", "rgb_array" or None
    config : size of the images, direction of view

    Raises
    ------
    UserError : another mode
    """

    def __init__(self, env: Go1Env, mode: str | None, config: VideoConfig = VideoConfig()):
        if mode not in (None, *MODES):
            raise unknown_name("render_mode", str(mode), MODES)
        self.env, self.mode, self.config = env, mode, config
        self._scenes: dict[int, tuple[mujoco.MjModel, mujoco.MjData]] = {}
        self._renderers: dict[int, mujoco.Renderer] = {}
        self._window, self._shown, self._next_frame = None, -1, 0.0

    def _pose(self, robot: int) -> tuple[int, mujoco.MjModel, mujoco.MjData]:
        """Return the course of a robot and its scene, the robot as it stands now."""
        course = int(self.env.course[robot])
        if course not in self._scenes:
            model = make_scene(self.env.world.courses[course])
            self._scenes[course] = model, mujoco.MjData(model)
        model, data = self._scenes[course]
        pose(model, data, self.env.simulation.qpos[robot], int(self.env.waypoint_index[robot]))
        return course, model, data

    def frames(self) -> tuple[np.ndarray, ...] | None:
        """Return an image of every robot in mode "rgb_array", see :meth:`frame`; None in other modes."""
        return tuple(map(self.frame, range(self.env.num_envs))) if self.mode == "rgb_array" else None

    def refresh(self) -> None:
        """Show the first robot as it stands now in mode "human", see :meth:`show`."""
        if self.mode == "human":
            self.show(0)

    def frame(self, robot: int) -> np.ndarray:
        """Return an image (height, width, 3) uint8 of one robot.

        Raises
        ------
        UserError : OpenGL does not work here
        """
        course, model, data = self._pose(robot)
        if course not in self._renderers:
            self._renderers[course] = open_renderer(model, self.config)
        view = mujoco.MjvCamera()
        view.azimuth, view.elevation, view.distance = self.config.azimuth, self.config.elevation, self.config.distance
        view.lookat[:] = data.qpos[:3] + GAZE
        self._renderers[course].update_scene(data, view)
        return self._renderers[course].render()

    def show(self, robot: int) -> None:
        """Show one robot in MuJoCo's viewer, and wait until the step is over in real time.

        Raises
        ------
        UserError : no display, where MuJoCo's viewer would end the process
        """
        import mujoco.viewer

        if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise UserError("the viewer needs a display; render_mode='rgb_array' needs none")
        course, model, data = self._pose(robot)
        if course != self._shown:
            if self._window is not None:
                self._window.close()
            self._window, self._shown = mujoco.viewer.launch_passive(model, data), course
            self._window.cam.type, self._window.cam.trackbodyid = mujoco.mjtCamera.mjCAMERA_TRACKING, 1
            self._window.cam.distance = self.config.distance
        self._window.sync()
        time.sleep(max(0.0, self._next_frame - time.monotonic()))
        self._next_frame = time.monotonic() + self.env.config.dt

    def close(self) -> None:
        """Close the window and free the graphics memory."""
        if self._window is not None:
            self._window.close()
            self._window = None
        for renderer in self._renderers.values():
            renderer.close()
        self._renderers.clear()
