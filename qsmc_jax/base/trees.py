"""Selections over pytrees."""

import functools as ft
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool


def where(condition: Bool[Array, ""], new: Any, old: Any) -> Any:
    """`new` where the condition holds, else `old`, leaf by leaf."""
    return jax.tree.map(ft.partial(jnp.where, condition), new, old)


def zeros_like(tree: Any) -> Any:
    """The same tree of zeros."""
    return jax.tree.map(jnp.zeros_like, tree)


def all_finite(tree: Any) -> Bool[Array, ""]:
    """Whether every number in the tree is finite."""
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(tree)]))


def first(tree: Any) -> Any:
    """Entry 0 of every leaf."""
    return jax.tree.map(lambda leaf: leaf[0], tree)
