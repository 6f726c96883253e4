"""Pictures, notebooks and short texts of results."""
