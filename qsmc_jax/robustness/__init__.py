"""Where the guarantee breaks: maps, critical values, comparisons, limits."""
