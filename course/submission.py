"""Submissions: found, unpacked, copied and looked at; nothing of them is executed here."""

import ast
import os
import shutil
import stat
import zipfile
from pathlib import Path, PurePosixPath

from agility_ref.errors import UserError
from course.assignment import Assignment
from course.release import BEGIN

MAX_BYTES = 100_000_000
MAX_FILES = 2000
ENTRY = "adapters.py"


class Rejected(Exception):
    """Why a submission cannot be graded, in one line for its student."""


def find_submissions(path: Path) -> dict[str, Path]:
    """Return the submissions under a path by the names of their students.

    The path is a submission if it is a zip, or a folder with Python files in it; else every folder
    and zip in it is one.

    Raises
    ------
    UserError : there is no such path, or nothing in it
    """
    if not path.exists():
        raise UserError(f"{path} does not exist")
    if path.is_file() or any(path.glob("*.py")):
        return {path.resolve().stem if path.is_file() else path.resolve().name: path}
    entries = [p for p in sorted(path.iterdir()) if not p.name.startswith(".")]
    found: dict[str, Path] = {}
    for entry in entries:
        if entry.is_dir() or entry.suffix.lower() == ".zip":
            name = entry.name if entry.is_dir() or entry.stem in found else entry.stem
            found[name] = entry
    if not found:
        raise UserError(f"{path} holds no submission: a folder or a zip for each student is expected")
    return found


def copy_submission(source: Path, target: Path) -> None:
    """Copy a folder, or unpack a zip, into the new folder ``target``; links are left out.

    Raises
    ------
    Rejected : it is too large, not a zip, or a path in the zip climbs out
    """
    target.mkdir()
    if source.is_dir():
        try:
            return _copy_folder(source, target)
        except OSError as error:
            raise Rejected(f"cannot be read ({error})") from None
    try:
        with zipfile.ZipFile(source) as archive:
            members = archive.infolist()
            for member in members:
                path = PurePosixPath(member.filename.replace("\\", "/"))
                if path.is_absolute() or ".." in path.parts or ":" in path.parts[0]:
                    raise Rejected(f"the zip has a path that climbs out: {member.filename}")
            if len(members) > MAX_FILES or sum(member.file_size for member in members) > MAX_BYTES:
                raise Rejected(f"the zip unpacks to more than {MAX_FILES} files or {MAX_BYTES // 10**6} MB")
            archive.extractall(target)
    except (zipfile.BadZipFile, OSError, RuntimeError, NotImplementedError, ValueError, IndexError) as error:
        raise Rejected(f"not a zip that can be unpacked ({error})") from None


def _copy_folder(source: Path, target: Path) -> None:
    files = total = 0
    for folder, folders, names in os.walk(source):
        folders[:] = [name for name in folders if name not in (".git", ".venv", "venv", "__pycache__")]
        here = target / Path(folder).relative_to(source)
        here.mkdir(exist_ok=True)
        for name in names:
            path = Path(folder, name)
            status = path.lstat()
            if not stat.S_ISREG(status.st_mode):
                continue
            files, total = files + 1, total + status.st_size
            if files > MAX_FILES or total > MAX_BYTES:
                raise Rejected(f"the folder holds more than {MAX_FILES} files or {MAX_BYTES // 10**6} MB")
            shutil.copyfile(path, here / name)


def find_root(folder: Path, assignment: Assignment) -> Path:
    """Return the folder of ``adapters.py`` in a copied submission, after a look at its Python files.

    Raises
    ------
    Rejected : nothing there, no or many adapters, another assignment's, or a syntax error
    """
    files = [path for path in folder.rglob("*") if path.is_file() and "__MACOSX" not in path.parts]
    if not files:
        raise Rejected("the submission is empty")
    entries = [path for path in files if path.name == ENTRY]
    entries.sort(key=lambda path: len(path.parts))
    if not entries:
        raise Rejected(f"no {ENTRY} among {len(files)} files: hand in the whole folder that was released")
    if len(entries) > 1 and len(entries[0].parts) == len(entries[1].parts):
        raise Rejected(f"{ENTRY} is there {len(entries)} times: hand in one folder")
    root = entries[0].parent
    for path in [entries[0], *sorted(p for p in files if root / assignment.name in p.parents and p.suffix == ".py")]:
        try:
            tree = ast.parse(path.read_bytes())
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            where = f" line {error.lineno}" if getattr(error, "lineno", None) else ""
            raise Rejected(f"{path.relative_to(root)}{where}: {getattr(error, 'msg', error)}") from None
        if path == entries[0]:
            own = _assignment_of(tree)
            if own != assignment.name:
                raise Rejected(f"these are files of {own or 'no assignment'}, not of {assignment.name}")
    return root


def put_back(root: Path, assignment: Assignment) -> None:
    """Write the files in which there was nothing to complete as they were released.

    Raises
    ------
    Rejected : the submission has a folder where a file belongs, or the other way round
    """
    for path, text in assignment.sources.items():
        if BEGIN not in text and path.name != ENTRY:
            try:
                (root / path).parent.mkdir(parents=True, exist_ok=True)
                (root / path).write_text(text, encoding="utf-8")
            except OSError:
                raise Rejected(
                    f"{path} is no file, or its folder no folder: keep the layout that was released"
                ) from None


def _assignment_of(tree: ast.Module) -> str | None:
    """Return the value of ``ASSIGNMENT = "..."`` in ``adapters.py``."""
    for node in tree.body:
        match node:
            case ast.Assign(targets=[ast.Name(id="ASSIGNMENT")], value=ast.Constant(value=str(name))):
                return name
    return None
