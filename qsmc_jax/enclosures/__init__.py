"""Ranges of functions by interval arithmetic on their programs."""
