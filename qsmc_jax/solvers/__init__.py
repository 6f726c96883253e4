"""Solution methods for one step of an ODE; they know no loop."""
