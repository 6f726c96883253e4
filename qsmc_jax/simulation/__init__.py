"""One trajectory: coordinates, guarded solver, figures tallied inside the solve, outcome, pictures."""
