"""Exact intervals and sequential tests; they know no loop."""
