"""Verification: verdicts counted into exact intervals."""
