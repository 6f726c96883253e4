"""Results as files of numbers and texts: nothing in one is ever run."""

import dataclasses
import enum
import importlib
import io
import json
import operator
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from qsmc_jax.base.atomic import write_whole
from qsmc_jax.base.checks import require, show
from qsmc_jax.base.errors import InputError
from qsmc_jax.campaign.columns import own_records
from qsmc_jax.campaign.folder import RunFolder
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.metrics.metric import AbstractMeasure
from qsmc_jax.multivariable import MultivariableLoop
from qsmc_jax.proof.certify import load_proof
from qsmc_jax.proof.checker import PROOF
from qsmc_jax.study.runs import Runs, concatenate
from qsmc_jax.study.study import Study

# The file of a result in a folder that a command wrote.
RESULT = "result.npz"
_FORMAT = 1
_OURS = "qsmc_jax."
_NEEDED = "Give the study, or the loop, that it is of: `qj.load(path, of=study)`. Code is not kept in files."


def save(result: Any, path: str | Path) -> None:
    """Writes a result to one file, from which `load` makes it again.

    Numbers keep all their digits. A study, functions and classes of your own are code, which is not written: `load`
    asks for them.

    Args:
        result: Runs, a trajectory, a verification, a map, or whatever else this package returns as a result.
        path: The file; one that exists is replaced.

    Raises:
        InputError: It is no result, or the file can't be written; nothing is left behind.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> import qsmc_jax as qj
        >>> run = qj.simulate(qj.paper.example1(), [0.9, 0.9], t1=2.0, bandwidth=0.1)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     qj.save(run, Path(folder) / "run.npz")
        ...     again = qj.load(Path(folder) / "run.npz")
        >>> again.verdict.name, bool((again.x == run.x).all())
        ('HELD', True)
    """
    path = Path(path)
    is_place = bool(path.name) and path.parent.is_dir() and not path.is_dir()
    require(is_place, f"Argument `path` must be a file in a folder that exists, but is `{path}`.")
    write_whole(path, as_bytes(result))


def as_bytes(result: Any) -> bytes:
    """The content of the file of a result.

    Args:
        result: The result.

    Raises:
        InputError: It is no result of this package.
    """
    is_ours = dataclasses.is_dataclass(result) and type(result).__module__.startswith(_OURS)
    require(is_ours, f"Argument `result` must be a result of qsmc_jax, but is a `{type(result).__name__}`.")
    arrays: list[np.ndarray] = []
    content = {"format": _FORMAT, "result": _encoded(result, arrays, ())}
    file = io.BytesIO()
    np.savez_compressed(file, content=np.array(json.dumps(content)), **{f"a{i}": a for i, a in enumerate(arrays)})
    return file.getvalue()


def load(path: str | Path, of: Study | ClosedLoop | MultivariableLoop | None = None) -> Any:
    """Reads what `save` or the option `--out` of a command wrote.

    Args:
        path: A file of `save`, or a folder of `--out`. That of `qsmc verify` gives its rows so far, as `Runs`; that of
            `qsmc certify` a proof, checked again.
        of: The study of the result, or the loop of a trajectory; needed where it holds one, or code of your own. Of a
            trajectory it is not checked that this code is what it was.

    Returns:
        The result, its arrays NumPy's.

    Raises:
        InputError: There is no result, it is damaged or of a newer version, or `of` is missing or another study.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=2.0)
        >>> study = qj.Study(scenario, bandwidth=0.1)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     qj.save(study.replay(3), Path(folder) / "run.npz")
        ...     again = qj.load(Path(folder) / "run.npz", of=study)
        >>> again.verdict.name, again.ts.shape
        ('HELD', (2001,))
    """
    path, own = Path(path), list(_classes_in(of))
    if path.is_dir() and (path / "manifest.json").exists():
        return _rows(RunFolder.open(path))
    if path.is_dir() and (path / PROOF).exists():
        require(of is None or isinstance(of, Study), "Argument `of` must be the study of the proof.")
        return load_proof(path, of)
    file = path / RESULT if path.is_dir() else path
    require(file.is_file(), f"Argument `path` must be a result or a folder with one, but there is no `{file}`.")
    try:
        with np.load(io.BytesIO(file.read_bytes()), allow_pickle=False) as found:
            arrays = {name: found[name] for name in found.files}
        content = json.loads(str(arrays.pop("content")))
        made_by = content["format"]
        require(made_by == _FORMAT, f"File `{file}` has format {made_by}, but this version reads {_FORMAT}.")
        return _Reader(arrays, of, own).decoded(content["result"])
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001  # whatever a damaged file may raise
        raise InputError(f"File `{file}` is no result of `qj.save`, or damaged: {error}.") from None


