"""Proofs: bounds that are certain for every run of a study, found by JAX, checked without it."""
