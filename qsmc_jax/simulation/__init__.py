"""One trajectory: coordinates, guarded solver, metrics accumulated inside the solve, outcome, pictures."""
