"""House rules that no linter knows: abstract or final, small files and functions, a flat public API, nothing local."""

import ast
import functools as ft
import graphlib
import importlib
import inspect
import pkgutil
import re
import subprocess
import textwrap
from pathlib import Path

import equinox as eqx
import pytest

import places
import qsmc_jax as qj

ROOT = places.ROOT
PACKAGE = sorted((ROOT / "qsmc_jax").rglob("*.py"))
SOURCES = [path for folder in ("qsmc_jax", "studies", "tests") for path in sorted((ROOT / folder).rglob("*.py"))]
MODULE_INFOS = list(pkgutil.walk_packages(qj.__path__, "qsmc_jax."))
MODULES = [importlib.import_module(info.name) for info in MODULE_INFOS]
LONGEST_FILE = 400
LONGEST_FUNCTION = 60

# What must not be committed: folders of somebody's machine, hosts of package registries.
LOCAL = re.compile(
    r"(?<![\w./-])/(?:work|root|home|opt|tmp)/\w|files\.pythonhosted|pypi\.org|registry\.npmjs|index-url|deb\.debian"
)


def name_of(path):
    return str(path.relative_to(ROOT))


@ft.cache
def tree_of(path):
    return ast.parse(path.read_text(encoding="utf-8"))


def is_public(node):
    return not node.name.startswith("_")


def classes():
    """Every `eqx.Module` that the package defines."""
    members = (member for module in MODULES for member in vars(module).values() if inspect.isclass(member))
    return sorted({c for c in members if issubclass(c, eqx.Module) and is_ours(c)}, key=lambda c: c.__qualname__)


def is_ours(cls):
    return cls.__module__.startswith("qsmc_jax")


@ft.cache
def own_methods(cls):
    """The methods that stand in the body of a class, and whether each is abstract."""
    (body,) = ast.parse(textwrap.dedent(inspect.getsource(cls))).body
    functions = (node for node in body.body if isinstance(node, ast.FunctionDef))
    return {f.name: any("abstractmethod" in ast.unparse(d) for d in f.decorator_list) for f in functions}


def overridden(cls):
    """The implemented methods of its bases that a class implements again."""
    may_repeat = {"__init__", "__check_init__", "break_times"}  # the last has a default, since most have none
    implemented = {
        name
        for base in cls.__mro__[1:]
        if is_ours(base)
        for name, is_abstract in own_methods(base).items()
        if not is_abstract
    }
    return implemented & set(own_methods(cls)) - may_repeat


def functions_in(path):
    return [node for node in ast.walk(tree_of(path)) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]


def length(function):
    """Lines of a function without its docstring."""
    first = function.body[0]
    lines = function.end_lineno - function.lineno + 1
    return lines if ast.get_docstring(function) is None else lines - (first.end_lineno - first.lineno + 1)


def public_nodes(path):
    """A module, its public classes and its public functions."""
    tree = tree_of(path)
    return [tree, *(n for n in tree.body if isinstance(n, ast.FunctionDef | ast.ClassDef) and is_public(n))]


def own_files():
    """Files that are committed, or would be."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("not a git checkout")
    return [ROOT / line for line in listed.stdout.splitlines() if (ROOT / line).is_file()]


def reexports():
    """The (module, name, alias) of every import in the package's `__init__`."""
    tree = tree_of(ROOT / "qsmc_jax" / "__init__.py")
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    ours = [node for node in imports if node.module.startswith("qsmc_jax")]
    return [(node.module, alias.name, alias.asname) for node in ours for alias in node.names]


def offenders(check, things, name):
    """What `check` finds wrong, by the name of the thing."""
    found = {name(thing): check(thing) for thing in things}
    return {key: value for key, value in found.items() if value}


def class_name(cls):
    return f"{cls.__module__}.{cls.__qualname__}"


def concrete_bases(cls):
    return [base.__name__ for base in cls.__mro__[1:] if is_ours(base) and not base.__name__.startswith("Abstract")]


def too_long(path):
    lines = len(path.read_text(encoding="utf-8").splitlines())
    return lines if lines >= LONGEST_FILE else None


def long_functions(path):
    return {f.name: length(f) for f in functions_in(path) if length(f) >= LONGEST_FUNCTION}


def futures(path):
    return [n.module for n in tree_of(path).body if isinstance(n, ast.ImportFrom) and n.module == "__future__"]


def undocumented(path):
    return [getattr(node, "name", "module") for node in public_nodes(path) if ast.get_docstring(node) is None]


def local_names(path):
    return LOCAL.findall(path.read_text(encoding="utf-8", errors="ignore"))


def imported(module):
    """The modules of the package that a module imports, wherever in it."""
    tree = tree_of(Path(importlib.import_module(module).__file__))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and is_ours_named(node.module)]
    names = {f"{node.module}.{alias.name}" for node in imports for alias in node.names}
    known = {info.name for info in MODULE_INFOS}
    return {name if name in known else name.rpartition(".")[0] for name in names} - {"qsmc_jax"}


def is_ours_named(module):
    return (module or "").startswith("qsmc_jax.")


def test_only_abstract_classes_are_subclassed():
    assert offenders(concrete_bases, classes(), class_name) == {}


def test_no_implemented_method_is_overridden():
    assert offenders(overridden, classes(), class_name) == {}


def test_files_are_short():
    assert offenders(too_long, SOURCES, name_of) == {}


def test_functions_fit_a_screen():
    assert offenders(long_functions, SOURCES, name_of) == {}


def test_annotations_are_evaluated():
    assert offenders(futures, SOURCES, name_of) == {}


def test_no_file_imports_itself_through_others():
    """Not even for an annotation: what two files share lies below both."""
    graphlib.TopologicalSorter({info.name: imported(info.name) for info in MODULE_INFOS}).prepare()


def test_what_is_public_has_a_docstring():
    assert offenders(undocumented, PACKAGE, name_of) == {}


def test_public_names_are_exported_under_their_own_name():
    assert [name for _, name, alias in reexports() if alias != name] == []


def test_public_names_are_loaded_from_where_type_checkers_see_them():
    seen = {name: getattr(importlib.import_module(module), name) for module, name, _ in reexports()}
    assert {name: getattr(qj, name) for name in seen} == seen


def test_every_public_name_is_listed():
    listed = {name for name in dir(qj) if not name.startswith("_")}
    assert {name for _, name, _ in reexports()} <= listed


def test_an_unknown_name_is_refused():
    with pytest.raises(AttributeError, match="has no attribute `simulator`"):
        _ = qj.simulator


def test_files_name_no_folder_of_a_machine_and_no_registry():
    others = [path for path in own_files() if path != Path(__file__)]
    assert offenders(local_names, others, name_of) == {}
