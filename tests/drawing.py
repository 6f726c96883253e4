"""What every picture is to do: draw in the axes that it is given, and return them."""

import numpy as np
from matplotlib.figure import Figure


def draws_in_given_axes(plot, count=1):
    """Gives axes of a figure of its own to a picture: they come back with labels and content, and nothing around them.

    Returns:
        The axes; for one panel it alone.
    """
    figure = Figure(figsize=(5.0 * count, 5.0))
    given = figure.subplots(1, count, squeeze=False)[0]
    returned = plot(ax=given if count > 1 else given[0])
    assert list(np.ravel(returned)) == list(given)
    for ax in given:
        assert ax.has_data()
        assert ax.get_xlabel() or ax.get_title()
    assert figure.get_suptitle() == ""
    return given if count > 1 else given[0]
