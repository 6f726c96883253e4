"""Deliberate breaks of rules that decide verdicts, each of which must fail a test that is run by default.

`python tests/breaks.py [NAME ...]` makes them one by one, in a temporary copy of the tree, and runs the tests named
with each; a break that none of its tests notices survives, and the command fails. `--list` shows them. The table is
`tests/data/breaks.toml`.
"""

import argparse
import concurrent.futures
import contextlib
import dataclasses
import multiprocessing
import os
import queue
import shutil
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TABLE = Path(__file__).with_name("data") / "breaks.toml"
# What the tests need: no more is copied.
COPIED = ("qsmc_jax", "tests", "studies", "pyproject.toml", "README.md", "CHANGELOG.md", "constraints.txt")
# Imported once, for all processes that run tests.
PRELOADED = ("jax", "diffrax", "optax", "optimistix", "scipy.stats", "scipy.optimize", "scipy.integrate", "matplotlib")
PRELOADED += ("beartype", "hypothesis", "mpmath", "pyarrow.parquet")
FORKS = multiprocessing.get_context("forkserver")
# Some of them are plugins of pytest, which would have liked to be the first to import them.
QUIET = ("-q", "-p", "no:cacheprovider", "-W", "ignore::pytest.PytestAssertRewriteWarning")
# Programs that a break leaves as they are need not be compiled again: JAX keeps them in a folder.
KEPT = {"JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0", "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1"}
# Seconds after which the tests of one break are given up, and those of all together while nothing is broken.
LONGEST, LONGEST_UNBROKEN = 600, 3600
# Exit codes of pytest, set apart from those of Python, which says 1 of any crash. Others mean that nothing was found.
APART = 100
PASSED, FAILED = APART + 0, APART + 1


@dataclasses.dataclass(frozen=True)
class Break:
    """A change that a careless hand could make, and the tests that notice it.

    Attributes:
        name: What the broken rule does.
        file: The file, relative to the root.
        text: What stands there, exactly once.
        broken: What is put in its place.
        tests: Node ids of pytest; at least one of them must fail.
    """

    name: str
    file: str
    text: str
    broken: str
    tests: tuple[str, ...]

    def apply(self, root: Path) -> str:
        """Breaks the rule in a tree, and returns the file as it was."""
        path = root / self.file
        whole = path.read_text(encoding="utf-8")
        count = whole.count(self.text)
        if count != 1:
            raise LookupError(f"`{self.name}`: its text is {count} times in `{self.file}`, not once.")
        path.write_text(whole.replace(self.text, self.broken), encoding="utf-8")
        return whole


@dataclasses.dataclass(frozen=True)
class Result:
    """What became of one break: "noticed", "SURVIVED", or what went wrong; with the time it took [s]."""

    name: str
    state: str
    seconds: float
    output: str = ""


def read_table() -> list[Break]:
    """All breaks, in the order of the table."""
    files = tomllib.loads(TABLE.read_text(encoding="utf-8"))
    return [
        Break(each["name"], file, each["text"], each["broken"], tuple(f"tests/{test}" for test in each["tests"]))
        for file, breaks in files.items()
        for each in breaks
    ]


def copy_tree(place: Path) -> Path:
    """A copy of the tree, as far as the tests need it; times of files are kept, so that bytecode stays good."""
    skip = shutil.ignore_patterns("__pycache__", ".hypothesis")
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, place / name, ignore=skip)
        elif source.exists():
            shutil.copy2(source, place / name)
    return place


def run_tests(
    root: Path, tests: Sequence[str], log: Path, options: Sequence[str] = (), is_broken: bool = True
) -> tuple[int, str]:
    """Exit code and output of pytest in a tree, in a process of its own that begins with the imports of others."""
    # What a broken file is compiled to is of no use to the next break.
    process = FORKS.Process(target=_pytest, args=(root, tests, log, options, not is_broken))
    process.start()
    longest = LONGEST if is_broken else LONGEST_UNBROKEN
    process.join(longest)
    if process.is_alive():
        process.kill()
        process.join()
        return -1, f"not done after {longest} s"
    return process.exitcode or -1, log.read_text(encoding="utf-8", errors="replace")


