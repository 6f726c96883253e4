"""Every public name says what it does, what it takes and what it gives, and shows it by an example that runs."""

import dataclasses
import doctest
import importlib
import inspect
import re
import sys

import jax
import pytest

import qsmc_jax as qj
from qsmc_jax.base.precision import enable_x64

SECTION = re.compile(r"^(Attributes|Args|Returns|Yields|Raises|Examples|Source):")
ENTRY = re.compile(r"^ {4}(?=[*\w])([*\w]+(?:, [*\w]+)*):(?: |$)")
# A summary that names what is given, as this house's do.
PLAIN = re.compile(r"^(The|A|An|Whether|How|What)\b")
# Arguments that are those of a neighbour, and others by name.
AS_FOR = re.compile(r"^Arguments.*: as `(\w+)`(.*)$", re.M)
# Examples that compile a solve take seconds each.
DEAR = re.compile(
    r"\b(simulate|replay|monte_carlo|stream|verify|compare|critical_value|robustness_map|tune|landscape|falsify|certify|card|run_campaign|"
    r"work_shard|signals|solve)\("
)
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def public_names():
    """Every public class and function by its full name."""
    found = {f"qj.{name}": getattr(qj, name) for name in qj._HOMES}
    for space, home in qj._NAMESPACES.items():
        module = importlib.import_module(home)
        found |= {f"qj.{space}.{name}": thing for name, thing in vars(module).items() if is_of(module, name, thing)}
    return found


def is_of(module, name, thing):
    """Whether a name is a module's own, or re-exported by a package from its modules."""
    if name.startswith("_") or not (inspect.isclass(thing) or inspect.isfunction(thing)):
        return False
    home = thing.__module__
    return home == module.__name__ or (hasattr(module, "__path__") and home.startswith(f"{module.__name__}."))


def sections(thing):
    """The sections of a thing's own docstring by their headings, the summary as "": lists of lines."""
    found, heading = {"": []}, ""
    own = thing.__dict__.get("__doc__") if inspect.isclass(thing) else getattr(thing, "__doc__", None)
    for line in inspect.cleandoc(own or "").splitlines():
        match = SECTION.match(line)
        heading = match[1] if match else heading
        found.setdefault(heading, []).append(line)
    return found


def documented(thing, heading):
    """The names that a section explains."""
    entries = (ENTRY.match(line) for line in sections(thing).get(heading, []))
    return {name.lstrip("*") for entry in entries if entry for name in entry[1].split(", ")}


def arguments(function):
    """The arguments that a function explains, or that a neighbour does for it."""
    like, told = AS_FOR.search(inspect.getdoc(function) or ""), documented(function, "Args")
    if like is None:
        return told
    neighbour = getattr(sys.modules[function.__module__], like[1])
    return told | documented(neighbour, "Args") | set(re.findall(r"`(\w+)`", like[2]))


def parameters(function):
    names = list(inspect.signature(function).parameters)
    return [name for name in names if name not in ("self", "cls")]


def fields(cls):
    if dataclasses.is_dataclass(cls):
        return [field.name for field in dataclasses.fields(cls) if not field.name.startswith("_")]
    return list(getattr(cls, "_fields", ()))


def methods(cls):
    """The public functions that stand in the body of a class."""
    unwrapped = {name: getattr(value, "__func__", value) for name, value in vars(cls).items()}
    functions = {name: f for name, f in unwrapped.items() if inspect.isfunction(f) and not name.startswith("_")}
    return {name: f for name, f in functions.items() if f.__qualname__.startswith(f"{cls.__qualname__}.")}


def is_documented_above(cls, name):
    """Whether a base declares and documents a method."""
    return any(vars(base)[name].__doc__ for base in cls.__mro__[1:] if name in vars(base))


