"""What the results of studies have in common."""

import abc
from typing import Any

from qsmc_jax.display.notebook import as_dataset, as_frame, as_html
from qsmc_jax.display.short_repr import short_repr


class AbstractResult(abc.ABC):
    """A result that shows itself as text, table and picture. Dataclasses that derive from it have `repr=False`."""

    @abc.abstractmethod
    def table(self) -> dict[str, Any]:
        """The numbers as columns of one length, by name."""

    @abc.abstractmethod
    def summary(self) -> Any:
        """Everything as plain numbers and texts, ready for JSON."""

    @abc.abstractmethod
    def plot(self, ax: Any = None) -> Any:
        """Draws the result.

        Args:
            ax: The matplotlib `Axes` to draw in; None for a new figure.

        Returns:
            The axes.
        """

    def to_pandas(self) -> Any:
        """The table as a `pandas.DataFrame` over its first column; needs the extra `notebook`."""
        columns = self.table()
        return as_frame(columns, next(iter(columns)))

    def to_xarray(self) -> Any:
        """The table as an `xarray.Dataset` over the dimension `row`; needs the extra `notebook`."""
        return as_dataset({name: ("row", column) for name, column in self.table().items()}, {}, {})

    def _repr_html_(self) -> str:
        return as_html(str(self), self.plot)

    __repr__ = short_repr
