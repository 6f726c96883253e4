"""The table of deliberate breaks is sound: each can be made as it stands, and names tests that are run by default."""

import ast
import functools as ft

import pytest

from breaks import ROOT, Break, broken, read_table

TABLE = read_table()


@ft.cache
def text_of(file):
    return (ROOT / file).read_text(encoding="utf-8")


@ft.cache
def default_tests(file):
    """The test functions of a file that are not marked as slow as a whole."""
    functions = [node for node in ast.walk(ast.parse(text_of(file))) if isinstance(node, ast.FunctionDef)]
    marks = {node.name: [ast.unparse(each) for each in node.decorator_list] for node in functions}
    return {name for name, each in marks.items() if name.startswith("test_") and "pytest.mark.slow" not in each}


def test_there_are_enough_and_each_has_a_name_of_its_own():
    names = [each.name for each in TABLE]
    assert len(names) >= 60
    assert len(set(names)) == len(names)


def test_every_text_is_there_exactly_once_and_is_changed():
    wrong = {each.name for each in TABLE if text_of(each.file).count(each.text) != 1 or each.text == each.broken}
    assert not wrong


def test_every_break_leaves_a_program():
    for each in TABLE:
        ast.parse(text_of(each.file).replace(each.text, each.broken))


def test_every_named_test_exists_and_is_run_by_default():
    wrong = set()
    for each in TABLE:
        assert each.tests, each.name
        for test in each.tests:
            file, _, name = test.partition("::")
            if name.partition("[")[0] not in default_tests(file):
                wrong.add(test)
    assert not wrong


def test_every_layer_that_decides_verdicts_is_there():
    files = {each.file.removeprefix("qsmc_jax/").partition("/")[0] for each in TABLE}
    wanted = "campaign control enclosures implementation metrics model numerics robustness simulation statistics study"
    assert files >= {*wanted.split(), "tuning", "verification"}


def test_a_break_is_made_and_mended(tmp_path):
    (tmp_path / "rule.py").write_text("def rule(x):\n    return x < 1\n")
    path = tmp_path / "rule.py"
    before = path.stat().st_mtime_ns
    with broken(tmp_path, Break("one off", "rule.py", "x < 1", "x <= 1", ())):
        assert "x <= 1" in path.read_text()
    assert path.read_text() == "def rule(x):\n    return x < 1\n"
    assert path.stat().st_mtime_ns == before
    with pytest.raises(LookupError, match="0 times in `rule.py`, not once"):
        Break("gone", "rule.py", "x > 1", "x >= 1", ()).apply(tmp_path)
