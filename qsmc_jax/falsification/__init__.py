"""Falsification: the worst scenario that a search finds within the uncertainty of a study."""
