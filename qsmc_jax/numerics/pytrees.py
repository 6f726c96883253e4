"""Selections over pytrees."""

import functools as ft
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool


def where(condition: Bool[Array, ""], new: Any, old: Any) -> Any:
    """`new` where the condition holds, else `old`, leaf by leaf."""
    return jax.tree.map(ft.partial(jnp.where, condition), new, old)


def zeros_like(tree: Any) -> Any:
    """The same tree of zeros."""
    return jax.tree.map(jnp.zeros_like, tree)


def is_finite(tree: Any) -> Bool[Array, ""]:
    """Whether every number in a tree of scalars is finite (and their sum, which NaN and infinity do not leave so)."""
    return jnp.isfinite(sum(jax.tree.leaves(tree)))


def first(tree: Any) -> Any:
    """Entry 0 of every leaf."""
    return jax.tree.map(lambda leaf: leaf[0], tree)


def stop_gradient(tree: Any) -> Any:
    """The same numbers without their derivatives; what is no array, such as a function, stays what it is."""
    return jax.tree.map(lambda leaf: jax.lax.stop_gradient(leaf) if eqx.is_array(leaf) else leaf, tree)
