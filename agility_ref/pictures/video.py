"""Video of an episode: WebP or GIF through Pillow, MP4 through ffmpeg, rendered without a display.

MuJoCo reads the environment variable MUJOCO_GL once, when it is imported.  So this module
imports nothing of the kind until it draws; call :func:`choose_gl` before anything else does.

In:  an :class:`~agility_ref.pictures.record.Episode`.  Out: a file.
"""

import ctypes
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from agility_ref.errors import UserError, require_at_least
from agility_ref.files import replacing_path
from agility_ref.pictures.plots import made_with, skill_colour
from agility_ref.terrain import NUM_WAYPOINTS

import numpy as np

if TYPE_CHECKING:
    from agility_ref.pictures.record import Episode

    import mujoco

MAX_SIDE = 16_384  # [pixels] as far as OpenGL draws
LIBRARIES = {"egl": ("libEGL.so.1", "libGL.so.1"), "osmesa": ("libOSMesa.so.8",)}  # Debian's names, in order
ADVICE = (
    "no OpenGL without a display here; on Debian: apt install libegl1 libgl1 (or libosmesa6); "
    "`agility-ref plot strobe` needs none"
)


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def choose_gl() -> str:
    """Set MUJOCO_GL unless it is set: EGL where it loads, else OSMesa; return the choice.

    Raises
    ------
    UserError : neither library is there, or not the one that MUJOCO_GL asks for
    """
    wanted = os.environ.get("MUJOCO_GL", "").strip().lower()
    if not sys.platform.startswith("linux"):
        return wanted
    if wanted and wanted not in (*LIBRARIES, "glfw", "glx"):
        raise UserError(f"MUJOCO_GL is {wanted!r}, for a film it can be {' or '.join(LIBRARIES)}")
    for backend, libraries in LIBRARIES.items():
        if wanted in ("", backend) and all(map(_loads, libraries)):
            os.environ["MUJOCO_GL"] = backend
            os.environ.setdefault("PYOPENGL_PLATFORM", backend)
            return backend
    if wanted in ("glfw", "glx"):  # a window's, where there is a display
        return wanted
    raise UserError(ADVICE)


@dataclass(frozen=True)
class VideoConfig:
    """How an episode is filmed."""

    width: int = 640  # [pixel]
    height: int = 480  # [pixel]
    fps: int = 25  # Frames per second of the film; usual 8 to 25, the rate of the actions.
    speed: float = 1.0  # 1 for real time, 0.25 for slow motion.
    start: float = 0.0  # Where the film begins in the episode [s].
    seconds: float = 20.0  # How much of the episode is filmed [s].
    azimuth: float = 60.0  # Direction of view [degree]: 0 follows from behind, 90 looks from the right side.
    elevation: float = -16.0  # Angle above the horizon from which the camera looks down, negative [degree].
    distance: float = 1.9  # From the robot to the camera [m]; usual 1.2 to 4.
    quality: int = 40  # Of WebP and MP4, 1 to 100; at 16 frames per second it keeps an episode of 12 s within 2 MB.


def check_video(config: VideoConfig, out: Path | None = None) -> None:
    """Refuse what cannot be filmed, or not to this file, before it is played.

    Raises
    ------
    UserError : another suffix or quality; a size, rate, speed or length that leaves nothing to film
    """
    for what in ("fps", "speed", "seconds"):
        if not getattr(config, what) > 0:
            raise UserError(f"{what} must be above 0, got {getattr(config, what)}")
    require_at_least(1, MAX_SIDE, width=config.width, height=config.height)
    if not 0 <= config.start < float("inf"):
        raise UserError(f"start must be at least 0 and finite, got {config.start}")
    if not config.fps / config.speed <= 1000:
        raise UserError(
            f"fps / speed must be at most 1000 frames per second of the episode, got {config.fps / config.speed:g}"
        )
    if not 1 <= config.quality <= 100:
        raise UserError(f"quality must be between 1 and 100, got {config.quality}")
    if out is not None and out.suffix not in (".webp", ".gif", ".mp4"):
        raise UserError(f"a video ends in .webp, .gif or .mp4, not {out.suffix or out.name!r}")


def open_renderer(model: "mujoco.MjModel", config: VideoConfig) -> "mujoco.Renderer":
    """Return a renderer.

    Raises
    ------
    UserError : OpenGL does not work here
    """
    import mujoco

    model.vis.global_.offwidth, model.vis.global_.offheight = config.width, config.height
    try:
        return mujoco.Renderer(model, config.height, config.width)
    except Exception as error:  # every backend raises its own kind
        raise UserError(f"{ADVICE} ({str(error).splitlines()[0] if str(error) else type(error).__name__})") from None


