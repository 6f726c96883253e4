"""Names of columns, which also stand on command lines and in files."""

from typing import Any

from qsmc_jax.base.checks import require

# Signs that have a meaning in the name of a column, or where a name is given a value on the command line.
_SIGNS = "=,[]{}()\"'`"


def require_name(name: Any) -> None:
    """Raises unless a name is a text that can name a column and stand on a command line.

    Args:
        name: The name.
    """
    require(
        isinstance(name, str) and name != "", f"Argument `name` must be a string that is not empty, but is {name!r}."
    )
    odd = [sign for sign in name if sign in _SIGNS or not sign.isprintable()]
    is_padded = name != name.strip() or name[0] in "@-"
    require(
        not odd and not is_padded,
        f"Argument `name` must have no {odd[0]!r} in it, but is {name!r}. Choose letters, digits and underscores."
        if odd
        else f"Argument `name` must not begin with '@' or '-', nor begin or end with a space, but is {name!r}.",
    )
