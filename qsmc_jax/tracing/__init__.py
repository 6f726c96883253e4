"""What JAX traced: programs read, rewritten, compiled, told apart."""