def frames(episode: "Episode", config: VideoConfig = VideoConfig()) -> Iterator[np.ndarray]:
    """Render the episode; yield images (height, width, 3) uint8.

    Raises
    ------
    UserError : as check_video
    """
    from agility_ref.pictures.scene import GAZE, make_scene, pose

    import mujoco
    from tqdm import tqdm

    check_video(config)
    model = make_scene(episode.course)
    data = mujoco.MjData(model)
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation, camera.distance = config.azimuth, config.elevation, config.distance
    times = np.arange(config.start, min(config.start + config.seconds, episode.time[-1]), config.speed / config.fps)
    steps = np.minimum(np.round(times / episode.dt).astype(int), len(episode) - 1)
    gaze = None
    with open_renderer(model, config) as renderer:
        for t in tqdm(steps, desc="film", unit="frame", leave=False, disable=None):
            pose(model, data, episode.qpos[t], episode.waypoint_index[t])
            target = episode.qpos[t, :3] + GAZE
            gaze = target if gaze is None else gaze + 0.15 * (target - gaze)  # the camera sways less than the robot
            camera.lookat[:] = gaze
            renderer.update_scene(data, camera)
            yield overlay(renderer.render(), episode, int(t))


def overlay(image: np.ndarray, episode: "Episode", t: int) -> np.ndarray:
    """Write time, waypoints and skill on an image (height, width, 3)."""
    from PIL import Image, ImageDraw, ImageFont

    picture = Image.fromarray(image)
    draw = ImageDraw.Draw(picture)
    size = max(image.shape[0] // 26, 11)
    font = ImageFont.load_default(size)
    margin = size // 2
    course = f"{episode.policy} on {episode.environment}, d = {episode.course.difficulty:.2f}"
    state = f"{t * episode.dt:4.1f} s   waypoint {min(episode.waypoint_index[t] + 1, NUM_WAYPOINTS)} of {NUM_WAYPOINTS}"
    draw.text((margin, margin), course, fill="black", font=font)
    draw.text((margin, margin + 1.3 * size), state, fill="black", font=font)
    if episode.skill is not None:
        x, y = margin, margin + 2.8 * size
        for label, index in (("skill", episode.skill[t]), ("oracle", episode.wanted[t])):
            name = episode.skills[index]
            draw.rectangle([x, y, x + size, y + size], fill=skill_colour(name), outline="black")
            draw.text((x + 1.5 * size, y - 0.1 * size), f"{label}: {name}", fill="black", font=font)
            y += 1.4 * size
    return np.asarray(picture)


def write_video(images: Iterator[np.ndarray], out: Path, config: VideoConfig, command: str) -> int:
    """Encode images as .webp, .gif or .mp4; return their number.

    Raises
    ------
    UserError : as check_video, no image, or .mp4 without imageio-ffmpeg
    """
    out = Path(out)
    check_video(config, out)
    first = next(images, None)
    if first is None:
        raise UserError("nothing to film: --start lies behind the end of the episode")
    out.parent.mkdir(parents=True, exist_ok=True)
    with replacing_path(out) as partial:  # a film that is there stays whole until this one is
        write = _write_mp4 if out.suffix == ".mp4" else _write_pictures
        return write(chain([first], images), partial, config, command)


def _write_pictures(images: Iterator[np.ndarray], out: Path, config: VideoConfig, command: str) -> int:
    """Encode images as .webp or .gif; return their number."""
    from PIL import Image

    pictures = [Image.fromarray(image) for image in images]
    options = {"save_all": True, "append_images": pictures[1:], "duration": round(1000 / config.fps), "loop": 0}
    if out.suffix == ".gif":
        palette = pictures[len(pictures) // 2].quantize(128)
        pictures = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
        options |= {"append_images": pictures[1:], "comment": f"{command}; {made_with()}".encode()}
    else:
        exif = Image.Exif()
        exif[0x010E], exif[0x0131] = command, made_with()  # ImageDescription, Software
        options |= {"quality": config.quality, "method": 2, "exif": exif}
    pictures[0].save(out, **options)
    return len(pictures)


def _write_mp4(images: Iterator[np.ndarray], out: Path, config: VideoConfig, command: str) -> int:
    """Pipe images of one shape into ffmpeg (H.264, which every browser plays); return their number."""
    try:
        import imageio_ffmpeg
    except ImportError:
        raise UserError("MP4 needs one more package: pip install imageio-ffmpeg; .webp and .gif need none") from None
    first = next(images)
    height, width = (side // 2 * 2 for side in first.shape[:2])  # its colours are stored for squares of 2 x 2 pixels
    writer = imageio_ffmpeg.write_frames(
        str(out), (width, height), fps=config.fps, quality=config.quality / 10, macro_block_size=2,
        output_params=["-metadata", f"comment={command}; {made_with()}", "-movflags", "+faststart"],
    )  # fmt: skip
    writer.send(None)
    count = 0
    for image in chain([first], images):
        writer.send(np.ascontiguousarray(image[:height, :width]))
        count += 1
    writer.close()
    return count
