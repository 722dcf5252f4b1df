"""The rules of the house that a program can check."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("app", "meshes", "forms", "obstacles", "mpm", "hawkes", "native")
MAY_KNOW = {
    "app": {"app", "meshes", "forms", "obstacles", "mpm", "hawkes"},
    "forms": {"forms", "meshes", "obstacles", "native"},
    "meshes": {"meshes"},
    "obstacles": {"obstacles"},
    "mpm": {"mpm", "obstacles", "native"},
    "hawkes": {"hawkes", "native"},
    "native": {"native"},
}
SOURCES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
LONGEST = 400  # lines; a longer file has two subjects
# what a person touches belongs to app: arguments, scene files, the terminal, pictures, signals
APP_ONLY = {
    "argparse",
    "signal",
    "tomllib",
    "rich",
    "pydantic",
    "matplotlib",
    "pyvista",
    "mitsuba",
}


def name(path: Path) -> str:
    return str(path.relative_to(ROOT))


def package_of(path: Path) -> str:
    return path.relative_to(ROOT).parts[0]


def imports(path: Path) -> Iterator[tuple[int, str]]:
    """Line and full name of every module that a file imports, at the top or inside a function."""
    here = ["extremal", *path.relative_to(ROOT).parts[:-1]]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = here[: len(here) - node.level + 1] if node.level else []
            module = ".".join([*base, node.module] if node.module else base)
            yield from ((node.lineno, f"{module}.{alias.name}") for alias in node.names)


def definitions(path: Path) -> Iterator[ast.FunctionDef | ast.ClassDef]:
    """Public functions and classes of a file, and the public methods of its public classes."""
    queue: list[ast.AST] = [ast.parse(path.read_text())]
    while queue:
        for node in ast.iter_child_nodes(queue.pop()):
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                yield node
                if isinstance(node, ast.ClassDef):
                    queue.append(node)


def needs_docstring(node: ast.FunctionDef | ast.ClassDef) -> bool:
    """Overloads, properties and one-line methods speak through their names and types."""
    if isinstance(node, ast.ClassDef):
        return True
    decorators = {ast.unparse(decorator).split("(")[0] for decorator in node.decorator_list}
    is_method = bool(node.args.args) and node.args.args[0].arg in ("self", "cls")
    if decorators & {
        "overload",
        "typing.overload",
        "property",
        "cached_property",
        "field_validator",
        "model_validator",
        "override",
    } or any(d.endswith(".setter") for d in decorators):
        return False
    return not (is_method and len(node.body) == 1)


@pytest.mark.parametrize("path", SOURCES, ids=name)
def test_packages_know_only_whom_they_may(path):
    allowed = MAY_KNOW[package_of(path)]
    strangers = [
        f"{name(path)}:{line} imports {module}"
        for line, module in imports(path)
        if module.startswith("extremal.") and module.split(".")[1] not in allowed
    ]
    assert not strangers


@pytest.mark.parametrize("path", [p for p in SOURCES if package_of(p) != "app"], ids=name)
def test_only_app_prints_parses_or_draws(path):
    found = [
        f"{name(path)}:{line} imports {module}"
        for line, module in imports(path)
        if module.split(".")[0] in APP_ONLY
    ]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call) and ast.unparse(node.func) in ("print", "input", "PETSc.Sys.Print"):
            found.append(f"{name(path)}:{node.lineno} calls {ast.unparse(node.func)}")
        if isinstance(node, ast.Attribute) and ast.unparse(node) in ("sys.argv", "sys.stdout", "sys.stderr"):
            found.append(f"{name(path)}:{node.lineno} uses {ast.unparse(node)}")
    assert not found


@pytest.mark.parametrize("path", [p for p in SOURCES if package_of(p) != "meshes"], ids=name)
def test_only_meshes_knows_gmsh(path):
    assert not [f"{name(path)}:{line}" for line, module in imports(path) if module.split(".")[0] == "gmsh"]


@pytest.mark.parametrize("path", [p for p in SOURCES if package_of(p) != "app"], ids=name)
def test_only_compat_asks_for_a_version(path):
    if path.name != "compat.py":
        tree = ast.walk(ast.parse(path.read_text()))
        names = [node for node in tree if isinstance(node, ast.Attribute)]
        asked = [n.lineno for n in names if n.attr in ("__version__", "getVersion", "getVersionInfo")]
        assert not asked, (
            f"{name(path)}: lines {asked}; version differences belong in {package_of(path)}/compat.py"
        )


def test_no_file_has_two_subjects():
    files = [
        *SOURCES,
        *(ROOT / "tests").glob("*.py"),
        *(p for k in PACKAGES for p in (ROOT / k).rglob("*.[ch]")),
    ]
    lengths = {name(path): len(path.read_text().splitlines()) for path in files}
    assert not {path: length for path, length in lengths.items() if length > LONGEST}


@pytest.mark.parametrize("path", SOURCES, ids=name)
def test_what_is_public_has_a_docstring(path):
    bare = [
        f"{name(path)}:{node.lineno} {node.name}"
        for node in definitions(path)
        if needs_docstring(node) and not ast.get_docstring(node)
    ]
    if not ast.get_docstring(ast.parse(path.read_text())):
        bare.insert(0, f"{name(path)}:1 the module")
    assert not bare


def test_the_command_line_starts_without_heavy_libraries():
    heavy = ("dolfinx", "gmsh", "matplotlib", "scipy", "sympy", "meshio", "petsc4py", "pyvista", "mitsuba")
    code = f"import sys, extremal.app.cli; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.stdout.strip(), done.stderr) == ("[]", "")


def test_files_stand_on_their_own():
    """Nothing points to a folder beside the repository."""
    outside = "shared" + "/"
    suffixes = {".py", ".md", ".toml", ".c", ".h", ".sh", ".cfg", ".txt"}
    folders = (*PACKAGES, "tests", "docs", ".ci")
    files = [p for f in folders for p in (ROOT / f).rglob("*") if p.suffix in suffixes or p.name == "run"]
    files += [p for p in ROOT.iterdir() if p.is_file() and (p.suffix in suffixes or p.name == "Makefile")]
    assert not [name(path) for path in files if outside in path.read_text(errors="replace")]
