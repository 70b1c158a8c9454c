"""Robot and course as one MJCF file, for MuJoCo's own viewer and for other programs.

It is the model that policies are trained on, dressed as in :mod:`agility_ref.pictures.scene`, with a
material for each colour and a camera that tracks the trunk.

In:  a :class:`~agility_ref.terrain.Course`.  Out: a file that ``mujoco.MjModel.from_xml_path`` reads.
"""

from pathlib import Path

from agility_ref.errors import UserError
from agility_ref.files import write_text
from agility_ref.pictures import scene
from agility_ref.terrain import Course

import mujoco

NAMES = {
    scene.SIDE: "side", scene.METRE: "metre", scene.PIT: "pit", scene.RED: "edge", "#FFFFFF": "white",
    scene.WAYPOINT_COLOURS["ahead"]: "waypoint", scene.BODY: "shell", scene.DARK: "motor", scene.RUBBER: "rubber",
    "#808080": "collision", **{colour: f"leg_{leg}" for leg, colour in scene.LEG_COLOURS.items()},
}  # fmt: skip
PLAIN = (0.5, 0.5, 0.5, 1.0)  # of a geom that leaves its colour to its material


def write_mjcf(course: Course, out: Path) -> None:
    """Write the file.

    Raises
    ------
    UserError : there is no folder to write it into
    """
    out = Path(out)
    if not out.parent.is_dir():
        raise UserError(f"no folder {out.parent} to write {out.name} into")
    write_text(out, mjcf(course))


def mjcf(course: Course) -> str:
    """Return the text of the file."""
    spec = scene.scene_spec(course)
    spec.modelname = f"go1 {course.kind} {course.difficulty:g}"
    materials: dict[str, str] = {}
    for geom in spec.geoms:
        colour = "#" + "".join(f"{round(255 * c):02X}" for c in geom.rgba[:3])
        if colour not in materials:  # the treads of a course are shaded by their height
            materials[colour] = NAMES.get(colour, f"tread{len(materials)}")
            spec.add_material(name=materials[colour], rgba=geom.rgba, specular=0.2, shininess=0.3)
        geom.material, geom.rgba = materials[colour], PLAIN
    spec.body("trunk").add_camera(
        name="track", mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACK,
        pos=(-0.9, -1.6, 0.55), xyaxes=(0.87, -0.49, 0.0, 0.14, 0.25, 0.96),
    )  # fmt: skip
    spec.compile()
    return spec.to_xml()