def holes(thing):
    """What the docstring of a class or a function lacks."""
    summary = "".join(sections(thing)[""][:1]).strip()
    lacks = [] if summary else ["a summary"]
    if inspect.isclass(thing):
        explained = set().union(*(documented(cls, "Attributes") for cls in thing.__mro__))
        lacks += [f"attribute {name}" for name in fields(thing) if name not in explained]
        for name, method in methods(thing).items():
            if not is_documented_above(thing, name):
                missing = [each for each in parameters(method) if each not in documented(method, "Args")]
                lacks += [f"argument {each} of {name}" for each in missing]
        return lacks
    takes = parameters(thing)
    lacks += [f"argument {name}" for name in takes if name not in arguments(thing)]
    gives = inspect.signature(thing).return_annotation not in (None, "None", inspect.Signature.empty)
    is_told = not takes or PLAIN.match(summary) or {"Returns", "Yields"} & set(sections(thing))
    return lacks if is_told or not gives else [*lacks, "what it returns"]


def has_example(thing):
    return any(line.strip().startswith(">>>") for line in sections(thing).get("Examples", []))


def examples():
    """Every docstring with an example, of public names and of their methods."""
    found = {}
    for name, thing in NAMES.items():
        inner = {f"{name}.{key}": method for key, method in methods(thing).items()} if inspect.isclass(thing) else {}
        for label, each in {name: thing, **inner}.items():
            text = each.__doc__ or ""
            if ">>>" in text:
                found[label] = text
    return found


def run_example(name, text):
    """Runs an example as a user would, who has set nothing; returns what it printed in place of what it says."""
    if "jax.enable_x64" in text and not hasattr(jax, "enable_x64"):
        pytest.skip("it shows a function that this version of JAX has elsewhere")
    said = []
    test = doctest.DocTestParser().get_doctest(text, {"__name__": "__main__"}, name, None, 0)
    with enable_x64(False), jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        doctest.DocTestRunner(optionflags=FLAGS).run(test, out=said.append)
    return "".join(said)


NAMES = public_names()
EXAMPLES = examples()
CHEAP = sorted(name for name, text in EXAMPLES.items() if not DEAR.search(text))
COSTLY = sorted(set(EXAMPLES) - set(CHEAP))


@pytest.mark.parametrize("name", sorted(NAMES))
def test_a_docstring_tells_everything(name):
    assert holes(NAMES[name]) == []


@pytest.mark.parametrize("name", sorted(NAMES))
def test_a_docstring_shows_an_example(name):
    assert has_example(NAMES[name])


@pytest.mark.parametrize("name", CHEAP)
def test_an_example_runs(name):
    assert run_example(name, EXAMPLES[name]) == ""


@pytest.mark.slow
@pytest.mark.parametrize("name", COSTLY)
def test_an_example_that_solves_runs(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run_example(name, EXAMPLES[name]) == ""


@dataclasses.dataclass
class Leaky:
    """A made-up class.

    Attributes:
        told: One of its two fields.
    """

    told: float
    untold: float

    def scaled(self, factor, offset):
        """A method that tells one of its two arguments.

        Args:
            factor: Told.
        """


def leaky(told: float, untold: float) -> float:
    """Adds, and tells neither one argument nor the result.

    Args:
        told: One of its two arguments.
    """
    return told + untold


def like_leaky(told: float, own: float, untold: float) -> None:
    """Takes what a neighbour tells, and more.

    Arguments: as `leaky`; `own` is told here.
    """


def silent(*values: float) -> None:
    pass


def test_a_field_and_an_argument_without_a_word_are_found():
    assert holes(Leaky) == ["attribute untold", "argument offset of scaled"]


def test_an_argument_and_a_result_without_a_word_are_found():
    assert holes(leaky) == ["argument untold", "what it returns"]


def test_arguments_may_be_those_of_a_neighbour_that_tells_them():
    assert holes(like_leaky) == ["argument untold"]


def test_a_missing_docstring_is_found():
    assert holes(silent) == ["a summary", "argument values"]


def test_a_missing_example_is_found():
    assert not has_example(leaky)


@pytest.mark.parametrize("text", [">>> 1 + 1\n3\n", ">>> qj.tight()\n"])
def test_an_example_that_is_wrong_or_imports_too_little_is_found(text):
    assert "Failed example" in run_example("made up", text)


def test_names_are_those_of_the_package_and_no_import_of_its_modules():
    names = set(NAMES)
    assert {"qj.simulate", "qj.disturbances.Sine", "qj.campaign.prepare", "qj.thresholds.escape_time"} <= names
    assert not {name for name in names if name.endswith((".require", ".float_field", ".AbstractModule"))}
