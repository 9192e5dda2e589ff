"""Imports go one way, from the command line down to the data types; only the command line prints."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = "pwralign_kin"
ROOT = Path(__file__).resolve().parent.parent / PACKAGE

LEVELS = (
    {
        "arrays", "exceptions", "checked_options", "dependencies", "directions", "files", "lengths", "read_only", "se3",
        "state", "kernels",
    },
    {"model", "scan"},
    {"estimation", "simulation", "render"},
    {"baselines", "tracking", "export"},
    {"benchmark"},
    {"cli"},
)  # fmt: skip
LEVEL = {name: level for level, names in enumerate(LEVELS) for name in names}

ESTIMATION = (
    "stopwatch", "sensing", "knowledge", "comparison", "refinement", "evidence", "doubt", "search", "options", "result",
    "answers", "stages", "reporting", "estimator", "second_looks", "shared_base", "entry",
)  # fmt: skip
"""The folders and modules of the estimation, each on what stands before it."""

ON_KERNELS = {"comparison/scan_comparison.py", "search/tree_search.py"}
"""What alone reaches through to the `kernels.Search` of a scan."""

ONLY_WHEN_CALLED = {
    "casadi", "collada", "cyclopts", "lxml", "matplotlib", "open3d", "PIL", "pinocchio", "platformdirs",
    "rich", "rosbags", "scipy", "trimesh", "xacro", "xacrodoc", "yaml", "yourdfpy",
}  # fmt: skip

FILES = sorted(ROOT.rglob("*.py"))


def _unit(path: Path) -> str:
    """Name of the module or subpackage directly below the package that a file belongs to."""
    return path.relative_to(ROOT).with_suffix("").parts[0]


def _imported(node: ast.AST) -> Iterator[str]:
    """Absolute names of what a node imports, each import of several names one by one."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        assert node.level == 0, "imports are absolute"
        yield from (f"{node.module}.{alias.name}" for alias in node.names)


def _at_top_level(tree: ast.Module) -> Iterator[ast.AST]:
    """Statements that run on import: not those in functions, nor those for the type checker only."""
    pending: list[ast.AST] = list(tree.body)
    while pending:
        node = pending.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            continue
        yield node
        pending.extend(ast.iter_child_nodes(node))


def _id(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("path", FILES, ids=_id)
def test_imports_go_down_only(path: Path) -> None:
    importer = _unit(path)
    if importer == "__init__":
        return
    assert importer in LEVEL, f"{importer} has no level yet"
    allowed = {importer, *(name for name, level in LEVEL.items() if level < LEVEL[importer])}
    if LEVEL[importer] == 0:
        allowed |= LEVELS[0]
    names = {name for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) for name in _imported(node)}
    own = {name.split(".")[1] for name in names if name.startswith(f"{PACKAGE}.")}
    assert own <= allowed


@pytest.mark.parametrize("path", [path for path in FILES if _unit(path) == "estimation"], ids=_id)
def test_the_estimation_is_built_up_in_order(path: Path) -> None:
    importer = path.relative_to(ROOT / "estimation").with_suffix("").parts[0]
    if importer == "__init__":
        return
    names = {name for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) for name in _imported(node)}
    own = {name.split(".")[2] for name in names if name.startswith(f"{PACKAGE}.estimation.")}
    assert own <= set(ESTIMATION[: ESTIMATION.index(importer) + 1])


def test_only_the_comparison_and_the_search_reach_through_to_their_kernels() -> None:
    files = [path for path in FILES if _unit(path) == "estimation"]
    through = {
        path.relative_to(ROOT / "estimation").as_posix()
        for path in files
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute) and node.attr == "native"
    }
    assert through == ON_KERNELS


@pytest.mark.parametrize("path", FILES, ids=_id)
def test_heavy_libraries_load_only_when_used(path: Path) -> None:
    verb = _unit(path) == "cli" and path.name != "__init__.py"
    allowed = {"cyclopts"} if verb else set()  # a verb's module is itself imported only when the verb is called
    tree = ast.parse(path.read_text(encoding="utf-8"))
    loaded = {name.partition(".")[0] for node in _at_top_level(tree) for name in _imported(node)}
    assert not loaded & (ONLY_WHEN_CALLED - allowed)


@pytest.mark.parametrize("path", [path for path in FILES if _unit(path) != "cli"], ids=_id)
def test_the_library_neither_prints_nor_exits(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            assert called not in {"print", "exit", "quit", "sys.exit", "os._exit", "breakpoint"}, node.lineno
            assert not called.startswith(("sys.stdout.", "sys.stderr.", "warnings.warn")), node.lineno


def test_every_module_has_a_level_and_every_level_is_checked() -> None:
    assert {_unit(path) for path in FILES} - {"__init__"} <= set(LEVEL)
    assert len(FILES) > 20