def _rows(folder: RunFolder) -> Runs:
    tables = list(folder.tables())
    require(len(tables) > 0, f"Folder `{folder.path}` has no rows yet.")
    return dataclasses.replace(concatenate(tables), records=own_records(folder.schema()))


def _encoded(value: Any, arrays: list[np.ndarray], place: tuple[str | int, ...]) -> Any:
    """A value as JSON; arrays stand in the list, by their number, and functions by their place in the loop."""
    if value is None or isinstance(value, bool | str) or (type(value) is int):
        return value
    if isinstance(value, enum.Enum):
        return {"enum": _name(type(value)), "value": value.name}
    if type(value) is float:
        return {"float": value.hex()}
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        arrays.append(np.asarray(value))
        require(arrays[-1].dtype.kind != "O", f"An array of objects in a result can't be written: {show(value)}.")
        return {"scalar" if isinstance(value, np.generic) else "array": f"a{len(arrays) - 1}"}
    if isinstance(value, Study):
        values = {name: _encoded(each, arrays, ()) for name, each in value.values.items()}
        return {"study": value.contents, "bandwidth": _hexed(value.bandwidth), "values": {"map": values}}
    if isinstance(value, AbstractMeasure):
        return {"measure": value.name, "kind": type(value).__name__}
    if isinstance(value, Mapping) and all(isinstance(name, str) for name in value):
        return {"map": {name: _encoded(each, arrays, (*place, name)) for name, each in value.items()}}
    if isinstance(value, list | tuple):
        kind = "list" if isinstance(value, list) else "tuple"
        return {kind: [_encoded(each, arrays, (*place, i)) for i, each in enumerate(value)]}
    if callable(value) and not dataclasses.is_dataclass(value):
        return {"function": list(place)}
    is_known = dataclasses.is_dataclass(value)
    require(is_known, f"A `{type(value).__name__}` in a result can't be written: {show(value)}.")
    place = () if isinstance(value, ClosedLoop | MultivariableLoop) else place
    fields = {f.name: _encoded(getattr(value, f.name), arrays, (*place, f.name)) for f in dataclasses.fields(value)}
    return {"class": _name(type(value)), "fields": fields}


def _name(cls: type) -> str:
    return f"{cls.__module__}:{cls.__qualname__}"


def _classes_in(of: Any) -> Iterator[type]:
    """The classes that a study or a loop is made of."""
    of = of.nominal.loop if isinstance(of, Study) else of
    if isinstance(of, list | tuple):
        for each in of:
            yield from _classes_in(each)
    elif dataclasses.is_dataclass(of):
        yield type(of)
        for field in dataclasses.fields(of):
            yield from _classes_in(getattr(of, field.name))


