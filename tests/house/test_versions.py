"""Versions that are promised are those that are tested."""

import re
import subprocess
import tomllib

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

import places

ROOT = places.ROOT
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
# Tools of developers are tested in one version; extras for notebooks, clusters and comparisons too.
PROMISED = [Requirement(text) for text in [*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["test"]]]


def pins(name):
    """The versions of a file of constraints."""
    lines = (ROOT / name).read_text(encoding="utf-8").splitlines()
    pairs = (line.split("==") for line in lines if line and not line.startswith("#"))
    return {canonicalize_name(package): Version(version) for package, version in pairs}


@pytest.mark.parametrize("requirement", PROMISED, ids=lambda each: each.name)
def test_a_lower_bound_is_the_lowest_version_that_is_tested(requirement):
    (bound,) = requirement.specifier
    assert bound.operator == ">="
    assert pins("constraints-lowest.txt")[canonicalize_name(requirement.name)] == Version(bound.version)


def test_pinned_versions_are_allowed_and_no_older_than_the_lowest():
    lowest, pinned = pins("constraints-lowest.txt"), pins("constraints.txt")
    for requirement in PROMISED:
        assert pinned[canonicalize_name(requirement.name)] in requirement.specifier
    for name, version in lowest.items():
        assert version <= pinned.get(name, version)


def test_pythons_are_listed_from_the_oldest_that_is_allowed():
    listed = [each.rpartition(" :: ")[2] for each in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", each)]
    assert PROJECT["requires-python"] == f">={listed[0]}"
    first = int(listed[0].removeprefix("3."))
    assert listed == [f"3.{minor}" for minor in range(first, first + len(listed))]


def test_the_script_names_its_sets_and_tests_that_exist():
    done = subprocess.run(["bash", ROOT / ".ci" / "versions", "--help"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    for word in ("lowest", "pinned", "newest", "--quick", "--full", "constraints-lowest.txt"):
        assert word in done.stderr
    text = (ROOT / ".ci" / "versions").read_text(encoding="utf-8")
    for path, test in re.findall(r"^    (tests/\w+\.py)(?:::(\w+))?$", text, re.MULTILINE):
        assert f"def {test or 'test_'}" in (ROOT / path).read_text(encoding="utf-8")
