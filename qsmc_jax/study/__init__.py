"""Studies: scenarios as functions of the unit cube, and the engine that runs them."""
