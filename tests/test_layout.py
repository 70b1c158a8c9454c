"""Imports go core <- training <- pictures <- results <- cli and never back, and inside the core only upwards."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "agility_ref"
ROOMS = ("training", "pictures", "results", "cli")
CORE = (
    "terrain", "world", "go1", "simulation", "rewards", "observation", "env",
    "curriculum", "policy", "networks", "ppo", "selector", "evaluate",
)  # fmt: skip
LEAVES = ("__init__", "errors", "stats", "files")
DOOR = "__main__"  # ``python -m agility_ref`` opens the command line
ADAPTER = "gym"  # Gymnasium's way in, which draws as well; nothing of ours imports it
FILES = sorted(path.relative_to(PACKAGE).with_suffix("").parts for path in PACKAGE.rglob("*.py"))


def imported(parts):
    """Names of the modules of the package that a file imports, inside functions too, as tuples."""
    found = set()
    for node in ast.walk(ast.parse(PACKAGE.joinpath(*parts).with_suffix(".py").read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {tuple(alias.name.split(".")) for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{parts}: write the whole name of what is imported"
            base = tuple(node.module.split("."))
            # a name is a module where there is a file of that name, and else part of the module
            found |= {(*base, alias.name) if is_module((*base, alias.name)[1:]) else base for alias in node.names}
    return {name[1:] or ("__init__",) for name in found if name[0] == "agility_ref"}


def is_module(parts):
    path = PACKAGE.joinpath(*parts)
    return path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()


def floor(parts):
    """Return how far up a module stands: leaves in their order, then the core in its order, then the rooms."""
    if parts[0] in ROOMS:
        return len(CORE) + 1 + ROOMS.index(parts[0])
    if parts == (ADAPTER,):
        return len(CORE) + 1 + ROOMS.index("results")
    return LEAVES.index(parts[0]) - len(LEAVES) if parts[0] in LEAVES else 1 + CORE.index(parts[0])


@pytest.mark.parametrize("parts", FILES, ids=".".join)
def test_imports_go_one_way(parts):
    if parts == (DOOR,):
        assert imported(parts) == {("cli", "main")}
        return
    for other in imported(parts) - {parts}:
        within_a_room = parts[0] in ROOMS and parts[0] == other[0]
        assert within_a_room or floor(other) < floor(parts), f"{'.'.join(parts)} imports {'.'.join(other)}"


def test_every_file_has_a_place():
    top = {parts[0] for parts in FILES if len(parts) == 1}
    assert top == {*CORE, *LEAVES, DOOR, ADAPTER}
    assert {parts[0] for parts in FILES if len(parts) > 1} == set(ROOMS)


@pytest.mark.parametrize("room", ROOMS)
def test_each_room_says_what_it_is_for(room):
    tree = ast.parse((PACKAGE / room / "__init__.py").read_text(encoding="utf-8"))
    assert len(ast.get_docstring(tree).split("\n\n", 1)) == 2 and len(tree.body) == 1