@dataclasses.dataclass(frozen=True)
class _Reader:
    """Makes values again.

    Attributes:
        arrays: Arrays by name.
        of: The study or the loop that was given.
        own: The classes in it.
    """

    arrays: Mapping[str, np.ndarray]
    of: Study | ClosedLoop | MultivariableLoop | None
    own: list[type]

    def decoded(self, value: Any) -> Any:
        """A value of its JSON."""
        if not isinstance(value, dict):
            return value
        kind, content = next(iter(value.items()))
        match kind:
            case "float":
                return float.fromhex(content)
            case "array":
                return self.arrays[content]
            case "scalar":
                return self.arrays[content][()]
            case "map":
                return {name: self.decoded(each) for name, each in content.items()}
            case "list" | "tuple":
                return (list if kind == "list" else tuple)(map(self.decoded, content))
        return getattr(self, f"_{kind}")(**value)

    def _enum(self, enum: str, value: str) -> Any:
        return self._named(enum)[value]

    def _function(self, function: list[str | int]) -> Any:
        """What stands at a place of the loop that was given."""
        found: Any = self.of.nominal.loop if isinstance(self.of, Study) else self.of
        require(found is not None, f"The result has a function of your own. {_NEEDED}")
        for each in function:
            is_container = isinstance(found, Mapping | list | tuple)
            found = operator.getitem(found, each) if is_container else getattr(found, str(each))
        require(callable(found), f"The loop of `of` has no function at `{'.'.join(map(str, function))}`.")
        return found

    def _measure(self, measure: str, kind: str) -> AbstractMeasure:
        """A metric or a requirement of the study that was given."""
        known = self.of.measures if isinstance(self.of, Study) else ()
        found = [each for each in known if (each.name, type(each).__name__) == (measure, kind)]
        require(len(found) == 1, f"The result has the study's own metric `{measure}`. {_NEEDED}")
        return found[0]

    def _class(self, fields: Mapping[str, Any], **named: str) -> Any:
        """What a class is of: as it was, without its constructor, which takes what a user writes."""
        name = named["class"]
        cls = self._named(name)
        require({field.name for field in dataclasses.fields(cls)} == set(fields), _unknown(name))
        made = object.__new__(cls)
        for field, each in fields.items():
            object.__setattr__(made, field, self.decoded(each))
        return made

    def _study(self, study: Any, bandwidth: str | list[str], values: Mapping[str, Any]) -> Study:
        """The study that was given, if it is the one, with the values of the result's."""
        require(isinstance(self.of, Study), f"The result is of a study. {_NEEDED}")
        given: Any = self.of
        wanted, has = {tuple(each) for each in study}, _hexed(given.bandwidth)
        differ = sorted({part for part, _ in wanted ^ set(given.contents)})
        require(not differ, f"Argument `of` must be the study of the result, but differs in: {', '.join(differ)}.")
        require(
            has == bandwidth,
            f"Argument `of` must have the bandwidth {_unhexed(bandwidth)!r}, but has {_unhexed(has)!r}.",
        )
        return dataclasses.replace(given, values=self.decoded(values))

    def _named(self, name: str) -> Any:
        """A class of the package, or one of the study's own; no other module is ever imported."""
        module, _, cls = name.partition(":")
        if module.startswith(_OURS):
            found = getattr(importlib.import_module(module), cls, None)
            is_known = isinstance(found, type) and found.__module__ == module
            require(is_known and (dataclasses.is_dataclass(found) or issubclass(found, enum.Enum)), _unknown(name))
            return found
        known = {each for each in self.own if each.__qualname__ == cls}
        require(len(known) == 1, f"The result holds a `{cls}`, a class of your own. {_NEEDED}")
        return known.pop()


def _hexed(bandwidth: Any) -> str | list[str]:
    """A bandwidth to the last bit; of several channels a list."""
    return float(bandwidth).hex() if np.ndim(bandwidth) == 0 else [float(each).hex() for each in bandwidth]


def _unhexed(bandwidth: str | list[str]) -> float | list[float]:
    return float.fromhex(bandwidth) if isinstance(bandwidth, str) else list(map(float.fromhex, bandwidth))


def _unknown(name: str) -> str:
    return f"The result holds a `{name}`, which this version doesn't know. Read it with the version that wrote it."