def _pytest(root: Path, tests: Sequence[str], log: Path, options: Sequence[str], write_bytecode: bool) -> None:
    with log.open("wb") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    os.chdir(root)
    os.environ["PYTHONPATH"] = str(root)
    sys.path.insert(0, str(root))
    sys.dont_write_bytecode = not write_bytecode
    import pytest

    sys.exit(APART + int(pytest.main([*QUIET, *options, *tests])))


@contextlib.contextmanager
def broken(root: Path, change: Break) -> Iterator[None]:
    """The tree with the break in it; afterwards as it was, times of files included."""
    path = root / change.file
    times = path.stat()
    whole = change.apply(root)
    try:
        yield
    finally:
        path.write_text(whole, encoding="utf-8")
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))


def try_break(change: Break, trees: "queue.Queue[Path]") -> Result:
    """Makes one break in a tree of its own, and runs its tests."""
    root, begin = trees.get(), time.perf_counter()
    try:
        with broken(root, change):
            code, output = run_tests(root, change.tests, root.with_suffix(".log"), ("-x",))
    except LookupError as error:
        code, output = -1, str(error)
    finally:
        trees.put(root)
    state = {FAILED: "noticed", PASSED: "SURVIVED"}.get(code, f"NOT TRIED ({output.strip().splitlines()[-1][:80]})")
    return Result(change.name, state, time.perf_counter() - begin, output)


def chosen(names: Sequence[str]) -> list[Break]:
    """The breaks with these names, or whose names hold one of them; all without one."""
    table = read_table()
    return [each for each in table if not names or any(name in each.name for name in names)]


def main(arguments: Sequence[str] | None = None) -> int:
    """Tries the breaks; 0 if each was noticed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="breaks to try, or parts of their names; all without")
    parser.add_argument("--list", action="store_true", help="show them and do nothing")
    parser.add_argument("--jobs", type=int, default=2, help="how many are tried at a time")
    parser.add_argument("--show", action="store_true", help="show what pytest says of a break that was not noticed")
    asked = parser.parse_args(arguments)
    breaks = chosen(asked.names)
    if asked.list or not breaks:
        for each in breaks:
            print(f"{each.name:70} {each.file}")
        return 0 if breaks else 2
    with tempfile.TemporaryDirectory(prefix="breaks-") as place:
        return _try_all(breaks, Path(place), asked.jobs, asked.show)


def pass_unbroken(tests: Sequence[str], copies: Sequence[Path], is_shown: bool) -> bool:
    """Whether the tests pass as long as nothing is broken, the files shared out over the copies."""
    files = sorted({test.partition("::")[0] for test in tests})
    place = {file: number % len(copies) for number, file in enumerate(files)}
    shares: dict[Path, list[str]] = {}
    for test in tests:
        shares.setdefault(copies[place[test.partition("::")[0]]], []).append(test)
    with concurrent.futures.ThreadPoolExecutor(len(copies)) as pool:
        run = lambda share: run_tests(*share, share[0].with_suffix(".log"), ("--durations=15",), False)  # noqa: E731
        found = list(pool.map(run, shares.items()))
    for code, output in found:
        print(f"unbroken: {output.strip().splitlines()[-1]}", flush=True)
        if code != PASSED or is_shown:
            print(output, flush=True)
    return all(code == PASSED for code, _ in found)


def _try_all(breaks: list[Break], place: Path, jobs: int, is_shown: bool) -> int:
    copies = [copy_tree(place / f"tree{number}") for number in range(jobs)]
    begin = time.perf_counter()
    os.environ.update(KEPT, JAX_COMPILATION_CACHE_DIR=str(place / "programs"))
    FORKS.set_forkserver_preload(list(PRELOADED))
    if not pass_unbroken(sorted({test for each in breaks for test in each.tests}), copies, is_shown):
        print("The tests must pass before they can notice anything.")
        return 1
    trees: queue.Queue[Path] = queue.Queue()
    for copy in copies:
        trees.put(copy)
    with concurrent.futures.ThreadPoolExecutor(jobs) as pool:
        results = []
        for result in pool.map(lambda each: try_break(each, trees), breaks):
            print(f"{result.seconds:6.1f} s  {result.state:9}  {result.name}", flush=True)
            results.append(result)
    missed, seconds = [each for each in results if each.state != "noticed"], time.perf_counter() - begin
    for each in missed:
        print(f"\n{each.state}: {each.name}")
        if is_shown:
            print(each.output)
    print(f"\n{len(results) - len(missed)} of {len(results)} breaks were noticed, in {seconds:.0f} s")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
