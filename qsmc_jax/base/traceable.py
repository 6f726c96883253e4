"""What JAX says of a function that it cannot trace, in words for who wrote the function."""

import contextlib
from collections.abc import Iterator

import jax


@contextlib.contextmanager
def traceable(what: str, values: str) -> Iterator[None]:
    """Turns JAX's errors about tracers into a `ValueError` that says what to write instead.

    Args:
        what: The function, as the subject of the message.
        values: What has no number while the function is traced.

    Raises:
        ValueError: Inside the context a traced number was used as a Python number.
    """
    try:
        yield
    except (jax.errors.JAXTypeError, jax.errors.JAXIndexError) as error:
        said = str(error).strip().splitlines()[0]
        raise ValueError(
            f"{what} must be written with `jax.numpy`, not `numpy` or `math`, with `jnp.where` in place of a Python "
            f"`if`, and without `float()`: {values} is no number yet while JAX traces it. JAX says: {said}"
        ) from error
